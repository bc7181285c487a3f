// SPDX-License-Identifier: GPL-3.0-or-later
// Tap updates as they arrive in messages and tags.
#pragma once

#include "device_time.h"
#include "kernel/emulator.h"
#include <pmt/pmt.h>

namespace gr
{
namespace cast
{

// Which sample a device time names, by the last `rx_time` tag.
struct stream_clock {
    double sample_rate_hz;
    uint64_t offset = 0; // sample at which it was `time`
    device_time time = {};

    // Takes the value of an rx_time tag; false where it is malformed.
    bool set(uint64_t at, const pmt::pmt_t& rx_time);

    // Another rate from sample `at` on, which is when it was at the rate before.
    void change_rate(uint64_t at, double new_rate_hz);

    // The sample at the time `named`; before the first sample of all counts as sample 0.
    // Throws std::invalid_argument where it is malformed.
    uint64_t sample_at(const pmt::pmt_t& named) const;
};

// Reads a dictionary or a list of them (channel_emulator.h has the keys). `default_tx` and
// `tag_offset` come from the tag that carried it. Throws std::exception on the first malformed
// entry.
std::vector<kernel::link_update>
read_link_updates(const pmt::pmt_t& message, const stream_clock& clock,
                  std::optional<int> default_tx = std::nullopt,
                  std::optional<uint64_t> tag_offset = std::nullopt);

} // namespace cast
} // namespace gr
