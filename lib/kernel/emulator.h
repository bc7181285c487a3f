// SPDX-License-Identifier: GPL-3.0-or-later
// A whole network of time-varying channels: y_j = sum over i of x_i * h_ij (MCHEM's equation).
#pragma once

#include "overlap_save.h"
#include "thread_pool.h"

#include <cstdint>
#include <gnuradio/cast/api.h>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <variant>
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
CAST_API std::vector<tap> taps_from_dense(const std::vector<sample>& taps);

// Throws std::invalid_argument where the lengths differ.
CAST_API std::vector<tap> taps_from_sparse(const std::vector<int>& delays,
                                           const std::vector<sample>& gains);

// 10^(-loss/20)
CAST_API float gain_of_loss(double loss_db);

// A change of one link, in force from sample `at` on (absent: the next sample). What is absent
// stays as it was.
struct link_update {
    int input = 0, output = 0;
    std::optional<uint64_t> at;
    std::optional<std::vector<tap>> taps;
    std::optional<bool> enabled;
    std::optional<float> gain; // of the whole link, on top of its taps: its base loss
    // From `at` on the taps move in a straight line and arrive after this many samples; 0: at once.
    uint64_t ramp = 0;
};

// Arithmetic of a fixed-point machine: samples in and out are rounded to `bits` of their full scale
// and saturate; taps have `tap_bits`, of which one is left of the binary point, so that a tap of 1
// is exact.
struct fixed_point {
    int bits = 16, tap_bits = 16;
    float input_full_scale = 1.0f, output_full_scale = 1.0f;
};

class CAST_API emulator
{
public:
    struct config {
        int n_inputs = 1;
        int n_outputs = 1;
        int n_taps = 512;
        int n_threads = 1;
        std::string isa = "auto";
        std::string method = "auto"; // or "sparse" or "dense"
        uint64_t seed = 0;           // of the receivers' noise
    };

    // Throws std::invalid_argument where a parameter is out of its range.
    static void check(const config& c);

    explicit emulator(const config& c);
    ~emulator();

    // Throws std::invalid_argument on a malformed update.
    void check(const link_update& update) const;

    // Queues a change, after check(). One for a sample before `earliest` or already out counts as
    // late, and takes force at the first sample that it still can.
    void schedule(link_update update, uint64_t earliest = 0);

    // Queues taps for all links at once, n of each; those of a link are in row
    // input * n_outputs + output. As one update per link, but without an allocation for each.
    void schedule_all(uint64_t at, const int* delays, const sample* gains, std::size_t n);

    // From the next sample on no link has taps, and no update is pending.
    void clear();

    // Mean power of the noise that a receiver adds from the next sample on, in units of the samples
    // squared. Equal seeds give equal noise at equal samples, whatever the chunks; receivers are
    // independent.
    void set_noise_power(int output, float power);

    // From the next sample on. Throws std::invalid_argument where a parameter is out of its range.
    void set_fixed_point(const std::optional<fixed_point>& arithmetic);

    // Powers of what goes in and of what comes out.
    struct levels {
        std::vector<level> inputs, outputs;
    };

    // The next n samples of every output. in[i] points at the first of them, and the n_taps-1
    // samples before it must be readable (zeros before the first sample of all). What `measured`
    // points at is added to, one level for every port.
    void process(const sample* const* in, sample* const* out, std::size_t n,
                 levels* measured = nullptr);

    // The next sample is number `position`, for a stream that begins anew or elsewhere. Ramps
    // arrive at once.
    void seek(uint64_t position);

    // On to sample number `position` as if all before had been processed: updates and ramps take
    // their course.
    void skip_to(uint64_t position);

    uint64_t n_processed() const { return d_position; }
    uint64_t n_late() const { return d_late; }
    uint64_t n_clipped() const { return d_clipped; }
    int n_active_links() const;
    int n_active_taps() const;
    std::string plan() const;
    const config& configuration() const { return d_config; }

private:
    // A part of taps that came in one piece, which is there as long as somebody needs it.
    struct tap_span {
        std::shared_ptr<const std::vector<tap>> whole;
        const tap *first = nullptr, *last = nullptr;

        bool empty() const { return first == last; }
        std::size_t size() const { return last - first; }
        std::vector<tap> copy() const { return {first, last}; }
    };
    struct link {
        tap_span taps;          // where a ramp arrives, or has arrived
        std::vector<tap> slope; // while a ramp runs: change of each tap over the whole of it
        uint64_t ramp_begin = 0, ramp_end = 0;
        bool enabled = true;
        float gain = 1.0f;
    };
    // What an output hears, as paths and as spectra; these are made when first used.
    struct mixture {
        path_list paths;
        dense_filter filter;

        void clear();
    };
    // A mixture that grows from 0 to 1 times itself between two samples.
    struct ramp : mixture {
        uint64_t begin, end;
    };
    // What one output is made of while no update changes it.
    struct recipe : mixture {
        std::vector<ramp> ramps;
        bool is_copy = false; // one tap of exactly 1 and nothing else: to the last bit, NaN too
        uint64_t born = 0;
        uint64_t expected_life = 0; // samples
    };
    // Samples of one output made by one recipe in one way.
    struct piece {
        uint64_t begin, end;
        std::shared_ptr<recipe> made_by;
        bool dense;
    };
    // A filter over some blocks of a piece.
    struct dense_job {
        const piece* of;
        int output;
        const dense_filter* filter;
        const ramp* of_ramp; // nullptr: the piece's own filter
        int block, n_blocks;
    };
    using shelf = std::vector<std::unique_ptr<recipe>>;
    using pieces = std::vector<std::vector<piece>>; // [output]

    const config d_config;
    const isa d_isa;
    thread_pool d_threads;
    bool d_worth_sharing = false; // the round at hand, among threads
    const bool d_may_be_sparse, d_may_be_dense;
    overlap_save d_dense;
    spectra d_spectra;         // of the round at hand: [block][input]
    spectra d_products;        // [job][block]
    std::vector<link> d_links; // [output * n_inputs + input]
    // Recipes whose memory is free; before all that holds recipes.
    const std::shared_ptr<shelf> d_spare = std::make_shared<shelf>();
    std::vector<std::shared_ptr<recipe>> d_recipes;
    std::vector<bool> d_changed;
    // Of all links, n each, [input][output][n]: in order of delay, without zeros.
    struct tap_table {
        std::size_t n;
        std::vector<tap> taps;
    };
    // By their sample; equal samples keep their order: the last wins.
    std::map<uint64_t, std::vector<std::variant<link_update, tap_table>>> d_pending;
    // Memory for the next tables.
    const std::shared_ptr<std::vector<std::vector<tap>>> d_spare_taps =
        std::make_shared<std::vector<std::vector<tap>>>();
    bool d_ramps = false; // some link has a slope
    uint64_t d_position = 0;
    uint64_t d_late = 0;
    std::atomic<uint64_t> d_clipped{0};
    std::vector<float> d_noise_power;
    std::optional<fixed_point> d_fixed_point;
    std::vector<std::vector<sample>> d_quantized; // inputs of the round at hand, after their past
    std::vector<bool> d_transformed; // blocks of the round at hand, with their inputs measured
    std::vector<level> d_seen;       // by every job at hand

    link& link_at(int input, int output) { return d_links[output * d_config.n_inputs + input]; }
    uint64_t in_time(std::optional<uint64_t> at, uint64_t earliest, std::size_t n_links);
    void apply(link_update&& update);
    void apply(tap_table&& table);
    tap_span keep(std::vector<tap>&& taps) const;
    void apply_due();
    std::shared_ptr<recipe> new_recipe() const;
    std::shared_ptr<recipe> make_recipe(int output) const;
    uint64_t next_change(uint64_t limit) const;
    pieces cut(uint64_t end);
    double sparse_cost(const piece& p) const;
    double dense_cost(const piece& p, uint64_t first) const;
    double choose(pieces& all, uint64_t first, std::size_t n) const;
    void share(unsigned n_jobs, const std::function<void(unsigned)>& job);
    void hear(int input, const link& l, const tap* first, const tap* last, mixture& made) const;
    std::vector<const sample*> quantize_inputs(const sample* const* in, std::size_t n);
    void finish(int output, sample* out, uint64_t begin, std::size_t n, level* measured);
    void round(const sample* const* in, sample* const* out, std::size_t n, levels* measured);
    // `came` are the inputs as they came, measured into `measured` unless that is nullptr.
    void run_dense(const pieces& all, const sample* const* in, sample* const* out, uint64_t first,
                   std::size_t at, std::size_t n, const sample* const* came, levels* measured);
    void run_tiles(const pieces& all, const sample* const* in, sample* const* out, uint64_t first,
                   std::size_t n, const sample* const* came, levels* measured);
    void measure_tile(const sample* came, std::size_t at, std::size_t n, level& seen) const;
    void mix_tile(const std::vector<piece>& of_output, int output, const sample* const* in,
                  sample* out, uint64_t first, std::size_t at, std::size_t n, level* measured,
                  const sample* soon);
    void mix_parts(const sample* const* in, const path_list& paths, sample* out, std::size_t n,
                   const sample* soon) const;
    void mix_sparse(const recipe& r, const sample* const* in, sample* out, uint64_t begin,
                    std::size_t n, const sample* soon) const;
    void make_filters(const std::vector<recipe*>& without);
    void put_block(const ramp* of_ramp, std::size_t product, uint64_t begin, std::size_t from,
                   std::size_t to, sample* out);
};

} // namespace kernel
} // namespace cast
} // namespace gr
