// SPDX-License-Identifier: GPL-3.0-or-later
// Threads that share one short job after the other: the caller works too, and returns when all have
// finished.
#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace gr
{
namespace cast
{
namespace kernel
{

class thread_pool
{
public:
    // `n_threads` counts the caller; 1 starts no thread at all.
    explicit thread_pool(unsigned n_threads);
    ~thread_pool();
    thread_pool(const thread_pool&) = delete;
    thread_pool& operator=(const thread_pool&) = delete;

    unsigned size() const { return static_cast<unsigned>(d_threads.size()) + 1; }

    // Runs job(0) … job(n_jobs - 1), each once, on whichever thread is free.
    void run(unsigned n_jobs, const std::function<void(unsigned)>& job);

private:
    std::vector<std::thread> d_threads;
    std::mutex d_mutex;
    std::condition_variable d_work_is_there, d_work_is_done;
    const std::function<void(unsigned)>* d_job = nullptr; // while there is something to take up
    unsigned d_n_jobs = 0;
    unsigned d_sleeping = 0;
    std::atomic<unsigned> d_next_job{0};
    std::atomic<unsigned> d_round{0};
    std::atomic<unsigned> d_busy{0};
    bool d_stop = false;

    void take_jobs(const std::function<void(unsigned)>& job, unsigned n_jobs);
    void live();
};

} // namespace kernel
} // namespace cast
} // namespace gr
