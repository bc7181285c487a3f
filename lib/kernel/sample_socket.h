// SPDX-License-Identifier: GPL-3.0-or-later
// Complex samples over ZeroMQ as srsRAN's radios send them: who receives asks (REQ) with one small
// message, who transmits answers (REP) with any number of samples. Peers may die and return at any
// moment, also between question and answer, where plain REQ and REP sockets hang or lose samples.
#pragma once

#include "zmq_handle.h"
#include <complex>
#include <functional>
#include <set>
#include <string>
#include <vector>

namespace gr
{
namespace cast
{
namespace kernel
{

using sample = std::complex<float>;

// Passes on what goes wrong in words, each once.
class error_report
{
public:
    using listener = std::function<void(const std::string&)>;
    explicit error_report(listener tell) : d_tell(std::move(tell)) {}
    void operator()(const std::string& what)
    {
        if (d_told.insert(what).second)
            d_tell(what);
    }

private:
    listener d_tell;
    std::set<std::string> d_told;
};

// A message of samples, taken out piece by piece.
class sample_message
{
public:
    // The last part of the next message that a socket has; false: it has none, or one that is
    // refused.
    bool take_from(const zmq_socket_handle& socket, error_report& report);
    // At most n samples, and how many.
    size_t copy(sample* out, size_t n);

private:
    zmq_message d_message;
    size_t d_n_samples = 0, d_n_copied = 0;
};

// Samples of a peer that answers: srsRAN's tx_port, GNU Radio's ZMQ REP Sink.
class sample_requester
{
public:
    // Throws std::runtime_error where the address cannot be.
    sample_requester(const std::string& address, error_report::listener tell);

    // At most n samples, in order, and how many; waits at most wait_ms for the first.
    size_t receive(sample* out, size_t n, int wait_ms);

private:
    bool take_answer();
    void ask();
    void follow_connection();

    error_report d_report;
    zmq_context d_context;
    zmq_socket_handle d_socket, d_events;
    bool d_connected = false;
    bool d_asked = false; // the peer that is there now has a question
    sample_message d_answer;
};

// Samples of whoever publishes: GNU Radio's ZMQ PUB Sink, srsRAN's tx_type=pub.
class sample_subscriber
{
public:
    // Throws std::runtime_error where the address cannot be.
    sample_subscriber(const std::string& address, error_report::listener tell);

    // At most n samples, in order, and how many; waits at most wait_ms for the first.
    size_t receive(sample* out, size_t n, int wait_ms);

private:
    error_report d_report;
    zmq_context d_context;
    zmq_socket_handle d_socket;
    sample_message d_message;
};

// Samples for a peer that asks: srsRAN's rx_port, GNU Radio's ZMQ REQ Source.
class sample_replier
{
public:
    // Throws std::runtime_error where the address cannot be.
    sample_replier(const std::string& address, error_report::listener tell);

    // How many of n samples were sent; waits at most wait_ms for a question.
    size_t send(const sample* in, size_t n, int wait_ms);

private:
    bool next_question(int wait_ms);
    bool take_question();
    size_t answer(const sample* in, size_t n);

    error_report d_report;
    zmq_context d_context;
    zmq_socket_handle d_socket;
    std::vector<zmq_message> d_question; // who asks, part by part, and last what
};

} // namespace kernel
} // namespace cast
} // namespace gr
