// SPDX-License-Identifier: GPL-3.0-or-later
#include "thread_pool.h"

namespace gr
{
namespace cast
{
namespace kernel
{

thread_pool::thread_pool(unsigned n_threads)
{
    for (unsigned t = 1; t < n_threads; t++)
        d_threads.emplace_back([this] { live(); });
}

thread_pool::~thread_pool()
{
    {
        std::lock_guard<std::mutex> lock(d_mutex);
        d_stop = true;
    }
    d_work_is_there.notify_all();
    for (auto& thread : d_threads)
        thread.join();
}

void thread_pool::take_jobs(const std::function<void(unsigned)>& job, unsigned n_jobs)
{
    for (unsigned i = d_next_job++; i < n_jobs; i = d_next_job++)
        job(i);
}

void thread_pool::run(unsigned n_jobs, const std::function<void(unsigned)>& job)
{
    if (d_threads.empty() || n_jobs < 2) {
        for (unsigned i = 0; i < n_jobs; i++)
            job(i);
        return;
    }
    {
        std::lock_guard<std::mutex> lock(d_mutex);
        d_job = &job;
        d_n_jobs = n_jobs;
        d_next_job = 0;
        d_round++;
    }
    d_work_is_there.notify_all();
    take_jobs(job, n_jobs);
    std::unique_lock<std::mutex> lock(d_mutex);
    d_job = nullptr; // a thread that wakes up from now on finds nothing to do
    d_all_idle.wait(lock, [this] { return d_busy == 0; });
}

void thread_pool::live()
{
    std::unique_lock<std::mutex> lock(d_mutex);
    uint64_t seen = 0;
    for (;;) {
        d_work_is_there.wait(lock, [&] { return d_stop || d_round != seen; });
        if (d_stop)
            return;
        seen = d_round;
        if (!d_job)
            continue;
        const auto* job = d_job;
        const unsigned n_jobs = d_n_jobs;
        d_busy++;
        lock.unlock();
        take_jobs(*job, n_jobs);
        lock.lock();
        if (--d_busy == 0)
            d_all_idle.notify_one();
    }
}

} // namespace kernel
} // namespace cast
} // namespace gr
