// SPDX-License-Identifier: GPL-3.0-or-later
#include "sample_socket.h"
#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <thread>

namespace gr
{
namespace cast
{
namespace kernel
{

namespace
{

// One answer: what fits the receive buffers of srsRAN's radios (614,400 samples and more).
constexpr uint32_t most_samples = 1 << 16;

constexpr int reconnect_ms = 10;
constexpr int linger_ms = 1000; // the last answer still leaves when the flow ends

// A signal may interrupt a call in the middle of a message: it has to go on where it was.
template <class call> int repeated(call&& repeat)
{
    int result;
    do
        result = repeat();
    while (result < 0 && zmq_errno() == EINTR);
    return result;
}

bool receive_part(void* socket, zmq_message& part)
{
    return repeated([&] { return zmq_msg_recv(part.get(), socket, ZMQ_DONTWAIT); }) >= 0;
}

bool send_part(void* socket, zmq_message& part, bool more)
{
    const int flags = ZMQ_DONTWAIT | (more ? ZMQ_SNDMORE : 0);
    return repeated([&] { return zmq_msg_send(part.get(), socket, flags); }) >= 0;
}

std::string last_error() { return zmq_strerror(zmq_errno()); }

// Until something can be received, or the time is up.
void wait_for(zmq_pollitem_t* items, int n, int wait_ms, error_report& report)
{
    if (zmq_poll(items, n, wait_ms) < 0 && zmq_errno() != EINTR) {
        report("wait: " + last_error());
        std::this_thread::sleep_for(std::chrono::milliseconds(wait_ms));
    }
}

[[noreturn]] void refuse(const std::string& address)
{
    throw std::runtime_error("address " + address + ": " + last_error());
}

void set(const zmq_socket_handle& socket, int option, int value)
{
    zmq_setsockopt(socket.get(), option, &value, sizeof(value));
}

// Whether a message begins as GNU Radio's sinks begin it with "Pass Tags" on: magic, version, then
// number of the first sample and of tags, which are small where samples are any bits.
bool has_tag_header(zmq_message& message)
{
    struct __attribute__((packed)) {
        uint16_t magic;
        uint8_t version;
        uint64_t offset, n_tags;
    } header;
    if (message.size() < sizeof(header))
        return false;
    std::memcpy(&header, message.data(), sizeof(header));
    return header.magic == 0x5FF0 && header.version < 16 && header.offset >> 48 == 0 &&
           header.n_tags >> 16 == 0;
}

} // namespace

bool sample_message::take_from(const zmq_socket_handle& socket, error_report& report)
{
    d_n_samples = d_n_copied = 0;
    do {
        if (!receive_part(socket.get(), d_message)) {
            if (zmq_errno() != EAGAIN)
                report("receive: " + last_error());
            return false;
        }
    } while (d_message.more());
    if (has_tag_header(d_message)) {
        report("a peer sends stream tags between its samples: nothing of it is taken; turn "
               "'Pass Tags' off in its ZMQ sink");
        return false;
    }
    if (d_message.size() % sizeof(sample))
        report("a peer's message is not whole complex floats of 8 bytes: its end is dropped");
    d_n_samples = d_message.size() / sizeof(sample);
    return true;
}

size_t sample_message::copy(sample* out, size_t n)
{
    n = std::min(n, d_n_samples - d_n_copied);
    std::memcpy(out, d_message.data() + d_n_copied * sizeof(sample), n * sizeof(sample));
    d_n_copied += n;
    return n;
}

// Not REQ, which waits for the answer of the dead for ever. Nor ZMQ_IMMEDIATE: with it, libzmq 4.3
// aborts the process where a peer leaves while its answer is read ("!_more", fq.cpp).
sample_requester::sample_requester(const std::string& address, error_report::listener tell)
    : d_report(std::move(tell)), d_context(zmq_ctx_new()),
      d_socket(zmq_socket(d_context.get(), ZMQ_DEALER)),
      d_events(zmq_socket(d_context.get(), ZMQ_PAIR))
{
    set(d_socket, ZMQ_LINGER, 0);
    set(d_socket, ZMQ_RECONNECT_IVL, reconnect_ms);
    set(d_events, ZMQ_RCVHWM, 0); // a full queue of events would halt the connection
    if (zmq_socket_monitor(d_socket.get(), "inproc://events",
                           ZMQ_EVENT_HANDSHAKE_SUCCEEDED | ZMQ_EVENT_DISCONNECTED) ||
        zmq_connect(d_events.get(), "inproc://events") ||
        zmq_connect(d_socket.get(), address.c_str()))
        refuse(address);
}

size_t sample_requester::receive(sample* out, size_t n, int wait_ms)
{
    if (const size_t rest = d_answer.copy(out, n))
        return rest;
    ask();
    if (!take_answer()) {
        zmq_pollitem_t ready[] = {{d_socket.get(), 0, ZMQ_POLLIN, 0},
                                  {d_events.get(), 0, ZMQ_POLLIN, 0}};
        wait_for(ready, 2, wait_ms, d_report);
        if (!take_answer())
            return 0;
    }
    ask(); // the next answer comes while this one is worked on
    return d_answer.copy(out, n);
}

bool sample_requester::take_answer()
{
    if (!d_answer.take_from(d_socket, d_report))
        return false;
    d_asked = false;
    return true;
}

// Only ever a peer that is there, so that nobody is asked twice. GNU Radio's sink reads from the
// question how many samples it may send; srsRAN's radio takes any.
void sample_requester::ask()
{
    follow_connection();
    if (!d_connected || d_asked)
        return;
    zmq_message delimiter, question(&most_samples, sizeof(most_samples));
    d_asked =
        send_part(d_socket.get(), delimiter, true) && send_part(d_socket.get(), question, false);
    if (!d_asked)
        d_report("ask: " + last_error());
}

void sample_requester::follow_connection()
{
    zmq_message event, address;
    while (receive_part(d_events.get(), event) && receive_part(d_events.get(), address)) {
        uint16_t kind;
        std::memcpy(&kind, event.data(), sizeof(kind));
        d_connected = kind == ZMQ_EVENT_HANDSHAKE_SUCCEEDED;
        d_asked = false; // whoever was asked is gone
    }
}

sample_subscriber::sample_subscriber(const std::string& address, error_report::listener tell)
    : d_report(std::move(tell)), d_context(zmq_ctx_new()),
      d_socket(zmq_socket(d_context.get(), ZMQ_SUB))
{
    set(d_socket, ZMQ_LINGER, 0);
    set(d_socket, ZMQ_RECONNECT_IVL, reconnect_ms);
    if (zmq_setsockopt(d_socket.get(), ZMQ_SUBSCRIBE, "", 0) ||
        zmq_connect(d_socket.get(), address.c_str()))
        refuse(address);
}

size_t sample_subscriber::receive(sample* out, size_t n, int wait_ms)
{
    if (const size_t rest = d_message.copy(out, n))
        return rest;
    if (!d_message.take_from(d_socket, d_report)) {
        zmq_pollitem_t ready[] = {{d_socket.get(), 0, ZMQ_POLLIN, 0}};
        wait_for(ready, 1, wait_ms, d_report);
        if (!d_message.take_from(d_socket, d_report))
            return 0;
    }
    return d_message.copy(out, n);
}

sample_replier::sample_replier(const std::string& address, error_report::listener tell)
    : d_report(std::move(tell)), d_context(zmq_ctx_new()),
      d_socket(zmq_socket(d_context.get(), ZMQ_ROUTER))
{
    set(d_socket, ZMQ_LINGER, linger_ms);
    set(d_socket, ZMQ_ROUTER_MANDATORY, 1); // an answer to somebody gone fails: nothing is lost
    if (zmq_bind(d_socket.get(), address.c_str()))
        refuse(address);
}

size_t sample_replier::send(const sample* in, size_t n, int wait_ms)
{
    size_t sent = 0;
    while (sent < n && next_question(sent ? 0 : wait_ms))
        sent += answer(in + sent, n - sent);
    return sent;
}

bool sample_replier::next_question(int wait_ms)
{
    if (take_question())
        return true;
    zmq_pollitem_t ready[] = {{d_socket.get(), 0, ZMQ_POLLIN, 0}};
    wait_for(ready, 1, wait_ms, d_report);
    return take_question();
}

bool sample_replier::take_question()
{
    d_question.clear();
    do {
        d_question.emplace_back();
        if (!receive_part(d_socket.get(), d_question.back())) {
            if (zmq_errno() != EAGAIN)
                d_report("receive: " + last_error());
            return false;
        }
    } while (d_question.back().more());
    return true;
}

size_t sample_replier::answer(const sample* in, size_t n)
{
    zmq_message asked = std::move(d_question.back());
    d_question.pop_back(); // what is left says who asked
    uint32_t limit = most_samples;
    if (asked.size() == sizeof(limit)) // GNU Radio's source says how many it has room for
        std::memcpy(&limit, asked.data(), sizeof(limit));
    n = std::min<size_t>({n, limit, most_samples});
    zmq_message samples(in, n * sizeof(sample));
    const auto sent = [&](zmq_message& part) { return send_part(d_socket.get(), part, true); };
    if (samples.size() == n * sizeof(sample) &&
        std::all_of(d_question.begin(), d_question.end(), sent) &&
        send_part(d_socket.get(), samples, false))
        return n;
    if (zmq_errno() != EHOSTUNREACH) // the one who asked is gone: the next one gets these samples
        d_report("answer: " + last_error());
    return 0;
}

} // namespace kernel
} // namespace cast
} // namespace gr
