// SPDX-License-Identifier: GPL-3.0-or-later
#include "zmq_replier_impl.h"
#include <gnuradio/io_signature.h>

namespace gr
{
namespace cast
{

namespace
{
constexpr int wait_ms = 20; // the longest that work() waits before the scheduler may stop it
}

zmq_replier::sptr zmq_replier::make(const std::string& address)
{
    return gnuradio::make_block_sptr<zmq_replier_impl>(address);
}

zmq_replier_impl::zmq_replier_impl(const std::string& address)
    : gr::sync_block("zmq_replier", gr::io_signature::make(1, 1, sizeof(gr_complex)),
                     gr::io_signature::make(0, 0, 0)),
      d_socket(address, [this, address](const std::string& what) {
          d_logger->error("{}: {}", address, what);
      })
{
}

int zmq_replier_impl::work(int noutput_items, gr_vector_const_void_star& input_items,
                           gr_vector_void_star&)
{
    return d_socket.send(static_cast<const gr_complex*>(input_items[0]), noutput_items, wait_ms);
}

} // namespace cast
} // namespace gr
