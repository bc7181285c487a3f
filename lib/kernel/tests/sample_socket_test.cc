// SPDX-License-Identifier: GPL-3.0-or-later
// The ports against plain REQ and REP sockets, as stacks have them, that come, go and hang.
#include "check.h"
#include "kernel/sample_socket.h"
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <random>
#include <stdexcept>
#include <thread>

using namespace gr::cast::kernel;

namespace
{

constexpr int patient_ms = 10'000; // far more than anything here takes

void nothing_goes_wrong(const std::string& what)
{
    std::fprintf(stderr, "reported: %s\n", what.c_str());
    CHECK(!"an error was reported");
}

// A life of a peer: one socket of its own context, which ends with it.
struct peer {
    zmq_context context{zmq_ctx_new()};
    zmq_socket_handle socket;

    peer(int type, const std::string& address, bool binds) : socket(zmq_socket(context.get(), type))
    {
        const int linger = 1000, timeout = patient_ms;
        zmq_setsockopt(socket.get(), ZMQ_LINGER, &linger, sizeof(linger));
        zmq_setsockopt(socket.get(), ZMQ_RCVTIMEO, &timeout, sizeof(timeout));
        while ((binds ? zmq_bind : zmq_connect)(socket.get(), address.c_str()))
            std::this_thread::yield(); // the dead one's port is not free yet
    }

    std::string address()
    {
        char text[64];
        size_t size = sizeof(text);
        zmq_getsockopt(socket.get(), ZMQ_LAST_ENDPOINT, text, &size);
        return text;
    }

    // Bytes of the message, cut to fit; -1 where none came.
    int hear(void* to, size_t size) { return zmq_recv(socket.get(), to, size, 0); }
    void say(const void* what, size_t size)
    {
        CHECK(zmq_send(socket.get(), what, size, 0) == int(size));
    }

    // Samples first, first+1, …
    void publish(size_t n, size_t first = 0)
    {
        std::vector<sample> samples(n);
        for (size_t k = 0; k < n; k++)
            samples[k] = float(first + k);
        say(samples.data(), n * sizeof(sample));
    }

    // The same as srsRAN's transmitter, which reads a question into one byte.
    void answer(size_t first, size_t n)
    {
        uint8_t question;
        CHECK(hear(&question, 1) > 0);
        publish(n, first);
    }
};

std::string free_address() { return peer(ZMQ_REP, "tcp://127.0.0.1:*", true).address(); }

void wait_a_little() { std::this_thread::sleep_for(std::chrono::milliseconds(50)); }

// Receives until `n` samples came; they must be first, first+1, …
template <class port> void expect(port& receiver, size_t first, size_t n)
{
    std::mt19937 random(1);
    std::vector<sample> out(3000);
    for (size_t got = 0; got < n;) {
        const size_t room = std::min<size_t>(n - got, 1 + random() % out.size());
        const size_t now = receiver.receive(out.data(), room, patient_ms);
        for (size_t k = 0; k < now; k++)
            CHECK(out[k] == sample(float(first + got + k)));
        got += now;
    }
}

void answers_of_any_length_are_one_stream()
{
    const std::string address = free_address();
    sample_requester requester(address, nothing_goes_wrong);
    std::thread transmitter([&] {
        peer rep(ZMQ_REP, address, true);
        size_t sent = 0;
        for (const size_t n : {1, 7, 0, 300, 2000, 0, 100'000, 1})
            rep.answer(sent, n), sent += n;
        uint8_t question;
        CHECK(rep.hear(&question, 1) > 0); // and stays for the next question
    });
    expect(requester, 0, 102'309);
    transmitter.join();
}

void a_transmitter_that_dies_between_question_and_answer_is_asked_again_and_once()
{
    const std::string address = free_address();
    sample_requester requester(address, nothing_goes_wrong);
    std::thread transmitter([&] {
        for (int life = 0; life < 5; life++) {
            peer hangs(ZMQ_ROUTER, address, true); // hears every question, not only the next
            char text[64];
            for (int part = 0; part < 3; part++) // who, nothing, question
                CHECK(hangs.hear(text, sizeof(text)) >= 0);
            wait_a_little();
            CHECK(zmq_recv(hangs.socket.get(), text, sizeof(text), ZMQ_DONTWAIT) < 0);
        }
        peer rep(ZMQ_REP, address, true);
        rep.answer(0, 1000);
        wait_a_little();
    });
    expect(requester, 0, 1000);
    transmitter.join();
}

void what_was_answered_before_a_death_is_not_lost()
{
    const std::string address = free_address();
    sample_requester requester(address, nothing_goes_wrong);
    for (size_t life = 0; life < 20; life++) {
        std::atomic<bool> may_answer{false};
        std::thread transmitter([&] {
            peer rep(ZMQ_REP, address, true);
            rep.answer(200 * life, 100);
            while (!may_answer)
                std::this_thread::yield();
            rep.answer(200 * life + 100, 100);
        });
        expect(requester, 200 * life, 100);
        sample none;
        CHECK(requester.receive(&none, 1, 1) == 0); // goes to sleep on the connection
        may_answer = true;
        transmitter.join(); // dead before its last answer is looked at
        wait_a_little();
        expect(requester, 200 * life + 100, 100);
    }
}

void messages_that_are_not_whole_samples_are_cut_and_told_of_once()
{
    const std::string address = free_address();
    int told = 0;
    sample_requester requester(address, [&](const std::string&) { told++; });
    std::thread transmitter([&] {
        peer rep(ZMQ_REP, address, true);
        for (int message = 0; message < 3; message++) {
            uint8_t question;
            CHECK(rep.hear(&question, 1) > 0);
            const float odd[] = {float(message), 0, 9};
            rep.say(odd, sizeof(odd));
        }
        wait_a_little();
    });
    expect(requester, 0, 3);
    transmitter.join();
    CHECK(told == 1);
}

// As GNU Radio's sinks begin messages with "Pass Tags" on, here without a tag.
void a_sender_of_tags_is_refused_and_told_of_and_heard_when_it_returns_without()
{
    const std::string address = free_address();
    std::vector<std::string> told;
    sample_requester requester(address, [&](const std::string& what) { told.push_back(what); });
    sample none;
    {
        peer rep(ZMQ_REP, address, true);
        std::vector<uint8_t> message(19 + 8 * 100);
        message[0] = 0xF0, message[1] = 0x5F, message[2] = 1;
        uint8_t question;
        std::thread receiver([&] {
            for (int turn = 0; told.empty() && turn < patient_ms / 10; turn++)
                CHECK(requester.receive(&none, 1, 10) == 0);
        });
        CHECK(rep.hear(&question, 1) > 0);
        rep.say(message.data(), message.size());
        receiver.join();
        CHECK(requester.receive(&none, 1, 50) == 0);
    }
    CHECK(told.size() == 1 && told[0].find("Pass Tags") != std::string::npos);
    std::thread transmitter([&] {
        peer rep(ZMQ_REP, address, true);
        rep.answer(0, 1000);
        wait_a_little();
    });
    expect(requester, 0, 1000);
    transmitter.join();
}

void a_publisher_that_returns_is_heard_again()
{
    const std::string address = free_address();
    int told = 0;
    sample_subscriber subscriber(address, [&](const std::string&) { told++; });
    for (int life = 0; life < 5; life++) {
        peer pub(ZMQ_XPUB, address, true);
        char subscription[2];
        sample none;
        while (zmq_recv(pub.socket.get(), subscription, sizeof(subscription), ZMQ_DONTWAIT) < 0)
            CHECK(subscriber.receive(&none, 1, 10) == 0);
        for (const size_t n : {1, 7, 300, 100'000}) {
            pub.publish(n);
            expect(subscriber, 0, n);
        }
        pub.say("odd", 3);
    }
    CHECK(told == 1);
}

std::vector<sample> ramp(size_t n)
{
    std::vector<sample> samples(n);
    for (size_t k = 0; k < n; k++)
        samples[k] = float(k);
    return samples;
}

void a_question_gets_what_is_there_and_never_more_than_it_asks_for_or_srsran_can_take()
{
    const std::string address = free_address();
    sample_replier replier(address, nothing_goes_wrong);
    peer req(ZMQ_REQ, address, false);
    const auto samples = ramp(100'000);
    std::vector<sample> heard(samples.size());
    const auto ask = [&](const void* question, size_t size, size_t available) {
        req.say(question, size);
        const size_t sent = replier.send(samples.data(), available, patient_ms);
        CHECK(req.hear(heard.data(), heard.size() * sizeof(sample)) == int(sent * sizeof(sample)));
        CHECK(std::equal(heard.begin(), heard.begin() + sent, samples.begin()));
        return sent;
    };
    const uint8_t dummy = 0xff;
    CHECK(ask(&dummy, 1, 17) == 17);
    CHECK(ask("", 0, 17) == 17);
    CHECK(ask(&dummy, 1, samples.size()) == 65536);
    for (const uint32_t room : {1u, 1000u}) // GNU Radio's
        CHECK(ask(&room, sizeof(room), samples.size()) == room);
    CHECK(replier.send(samples.data(), 10, 1) == 0); // nobody asks
}

void samples_for_a_receiver_that_died_go_to_the_next()
{
    const std::string address = free_address();
    sample_replier replier(address, nothing_goes_wrong);
    const auto samples = ramp(100);
    for (int life = 0; life < 5; life++) {
        {
            peer dies(ZMQ_REQ, address, false);
            dies.say("?", 1);
            wait_a_little();
        }
        wait_a_little();
        CHECK(replier.send(samples.data(), samples.size(), 1) == 0);
        peer lives(ZMQ_REQ, address, false);
        lives.say("?", 1);
        CHECK(replier.send(samples.data(), samples.size(), patient_ms) == samples.size());
        sample first;
        CHECK(lives.hear(&first, sizeof(first)) == int(samples.size() * sizeof(sample)));
        CHECK(first == samples[0]);
    }
}

void peers_may_die_at_any_moment()
{
    const std::string sent_at = free_address(), heard_at = free_address();
    std::atomic<bool> ended{false};
    std::thread requests([&] {
        sample_requester requester(sent_at, nothing_goes_wrong);
        std::vector<sample> out(4096);
        while (!ended)
            requester.receive(out.data(), out.size(), 20);
    });
    std::thread replies([&] {
        sample_replier replier(heard_at, nothing_goes_wrong);
        const auto samples = ramp(4096);
        while (!ended)
            replier.send(samples.data(), samples.size(), 20);
    });
    std::mt19937 random(1);
    std::vector<sample> samples(4096);
    for (int life = 0; life < 200; life++) {
        peer rep(ZMQ_REP, sent_at, true), req(ZMQ_REQ, heard_at, false);
        const int linger = 0; // as a process that is killed
        zmq_setsockopt(rep.socket.get(), ZMQ_LINGER, &linger, sizeof(linger));
        zmq_setsockopt(req.socket.get(), ZMQ_LINGER, &linger, sizeof(linger));
        for (int turn = random() % 8; turn > 0; turn--) {
            req.say("?", 1);
            rep.answer(0, random() % 3000);
            CHECK(req.hear(samples.data(), samples.size() * sizeof(sample)) > 0);
        }
        if (random() % 2)
            req.say("?", 1);
    }
    ended = true;
    requests.join();
    replies.join();
}

template <class port> void refuses(const std::string& address)
{
    try {
        port(address, nothing_goes_wrong);
    } catch (const std::runtime_error& error) {
        CHECK(std::string(error.what()).find(address) != std::string::npos);
        return;
    }
    CHECK(!"refused");
}

void addresses_that_cannot_be_are_refused()
{
    refuses<sample_requester>("tcp://nowhere");
    refuses<sample_requester>("tcp://*:2000");
    refuses<sample_subscriber>("tcp://nowhere");
    refuses<sample_replier>("tape://x");
    const std::string taken = free_address();
    sample_replier first(taken, nothing_goes_wrong);
    refuses<sample_replier>(taken);
}

} // namespace

int main()
{
    answers_of_any_length_are_one_stream();
    a_transmitter_that_dies_between_question_and_answer_is_asked_again_and_once();
    what_was_answered_before_a_death_is_not_lost();
    messages_that_are_not_whole_samples_are_cut_and_told_of_once();
    a_sender_of_tags_is_refused_and_told_of_and_heard_when_it_returns_without();
    a_question_gets_what_is_there_and_never_more_than_it_asks_for_or_srsran_can_take();
    samples_for_a_receiver_that_died_go_to_the_next();
    a_publisher_that_returns_is_heard_again();
    peers_may_die_at_any_moment();
    addresses_that_cannot_be_are_refused();
    return 0;
}
