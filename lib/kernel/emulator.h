// SPDX-License-Identifier: GPL-3.0-or-later
// A whole network of time-varying channels: y_j = sum over i of x_i * h_ij (MCHEM's equation).
#pragma once

#include "sparse.h"
#include "thread_pool.h"

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace gr
{
namespace cast
{
namespace kernel
{

// One non-zero coefficient of a link's filter.
struct tap {
    int delay; // samples, 0 … n_taps-1
    sample gain;
};

// taps[d] is the gain at a delay of d samples.
std::vector<tap> taps_from_dense(const std::vector<sample>& taps);

// Throws std::invalid_argument where the lengths differ.
std::vector<tap> taps_from_sparse(const std::vector<int>& delays, const std::vector<sample>& gains);

// A change of one link, in force from sample `at` on (absent: the next sample). What is absent
// stays as it was.
struct link_update {
    int input = 0, output = 0;
    std::optional<uint64_t> at;
    std::optional<std::vector<tap>> taps;
    std::optional<bool> enabled;
    // From `at` on the taps move in a straight line and arrive after this many samples; 0: at once.
    uint64_t ramp = 0;
};

class emulator
{
public:
    struct config {
        int n_inputs = 1;
        int n_outputs = 1;
        int n_taps = 512;
        int n_threads = 1;
        std::string isa = "auto";
    };

    // Throws std::invalid_argument where a parameter is out of its range.
    static void check(const config& c);

    explicit emulator(const config& c);

    // Throws std::invalid_argument on a malformed update.
    void check(const link_update& update) const;

    // Queues a change, after check(). One for a sample before `earliest` or already out counts as
    // late, and takes force at the first sample that it still can.
    void schedule(link_update update, uint64_t earliest = 0);

    // The next n samples of every output. in[i] points at the first of them, and the n_taps-1
    // samples before it must be readable (zeros before the first sample of all).
    void process(const sample* const* in, sample* const* out, std::size_t n);

    // The next sample is number `position`, for a stream that begins anew or elsewhere. Ramps
    // arrive at once.
    void seek(uint64_t position);

    uint64_t n_processed() const { return d_position; }
    uint64_t n_late() const { return d_late; }
    std::size_t n_pending() const { return d_pending.size(); }
    int n_active_links() const;
    int n_active_taps() const;
    std::string plan() const;
    const config& configuration() const { return d_config; }

private:
    struct link {
        std::vector<tap> taps;  // where a ramp arrives, or has arrived
        std::vector<tap> slope; // while a ramp runs: change of each tap over the whole of it
        uint64_t ramp_begin = 0, ramp_end = 0;
        bool enabled = true;
    };
    // Paths whose gains grow from 0 to 1 times their gain between two samples.
    struct ramp {
        uint64_t begin, end;
        std::vector<path> paths;
    };
    // What one output is made of while no update changes it.
    struct recipe {
        std::vector<path> paths;
        std::vector<ramp> ramps;
        bool is_copy = false; // one tap of exactly 1 and nothing else: to the last bit, NaN too
    };
    // Samples over which no recipe changes.
    struct segment {
        uint64_t begin, end;
        std::vector<std::shared_ptr<const recipe>> outputs;
    };

    const config d_config;
    const isa d_isa;
    thread_pool d_threads;
    std::vector<link> d_links; // [output * n_inputs + input]
    std::vector<std::shared_ptr<const recipe>> d_recipes;
    std::vector<bool> d_changed;
    std::multimap<uint64_t, link_update> d_pending; // equal samples keep their order: the last wins
    uint64_t d_position = 0;
    uint64_t d_late = 0;

    link& link_at(int input, int output) { return d_links[output * d_config.n_inputs + input]; }
    void apply(link_update&& update);
    void apply_due();
    std::shared_ptr<const recipe> make_recipe(int output) const;
    uint64_t next_change(uint64_t limit) const;
    segment next_segment(uint64_t limit);
    void mix(const recipe& r, const sample* const* in, sample* out, uint64_t begin,
             std::size_t n) const;
};

} // namespace kernel
} // namespace cast
} // namespace gr
