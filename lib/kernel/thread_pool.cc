// SPDX-License-Identifier: GPL-3.0-or-later
#include "thread_pool.h"

namespace gr
{
namespace cast
{
namespace kernel
{

namespace
{

// About as long as waking a sleeping thread takes: the next job mostly comes sooner.
constexpr int spins_before_sleep = 4000;

void relax()
{
#if defined(__x86_64__)
    __builtin_ia32_pause();
#endif
}

} // namespace

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
        d_round++;
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
    bool wake;
    {
        std::lock_guard<std::mutex> lock(d_mutex);
        d_job = &job;
        d_n_jobs = n_jobs;
        d_next_job = 0;
        d_round++;
        wake = d_sleeping > 0;
    }
    if (wake)
        d_work_is_there.notify_all();
    take_jobs(job, n_jobs);
    {
        std::lock_guard<std::mutex> lock(d_mutex);
        d_job = nullptr; // a thread that comes from now on finds nothing to take up
    }
    for (int spins = 0; d_busy > 0 && spins < spins_before_sleep; spins++)
        relax();
    if (d_busy > 0) {
        std::unique_lock<std::mutex> lock(d_mutex);
        d_work_is_done.wait(lock, [&] { return d_busy == 0; });
    }
}

void thread_pool::live()
{
    unsigned seen = 0;
    for (;;) {
        for (int spins = 0; d_round == seen && spins < spins_before_sleep; spins++)
            relax();
        std::unique_lock<std::mutex> lock(d_mutex);
        d_sleeping++;
        d_work_is_there.wait(lock, [&] { return d_round != seen; });
        d_sleeping--;
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
            d_work_is_done.notify_one();
    }
}

} // namespace kernel
} // namespace cast
} // namespace gr
