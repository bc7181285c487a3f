// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cmath>
#include <cstdint>
#include <optional>
#include <pmt/pmt.h>

namespace gr
{
namespace cast
{

// A moment on a radio's clock, kept in two parts: a double alone loses the sample after hours.
struct device_time {
    uint64_t seconds = 0;
    double fraction = 0;
};

// The value of an rx_time tag, a tuple of whole and fractional seconds; nothing where it is
// malformed.
inline std::optional<device_time> read_device_time(const pmt::pmt_t& value)
{
    if (!pmt::is_tuple(value) || pmt::length(value) != 2)
        return std::nullopt;
    const pmt::pmt_t seconds = pmt::tuple_ref(value, 0), fraction = pmt::tuple_ref(value, 1);
    if (!(pmt::is_uint64(seconds) || (pmt::is_integer(seconds) && pmt::to_long(seconds) >= 0)) ||
        !pmt::is_real(fraction) || !std::isfinite(pmt::to_double(fraction)))
        return std::nullopt;
    return device_time{pmt::to_uint64(seconds), pmt::to_double(fraction)};
}

} // namespace cast
} // namespace gr
