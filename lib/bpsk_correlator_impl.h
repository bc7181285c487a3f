// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "device_time.h"
#include "kernel/code_correlator.h"
#include <gnuradio/cast/bpsk_correlator.h>

namespace gr
{
namespace cast
{

class bpsk_correlator_impl : public bpsk_correlator
{
public:
    bpsk_correlator_impl(const std::vector<float>& chips, unsigned samples_per_chip,
                         unsigned average, double sample_rate_hz);

    size_t period() const override { return d_correlator.period(); }
    int64_t lost_samples() const override { return d_lost; }

    void set_average(unsigned average) override;
    void set_sample_rate(double sample_rate_hz) override;

    void forecast(int noutput_items, gr_vector_int& ninput_items_required) override;
    int general_work(int noutput_items, gr_vector_int& ninput_items,
                     gr_vector_const_void_star& input_items,
                     gr_vector_void_star& output_items) override;

private:
    struct time_mark {
        uint64_t offset; // absolute input item
        device_time time;
    };

    unsigned d_average;
    unsigned d_next_average; // of the vectors after the one under way
    double d_sample_rate_hz;
    kernel::code_correlator d_correlator;

    std::vector<gr_complex> d_sum; // periods added up so far
    size_t d_position = 0;         // sample within the period
    unsigned d_periods = 0;
    size_t d_skip = 0; // samples up to the next period start, after a gap
    std::optional<time_mark> d_mark;
    int64_t d_lost = 0;
    int64_t d_lost_now = 0; // in the gap that the next vector follows
    bool d_run_starts = true;

    device_time time_of(uint64_t offset) const;
    void restart_at(uint64_t offset, device_time time);
    void tag_run(int made, uint64_t first_item);
    int process(const gr_complex* in, int n_in, uint64_t first_item, gr_complex* out, int room,
                int& made);
};

} // namespace cast
} // namespace gr
