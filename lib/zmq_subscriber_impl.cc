// SPDX-License-Identifier: GPL-3.0-or-later
#include "zmq_subscriber_impl.h"
#include <gnuradio/io_signature.h>

namespace gr
{
namespace cast
{

namespace
{
constexpr int wait_ms = 20; // the longest that work() waits before the scheduler may stop it
constexpr int buffer_samples = 1 << 16; // messages are longer than the usual 8,192
} // namespace

zmq_subscriber::sptr zmq_subscriber::make(const std::string& address)
{
    return gnuradio::make_block_sptr<zmq_subscriber_impl>(address);
}

zmq_subscriber_impl::zmq_subscriber_impl(const std::string& address)
    : gr::sync_block("zmq_subscriber", gr::io_signature::make(0, 0, 0),
                     gr::io_signature::make(1, 1, sizeof(gr_complex))),
      d_socket(address, [this, address](const std::string& what) {
          d_logger->error("{}: {}", address, what);
      })
{
    set_min_output_buffer(buffer_samples);
}

int zmq_subscriber_impl::work(int noutput_items, gr_vector_const_void_star&,
                              gr_vector_void_star& output_items)
{
    return d_socket.receive(static_cast<gr_complex*>(output_items[0]), noutput_items, wait_ms);
}

} // namespace cast
} // namespace gr
