// SPDX-License-Identifier: GPL-3.0-or-later
// A block that gives out what a socket receives.
#pragma once

#include "kernel/sample_socket.h"
#include <gnuradio/io_signature.h>
#include <gnuradio/sync_block.h>

namespace gr
{
namespace cast
{

template <class Block, class Socket> class zmq_source_impl : public Block
{
public:
    zmq_source_impl(const char* name, const std::string& address)
        : gr::sync_block(name, gr::io_signature::make(0, 0, 0),
                         gr::io_signature::make(1, 1, sizeof(gr_complex))),
          d_socket(address, [this, address](const std::string& what) {
              this->d_logger->error("{}: {}", address, what);
          })
    {
        this->set_min_output_buffer(buffer_samples);
    }

    int work(int noutput_items, gr_vector_const_void_star&,
             gr_vector_void_star& output_items) override
    {
        return d_socket.receive(static_cast<gr_complex*>(output_items[0]), noutput_items, wait_ms);
    }

private:
    // The longest that work() waits before the scheduler may stop it.
    static constexpr int wait_ms = 20;
    static constexpr int buffer_samples = 1 << 16; // messages are longer than the usual 8,192

    Socket d_socket;
};

} // namespace cast
} // namespace gr
