// SPDX-License-Identifier: GPL-3.0-or-later
#include "emulator.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>

namespace gr
{
namespace cast
{
namespace kernel
{

namespace
{

// Outputs take turns over this many samples, so that the inputs they share stay in the cache.
constexpr std::size_t tile = 384;

void require(bool holds, const std::string& name, long got, const std::string& limit)
{
    if (!holds)
        throw std::invalid_argument(name + ": got " + std::to_string(got) + ", expected " + limit);
}

// a + scale * b, delay by delay, in order of delay, without zeros.
std::vector<tap> sum_by_delay(const std::vector<tap>& a, const std::vector<tap>& b, float scale)
{
    std::map<int, sample> gains;
    for (const tap& t : a)
        gains[t.delay] += t.gain;
    for (const tap& t : b)
        gains[t.delay] += scale * t.gain;
    std::vector<tap> sum;
    for (const auto& [delay, gain] : gains)
        if (gain != sample(0))
            sum.push_back({delay, gain});
    return sum;
}

} // namespace

std::vector<tap> taps_from_dense(const std::vector<sample>& taps)
{
    std::vector<tap> sparse;
    for (std::size_t delay = 0; delay < taps.size(); delay++)
        if (taps[delay] != sample(0))
            sparse.push_back({int(delay), taps[delay]});
    return sparse;
}

std::vector<tap> taps_from_sparse(const std::vector<int>& delays, const std::vector<sample>& gains)
{
    if (delays.size() != gains.size())
        throw std::invalid_argument("taps: got " + std::to_string(delays.size()) + " delays and " +
                                    std::to_string(gains.size()) + " gains, expected as many");
    std::vector<tap> sparse;
    for (std::size_t p = 0; p < delays.size(); p++)
        sparse.push_back({delays[p], gains[p]});
    return sparse;
}

void emulator::check(const config& c)
{
    require(c.n_inputs >= 1, "n_inputs", c.n_inputs, "1 or more");
    require(c.n_outputs >= 1, "n_outputs", c.n_outputs, "1 or more");
    require(c.n_taps >= 1, "n_taps", c.n_taps, "1 or more");
    require(c.n_threads >= 1, "n_threads", c.n_threads, "1 or more");
}

emulator::emulator(const config& c)
    : d_config((check(c), c)), d_isa(isa_from_name(c.isa)), d_threads(c.n_threads),
      d_links(static_cast<std::size_t>(c.n_inputs) * c.n_outputs), d_recipes(c.n_outputs),
      d_changed(c.n_outputs, true)
{
}

void emulator::check(const link_update& update) const
{
    require(update.input >= 0 && update.input < d_config.n_inputs, "input", update.input,
            "0 to " + std::to_string(d_config.n_inputs - 1));
    require(update.output >= 0 && update.output < d_config.n_outputs, "output", update.output,
            "0 to " + std::to_string(d_config.n_outputs - 1));
    for (const tap& t : update.taps.value_or(std::vector<tap>{})) {
        require(t.delay >= 0 && t.delay < d_config.n_taps, "delay", t.delay,
                "0 to " + std::to_string(d_config.n_taps - 1) + " samples");
        if (!std::isfinite(t.gain.real()) || !std::isfinite(t.gain.imag()))
            throw std::invalid_argument("gain of the tap at delay " + std::to_string(t.delay) +
                                        ": not a finite number");
    }
}

void emulator::schedule(link_update update, uint64_t earliest)
{
    check(update);
    if (update.taps)
        update.taps = sum_by_delay(*update.taps, {}, 0.0f);
    earliest = std::max(earliest, d_position);
    if (update.at && *update.at < earliest)
        d_late++;
    const uint64_t at = std::max(update.at.value_or(earliest), earliest);
    update.at = at;
    d_pending.emplace(at, std::move(update));
    if (at == d_position)
        apply_due();
}

void emulator::seek(uint64_t position)
{
    if (position == d_position)
        return;
    for (link& l : d_links)
        l.slope.clear();
    d_changed.assign(d_changed.size(), true);
    d_position = position;
}

void emulator::apply(link_update&& update)
{
    link& l = link_at(update.input, update.output);
    d_changed[update.output] = true;
    if (update.enabled)
        l.enabled = *update.enabled;
    if (!update.taps)
        return;
    std::vector<tap> now = l.taps;
    if (!l.slope.empty()) { // an update in mid-ramp starts from where the taps are now
        const double left = double(l.ramp_end - d_position) / double(l.ramp_end - l.ramp_begin);
        now = sum_by_delay(l.taps, l.slope, -float(left));
    }
    l.slope.clear();
    l.taps = std::move(*update.taps);
    if (update.ramp > 0) {
        l.slope = sum_by_delay(l.taps, now, -1.0f);
        l.ramp_begin = d_position;
        l.ramp_end = d_position + update.ramp;
    }
}

// Brings every change due at d_position into force, in the order in which they came.
void emulator::apply_due()
{
    for (std::size_t i = 0; i < d_links.size(); i++) {
        link& l = d_links[i];
        if (!l.slope.empty() && l.ramp_end <= d_position) {
            l.slope.clear();
            d_changed[i / d_config.n_inputs] = true;
        }
    }
    while (!d_pending.empty() && d_pending.begin()->first <= d_position)
        apply(std::move(d_pending.extract(d_pending.begin()).mapped()));
}

std::shared_ptr<const emulator::recipe> emulator::make_recipe(int output) const
{
    auto made = std::make_shared<recipe>();
    for (int input = 0; input < d_config.n_inputs; input++) {
        const link& l = d_links[output * d_config.n_inputs + input];
        if (!l.enabled)
            continue;
        // taps(n) = (taps - slope) + slope * (n - begin) / (end - begin)
        for (const tap& t : l.slope.empty() ? l.taps : sum_by_delay(l.taps, l.slope, -1.0f))
            made->paths.push_back({input, t.delay, t.gain});
        if (l.slope.empty())
            continue;
        auto same = std::find_if(made->ramps.begin(), made->ramps.end(), [&](const ramp& r) {
            return r.begin == l.ramp_begin && r.end == l.ramp_end;
        });
        if (same == made->ramps.end())
            same = made->ramps.insert(same, {l.ramp_begin, l.ramp_end, {}});
        for (const tap& t : l.slope)
            same->paths.push_back({input, t.delay, t.gain});
    }
    const auto& p = made->paths;
    made->is_copy = p.size() == 1 && made->ramps.empty() && p[0].gain == sample(1);
    return made;
}

// First sample after d_position at which some output changes, or `limit`.
uint64_t emulator::next_change(uint64_t limit) const
{
    if (!d_pending.empty())
        limit = std::min(limit, d_pending.begin()->first);
    for (const link& l : d_links)
        if (!l.slope.empty())
            limit = std::min(limit, l.ramp_end);
    return limit;
}

emulator::segment emulator::next_segment(uint64_t limit)
{
    apply_due();
    for (int j = 0; j < d_config.n_outputs; j++)
        if (d_changed[j]) {
            d_recipes[j] = make_recipe(j);
            d_changed[j] = false;
        }
    return {d_position, next_change(limit), d_recipes};
}

// in[i] and out point at sample `begin`; at most one tile.
void emulator::mix(const recipe& r, const sample* const* in, sample* out, uint64_t begin,
                   std::size_t n) const
{
    if (r.is_copy) {
        std::memcpy(out, in[r.paths[0].input] - r.paths[0].delay, n * sizeof(sample));
        return;
    }
    mix_sparse(d_isa, in, r.paths.data(), r.paths.size(), out, n);
    for (const ramp& slope : r.ramps) {
        sample full[tile];
        mix_sparse(d_isa, in, slope.paths.data(), slope.paths.size(), full, n);
        const double length = double(slope.end - slope.begin);
        for (std::size_t k = 0; k < n; k++)
            out[k] += float(double(begin + k - slope.begin) / length) * full[k];
    }
}

void emulator::process(const sample* const* in, sample* const* out, std::size_t n)
{
    const uint64_t first = d_position;
    while (d_position < first + n) {
        const segment part = next_segment(first + n);
        const unsigned n_tiles = (part.end - part.begin + tile - 1) / tile;
        d_threads.run(n_tiles, [&](unsigned t) {
            const uint64_t begin = part.begin + t * tile;
            const std::size_t length = std::min<uint64_t>(tile, part.end - begin);
            std::vector<const sample*> x(in, in + d_config.n_inputs);
            for (auto& pointer : x)
                pointer += begin - first;
            for (int j = 0; j < d_config.n_outputs; j++)
                mix(*part.outputs[j], x.data(), out[j] + (begin - first), begin, length);
        });
        d_position = part.end;
    }
}

int emulator::n_active_links() const
{
    return std::count_if(d_links.begin(), d_links.end(), [](const link& l) {
        return l.enabled && !(l.taps.empty() && l.slope.empty());
    });
}

int emulator::n_active_taps() const
{
    int n = 0;
    for (const link& l : d_links)
        n += l.enabled ? l.taps.size() : 0;
    return n;
}

std::string emulator::plan() const
{
    return "sparse direct form, " + std::string(isa_name(d_isa)) + ", " +
           std::to_string(d_threads.size()) + (d_threads.size() == 1 ? " thread" : " threads");
}

} // namespace kernel
} // namespace cast
} // namespace gr
