// SPDX-License-Identifier: GPL-3.0-or-later
#include "link_update_pmt.h"
#include <cmath>
#include <set>
#include <stdexcept>

namespace gr
{
namespace cast
{

namespace
{

[[noreturn]] void refuse(const std::string& what) { throw std::invalid_argument(what); }

pmt::pmt_t find(const pmt::pmt_t& dict, const char* key)
{
    return pmt::dict_ref(dict, pmt::intern(key), pmt::PMT_NIL);
}

bool has(const pmt::pmt_t& dict, const char* key)
{
    return pmt::dict_has_key(dict, pmt::intern(key));
}

int read_node(const pmt::pmt_t& dict, const char* key, std::optional<int> otherwise)
{
    if (!has(dict, key) && otherwise)
        return *otherwise;
    const pmt::pmt_t value = find(dict, key);
    if (!pmt::is_integer(value))
        refuse(std::string(key) + ": got " + pmt::write_string(value) + ", expected an integer");
    const long node = pmt::to_long(value);
    return node < 0 || node > 1'000'000 ? -1 : static_cast<int>(node); // check() refuses -1
}

uint64_t read_count(const pmt::pmt_t& dict, const char* key)
{
    const pmt::pmt_t value = find(dict, key);
    if (!(pmt::is_uint64(value) || (pmt::is_integer(value) && pmt::to_long(value) >= 0)))
        refuse(std::string(key) + ": got " + pmt::write_string(value) +
               ", expected a whole number of samples, 0 or more");
    return pmt::to_uint64(value);
}

std::vector<kernel::sample> read_complex(const pmt::pmt_t& dict, const char* key)
{
    const pmt::pmt_t value = find(dict, key);
    if (pmt::is_c32vector(value))
        return pmt::c32vector_elements(value);
    if (pmt::is_c64vector(value)) {
        const auto wide = pmt::c64vector_elements(value);
        return std::vector<kernel::sample>(wide.begin(), wide.end());
    }
    refuse(std::string(key) + ": expected a complex vector");
}

std::vector<int> read_delays(const pmt::pmt_t& value)
{
    if (pmt::is_s32vector(value)) {
        const auto delays = pmt::s32vector_elements(value);
        return std::vector<int>(delays.begin(), delays.end());
    }
    if (!pmt::is_uniform_vector(value) && !pmt::is_vector(value) && !pmt::is_pair(value))
        refuse("delays: expected a vector of integers");
    std::vector<int> delays;
    for (size_t i = 0; i < pmt::length(value); i++) {
        const pmt::pmt_t delay =
            pmt::is_pair(value) ? pmt::nth(i, value) : pmt::vector_ref(value, i);
        const long samples = pmt::is_integer(delay) ? pmt::to_long(delay) : -1;
        delays.push_back(samples < 0 || samples > 1'000'000'000 ? -1 : static_cast<int>(samples));
    }
    return delays;
}

std::optional<std::vector<kernel::tap>> read_taps(const pmt::pmt_t& dict)
{
    if (has(dict, "taps"))
        return kernel::taps_from_dense(read_complex(dict, "taps"));
    if (has(dict, "delays") || has(dict, "gains"))
        return kernel::taps_from_sparse(read_delays(find(dict, "delays")),
                                        read_complex(dict, "gains"));
    return std::nullopt;
}

kernel::link_update read_one(const pmt::pmt_t& dict, const stream_clock& clock,
                             std::optional<int> default_tx, std::optional<uint64_t> tag_offset)
{
    static const std::set<std::string> known = {
        "tx", "rx", "taps", "delays", "gains", "enabled", "base_loss_db", "offset", "time", "ramp"};
    if (!pmt::is_dict(dict) || pmt::is_null(dict))
        refuse("expected a dictionary");
    for (pmt::pmt_t keys = pmt::dict_keys(dict); pmt::is_pair(keys); keys = pmt::cdr(keys))
        if (!pmt::is_symbol(pmt::car(keys)) || !known.count(pmt::symbol_to_string(pmt::car(keys))))
            refuse("unknown key " + pmt::write_string(pmt::car(keys)));
    kernel::link_update update;
    update.input = read_node(dict, "tx", default_tx);
    update.output = read_node(dict, "rx", std::nullopt);
    update.taps = read_taps(dict);
    if (has(dict, "enabled")) {
        if (!pmt::is_bool(find(dict, "enabled")))
            refuse("enabled: expected a boolean");
        update.enabled = pmt::to_bool(find(dict, "enabled"));
    }
    if (has(dict, "base_loss_db")) {
        if (!pmt::is_real(find(dict, "base_loss_db")))
            refuse("base_loss_db: expected a real number");
        update.gain = kernel::gain_of_loss(pmt::to_double(find(dict, "base_loss_db")));
    }
    if (!update.taps && !update.enabled && !update.gain)
        refuse("neither taps nor enabled nor base_loss_db given");
    update.at = tag_offset;
    if (has(dict, "offset"))
        update.at = read_count(dict, "offset");
    else if (has(dict, "time"))
        update.at = clock.sample_at(find(dict, "time"));
    if (has(dict, "ramp"))
        update.ramp = read_count(dict, "ramp");
    return update;
}

} // namespace

bool stream_clock::set(uint64_t at, const pmt::pmt_t& rx_time)
{
    const auto read = read_device_time(rx_time);
    if (!read)
        return false;
    offset = at;
    time = *read;
    return true;
}

void stream_clock::change_rate(uint64_t at, double new_rate_hz)
{
    const double fraction =
        time.fraction + double(int64_t(at - offset)) / sample_rate_hz; // of either sign
    const double whole = std::floor(fraction);
    time = {time.seconds + uint64_t(int64_t(whole)), fraction - whole};
    offset = at;
    sample_rate_hz = new_rate_hz;
}

uint64_t stream_clock::sample_at(const pmt::pmt_t& named) const
{
    const auto then = read_device_time(named);
    if (!then)
        refuse("time: got " + pmt::write_string(named) + ", expected (whole, fractional) seconds");
    // Whole seconds apart: a double of both would lose the sample after some hours.
    const double later_s =
        double(int64_t(then->seconds - time.seconds)) + (then->fraction - time.fraction);
    const double later = std::round(later_s * sample_rate_hz);
    if (!(later < 4e18))
        refuse("time: got " + pmt::write_string(named) + ", beyond the last sample");
    return double(offset) + later < 0 ? 0 : offset + static_cast<int64_t>(later);
}

std::vector<kernel::link_update> read_link_updates(const pmt::pmt_t& message,
                                                   const stream_clock& clock,
                                                   std::optional<int> default_tx,
                                                   std::optional<uint64_t> tag_offset)
{
    std::vector<kernel::link_update> updates;
    const auto read = [&](const pmt::pmt_t& dict) {
        updates.push_back(read_one(dict, clock, default_tx, tag_offset));
    };
    if (pmt::is_vector(message))
        for (size_t i = 0; i < pmt::length(message); i++)
            read(pmt::vector_ref(message, i));
    else if (pmt::is_pair(message) && !pmt::is_dict(message))
        for (pmt::pmt_t rest = message; pmt::is_pair(rest); rest = pmt::cdr(rest))
            read(pmt::car(rest));
    else
        read(message);
    return updates;
}

} // namespace cast
} // namespace gr
