// SPDX-License-Identifier: GPL-3.0-or-later
#include "zmq_source_impl.h"
#include <gnuradio/cast/zmq_subscriber.h>

namespace gr
{
namespace cast
{

zmq_subscriber::sptr zmq_subscriber::make(const std::string& address)
{
    using impl = zmq_source_impl<zmq_subscriber, kernel::sample_subscriber>;
    return gnuradio::make_block_sptr<impl>("zmq_subscriber", address);
}

} // namespace cast
} // namespace gr
