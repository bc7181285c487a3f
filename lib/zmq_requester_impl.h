// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "kernel/sample_socket.h"
#include <gnuradio/cast/zmq_requester.h>

namespace gr
{
namespace cast
{

class zmq_requester_impl : public zmq_requester
{
public:
    explicit zmq_requester_impl(const std::string& address);

    int work(int noutput_items, gr_vector_const_void_star& input_items,
             gr_vector_void_star& output_items) override;

private:
    kernel::sample_requester d_socket;
};

} // namespace cast
} // namespace gr
