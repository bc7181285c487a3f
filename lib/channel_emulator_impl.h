// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "kernel/emulator.h"
#include "kernel/vector_kernels.h"
#include "link_update_pmt.h"
#include <chrono>
#include <condition_variable>
#include <gnuradio/cast/channel_emulator.h>
#include <limits>
#include <mutex>

namespace gr
{
namespace cast
{

class channel_emulator_impl : public channel_emulator
{
public:
    channel_emulator_impl(const kernel::emulator::config& config, double sample_rate_hz,
                          const std::string& name);

    void set_taps(int tx, int rx, const std::vector<gr_complex>& taps,
                  std::optional<uint64_t> offset, uint64_t ramp) override;
    void set_sparse_taps(int tx, int rx, const std::vector<int>& delays,
                         const std::vector<gr_complex>& gains, std::optional<uint64_t> offset,
                         uint64_t ramp) override;
    void enable_link(int tx, int rx, bool enabled, std::optional<uint64_t> offset) override;
    void set_horizon(std::optional<uint64_t> offset) override;
    void clear() override;
    void set_base_loss(int tx, int rx, double base_loss_db,
                       std::optional<uint64_t> offset) override;
    void set_noise_power(int rx, double power) override;
    void set_fixed_point(int bits, int tap_bits, double input_full_scale,
                         double output_full_scale) override;
    void set_sample_rate(double sample_rate_hz) override;
    void set_scenario_name(const std::string& name) override;
    std::string plan() const override;
    pmt::pmt_t status() const override;
    uint64_t late_updates() const override;
    uint64_t refused_updates() const override;
    uint64_t clipped_samples() const override;
    int active_links() const override;

    bool start() override;
    bool stop() override;
    int work(int noutput_items, gr_vector_const_void_star& input_items,
             gr_vector_void_star& output_items) override;

private:
    using clock = std::chrono::steady_clock;

    double d_sample_rate_hz;
    std::string d_name;
    mutable std::mutex d_mutex; // between work() and the setters
    kernel::emulator d_emulator;
    uint64_t d_horizon = std::numeric_limits<uint64_t>::max();
    std::condition_variable d_horizon_moved;
    uint64_t d_refused = 0;
    stream_clock d_clock;
    clock::time_point d_reported_at;
    uint64_t d_reported_samples = 0;
    uint64_t d_samples = 0;        // of this run, or of the last one after it has stopped
    double d_real_time_factor = 0; // over the last report
    kernel::emulator::levels d_levels, d_reported_levels; // since the last report, and of it

    void schedule(kernel::link_update update);
    void take(const pmt::pmt_t& message, std::optional<int> tagged_input = std::nullopt,
              std::optional<uint64_t> tagged_offset = std::nullopt);
    void take_tags(uint64_t begin, uint64_t end);
    void forward(const tag_t& tag, int input);
    kernel::emulator::levels no_levels() const;
    void publish_status(clock::time_point now);
    pmt::pmt_t describe() const;
};

} // namespace cast
} // namespace gr
