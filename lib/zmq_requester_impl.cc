// SPDX-License-Identifier: GPL-3.0-or-later
#include "zmq_source_impl.h"
#include <gnuradio/cast/zmq_requester.h>

namespace gr
{
namespace cast
{

zmq_requester::sptr zmq_requester::make(const std::string& address)
{
    using impl = zmq_source_impl<zmq_requester, kernel::sample_requester>;
    return gnuradio::make_block_sptr<impl>("zmq_requester", address);
}

} // namespace cast
} // namespace gr
