// SPDX-License-Identifier: GPL-3.0-or-later
// Owners of libzmq's handles: what they hold ends with them.
#pragma once

#include <cstddef>
#include <cstring>
#include <memory>
#include <utility>
#include <zmq.h>

namespace gr
{
namespace cast
{
namespace kernel
{

struct end_zmq_context {
    void operator()(void* context) const { zmq_ctx_term(context); }
};
struct close_zmq_socket {
    void operator()(void* socket) const { zmq_close(socket); }
};
using zmq_context = std::unique_ptr<void, end_zmq_context>;
using zmq_socket_handle =
    std::unique_ptr<void, close_zmq_socket>; // to be destroyed before its context

class zmq_message
{
public:
    zmq_message() { zmq_msg_init(&d_message); }
    // Empty where there is no memory for it.
    zmq_message(const void* data, size_t size)
    {
        if (zmq_msg_init_size(&d_message, size))
            zmq_msg_init(&d_message);
        else if (size)
            std::memcpy(zmq_msg_data(&d_message), data, size);
    }
    ~zmq_message() { zmq_msg_close(&d_message); }
    zmq_message(zmq_message&& other) noexcept : zmq_message() { *this = std::move(other); }
    zmq_message& operator=(zmq_message&& other) noexcept
    {
        zmq_msg_move(&d_message, &other.d_message);
        return *this;
    }

    zmq_msg_t* get() { return &d_message; }
    const char* data() { return static_cast<const char*>(zmq_msg_data(&d_message)); }
    size_t size() const { return zmq_msg_size(&d_message); }
    bool more() const { return zmq_msg_more(&d_message); }

private:
    zmq_msg_t d_message;
};

} // namespace kernel
} // namespace cast
} // namespace gr
