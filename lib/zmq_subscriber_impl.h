// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "kernel/sample_socket.h"
#include <gnuradio/cast/zmq_subscriber.h>

namespace gr
{
namespace cast
{

class zmq_subscriber_impl : public zmq_subscriber
{
public:
    explicit zmq_subscriber_impl(const std::string& address);

    int work(int noutput_items, gr_vector_const_void_star& input_items,
             gr_vector_void_star& output_items) override;

private:
    kernel::sample_subscriber d_socket;
};

} // namespace cast
} // namespace gr
