// SPDX-License-Identifier: GPL-3.0-or-later
#include "emulator.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <utility>

namespace gr
{
namespace cast
{
namespace kernel
{

namespace
{

// Outputs take turns over at most this many samples, so that the inputs they share stay in the
// cache.
constexpr std::size_t largest_tile = 1152;

constexpr std::size_t paths_in_part = 128; // whose products one running sum takes

// As many tiles as give every thread its share, in whole register blocks.
std::size_t tile_length(std::size_t n, std::size_t n_threads)
{
    const std::size_t turns = (n + largest_tile * n_threads - 1) / (largest_tile * n_threads);
    const std::size_t share = (n + turns * n_threads - 1) / (turns * n_threads);
    return (share + 95) / 96 * 96;
}

// Parts of the spectrum that threads share the products in.
constexpr std::size_t n_slices = 8;

// What one step takes on an AVX-512 core of 3.6 GHz, in nanoseconds; the planner needs their ratios
// alone.
namespace cost
{
constexpr double tap = 0.078; // of one sample
constexpr double wake_threads = 60000;
// Transforms fill a core's vector units: what shares its core with them gains them little.
constexpr double wake_threads_for_transforms = 150000;
double transform(double n_bins) { return 2200 * n_bins * std::log2(n_bins) / (2048 * 11); }
double product(double n_bins) { return 220 * n_bins / 2048; }
} // namespace cost

constexpr uint64_t most_samples = uint64_t(1) << 62;

void require(bool holds, const std::string& name, long got, const std::string& limit)
{
    if (!holds)
        throw std::invalid_argument(name + ": got " + std::to_string(got) + ", expected " + limit);
}

// One tap per delay, in order of delay, without zeros.
void tidy(std::vector<tap>& taps)
{
    int before = -1;
    bool is_tidy = true;
    for (const tap& t : taps) {
        is_tidy &= t.delay > before && t.gain != sample(0);
        before = t.delay;
    }
    if (is_tidy)
        return;
    const auto by_delay = [](const tap& a, const tap& b) { return a.delay < b.delay; };
    if (!std::is_sorted(taps.begin(), taps.end(), by_delay))
        std::stable_sort(taps.begin(), taps.end(), by_delay);
    std::size_t kept = 0;
    for (std::size_t k = 0; k < taps.size();) {
        tap sum = taps[k++];
        for (; k < taps.size() && taps[k].delay == sum.delay; k++)
            sum.gain += taps[k].gain;
        if (sum.gain != sample(0))
            taps[kept++] = sum;
    }
    taps.resize(kept);
}

// a + scale * b, delay by delay.
std::vector<tap> sum_by_delay(std::vector<tap> a, const std::vector<tap>& b, float scale)
{
    for (const tap& t : b)
        a.push_back({t.delay, scale * t.gain});
    tidy(a);
    return a;
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

float gain_of_loss(double loss_db) { return float(std::pow(10.0, -loss_db / 20)); }

std::vector<tap> taps_from_sparse(const std::vector<int>& delays, const std::vector<sample>& gains)
{
    if (delays.size() != gains.size())
        throw std::invalid_argument("taps: got " + std::to_string(delays.size()) + " delays and " +
                                    std::to_string(gains.size()) + " gains, expected as many");
    std::vector<tap> sparse;
    sparse.reserve(delays.size());
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
    if (c.method != "auto" && c.method != "sparse" && c.method != "dense")
        throw std::invalid_argument("method: got '" + c.method +
                                    "', expected auto, sparse or dense");
}

emulator::emulator(const config& c)
    : d_config((check(c), c)), d_isa(isa_from_name(c.isa)), d_threads(c.n_threads),
      d_may_be_sparse(c.method != "dense"), d_may_be_dense(c.method != "sparse"),
      d_dense(c.n_taps, d_isa), d_links(static_cast<std::size_t>(c.n_inputs) * c.n_outputs),
      d_recipes(c.n_outputs), d_changed(c.n_outputs, true), d_noise_power(c.n_outputs)
{
}

emulator::~emulator() = default;

void emulator::check(const link_update& update) const
{
    const auto refuse_node = [](const char* name, int got, int n) {
        require(false, name, got, "0 to " + std::to_string(n - 1));
    };
    if (update.input < 0 || update.input >= d_config.n_inputs)
        refuse_node("tx", update.input, d_config.n_inputs);
    if (update.output < 0 || update.output >= d_config.n_outputs)
        refuse_node("rx", update.output, d_config.n_outputs);
    const uint64_t count = std::max(update.ramp, update.at.value_or(0));
    if (count > most_samples) // the end of a ramp is a sample's number, too
        throw std::invalid_argument("offset or ramp: got " + std::to_string(count) +
                                    " samples, expected 2^62 or less");
    if (update.gain && !std::isfinite(*update.gain))
        throw std::invalid_argument("gain of the link: not a finite number");
    if (!update.taps)
        return;
    // One pass without a branch first: nearly always nothing is wrong.
    bool holds = true;
    for (const tap& t : *update.taps)
        holds &= unsigned(t.delay) < unsigned(d_config.n_taps) &&
                 std::isfinite(t.gain.real() - t.gain.real() + t.gain.imag() - t.gain.imag());
    if (holds)
        return;
    for (const tap& t : *update.taps) {
        if (t.delay < 0 || t.delay >= d_config.n_taps)
            require(false, "delay", t.delay,
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
        tidy(*update.taps);
    const uint64_t at = in_time(update.at, earliest, 1);
    update.at = at;
    d_pending[at].emplace_back(std::move(update));
    if (at == d_position)
        apply_due();
}

// The first sample that a change asked for can still have; counts what is late.
uint64_t emulator::in_time(std::optional<uint64_t> at, uint64_t earliest, std::size_t n_links)
{
    earliest = std::max(earliest, d_position);
    if (at && *at < earliest)
        d_late += n_links;
    return std::max(at.value_or(earliest), earliest);
}

void emulator::schedule_all(uint64_t at, const int* delays, const sample* gains, std::size_t n)
{
    tap_table table{n, {}};
    if (!d_spare_taps->empty()) {
        table.taps = std::move(d_spare_taps->back());
        d_spare_taps->pop_back();
    }
    table.taps.resize(d_links.size() * n);
    bool holds = at <= most_samples;
    for (std::size_t row = 0; row < d_links.size(); row++) {
        const int* delay = delays + row * n;
        const sample* gain = gains + row * n;
        tap* made = table.taps.data() + row * n;
        bool wrong = n > 0 && (delay[0] < 0 || delay[n - 1] >= d_config.n_taps);
        for (std::size_t k = 1; k < n; k++)
            wrong |= delay[k] <= delay[k - 1];
        for (std::size_t k = 0; k < n; k++) {
            const float sum = std::abs(gain[k].real()) + std::abs(gain[k].imag());
            wrong |= !(sum > 0 && sum - sum == 0);
            made[k] = {delay[k], gain[k]};
        }
        holds &= !wrong;
    }
    if (!holds) { // link by link, which sorts them, or says what is wrong
        for (std::size_t row = 0; row < d_links.size(); row++) {
            const tap* first = table.taps.data() + row * n;
            schedule({int(row) / d_config.n_outputs, int(row) % d_config.n_outputs, at,
                      std::vector<tap>(first, first + n), std::nullopt, std::nullopt, 0});
        }
        return;
    }
    at = in_time(at, 0, d_links.size());
    d_pending[at].emplace_back(std::move(table));
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

void emulator::skip_to(uint64_t position)
{
    cut(position);
    apply_due();
}

void emulator::clear()
{
    d_pending.clear();
    d_links.assign(d_links.size(), {});
    d_changed.assign(d_changed.size(), true);
}

void emulator::set_noise_power(int output, float power)
{
    require(output >= 0 && output < d_config.n_outputs, "rx", output,
            "0 to " + std::to_string(d_config.n_outputs - 1));
    if (!(power >= 0 && std::isfinite(power)))
        throw std::invalid_argument("noise power: got " + std::to_string(power) +
                                    ", expected a finite number, 0 or more");
    d_noise_power[output] = power;
}

void emulator::set_fixed_point(const std::optional<fixed_point>& arithmetic)
{
    if (arithmetic) {
        require(arithmetic->bits >= 2 && arithmetic->bits <= 24, "bits", arithmetic->bits,
                "2 to 24");
        require(arithmetic->tap_bits >= 2 && arithmetic->tap_bits <= 24, "tap_bits",
                arithmetic->tap_bits, "2 to 24");
        for (float scale : {arithmetic->input_full_scale, arithmetic->output_full_scale})
            if (!(scale > 0 && std::isfinite(scale)))
                throw std::invalid_argument("full scale: got " + std::to_string(scale) +
                                            ", expected a finite number above 0");
    }
    d_fixed_point = arithmetic;
    d_changed.assign(d_changed.size(), true);
}

void emulator::apply(link_update&& update)
{
    link& l = link_at(update.input, update.output);
    d_changed[update.output] = true;
    if (update.enabled)
        l.enabled = *update.enabled;
    if (update.gain)
        l.gain = *update.gain;
    if (!update.taps)
        return;
    const auto before = std::exchange(l.taps, keep(std::move(*update.taps)));
    const auto slope_before = std::exchange(l.slope, {});
    if (update.ramp > 0) { // in mid-ramp it starts from where the taps are now
        const double left = slope_before.empty() ? 0
                                                 : double(l.ramp_end - d_position) /
                                                       double(l.ramp_end - l.ramp_begin);
        const auto now = sum_by_delay(before.copy(), slope_before, -float(left));
        l.slope = sum_by_delay(l.taps.copy(), now, -1.0f);
        l.ramp_begin = d_position;
        l.ramp_end = d_position + update.ramp;
        d_ramps |= !l.slope.empty();
    }
}

emulator::tap_span emulator::keep(std::vector<tap>&& taps) const
{
    const auto whole = std::make_shared<const std::vector<tap>>(std::move(taps));
    return {whole, whole->data(), whole->data() + whole->size()};
}

// Tables come again and again, and fresh memory costs more than what is written to it.
void emulator::apply(tap_table&& table)
{
    const std::shared_ptr<const std::vector<tap>> whole(
        new std::vector<tap>(std::move(table.taps)),
        [spare = std::weak_ptr(d_spare_taps)](std::vector<tap>* done) {
            if (const auto shelf = spare.lock(); shelf && shelf->size() < 4)
                shelf->push_back(std::move(*done));
            delete done;
        });
    const tap* taps = whole->data();
    for (int input = 0; input < d_config.n_inputs; input++)
        for (int output = 0; output < d_config.n_outputs; output++, taps += table.n) {
            link& l = link_at(input, output);
            l.taps = {whole, taps, taps + table.n};
            l.slope.clear();
        }
    d_changed.assign(d_changed.size(), true);
}

// Brings every change due at d_position into force, in the order in which they came.
void emulator::apply_due()
{
    const bool ramps_before = std::exchange(d_ramps, false);
    for (std::size_t i = 0; ramps_before && i < d_links.size(); i++) {
        link& l = d_links[i];
        if (!l.slope.empty() && l.ramp_end <= d_position) {
            l.slope.clear();
            d_changed[i / d_config.n_inputs] = true;
        }
        d_ramps |= !l.slope.empty();
    }
    while (!d_pending.empty() && d_pending.begin()->first <= d_position) {
        auto due = d_pending.extract(d_pending.begin());
        for (auto& change : due.mapped())
            std::visit([&](auto& made) { apply(std::move(made)); }, change);
    }
}

void emulator::mixture::clear()
{
    paths.clear();
    filter.clear();
}

// Adds a link's taps, as they are heard, to `made_of`.
void emulator::hear(int input, const link& l, const tap* first, const tap* last,
                    mixture& made_of) const
{
    if (first == last)
        return;
    path_list& paths = made_of.paths;
    const std::size_t begin = paths.size();
    paths.resize(begin + (last - first));
    made_of.filter.inputs.push_back(input);
    made_of.filter.first.push_back(paths.size());
    path* made = paths.data() + begin;
    for (const tap* t = first; t < last; t++)
        *made++ = {input, t->delay, t->gain};
    if (d_fixed_point)
        for (std::size_t k = begin; k < paths.size(); k++)
            quantize(d_isa, &paths[k].gain, 2.0f, d_fixed_point->tap_bits, &paths[k].gain, 1);
    if (l.gain != 1.0f)
        for (std::size_t k = begin; k < paths.size(); k++)
            paths[k].gain *= l.gain;
}

// An empty one, in the memory of one that nobody needs any more: recipes come and go with every
// update, and fresh memory costs more than what is written to it.
std::shared_ptr<emulator::recipe> emulator::new_recipe() const
{
    std::unique_ptr<recipe> made;
    if (d_spare->empty())
        made = std::make_unique<recipe>();
    else {
        made = std::move(d_spare->back());
        d_spare->pop_back();
    }
    made->clear();
    made->ramps.clear();
    return {made.release(), [spare = std::weak_ptr(d_spare)](recipe* done) {
                std::unique_ptr<recipe> kept(done);
                if (const auto shelf = spare.lock())
                    shelf->push_back(std::move(kept));
            }};
}

std::shared_ptr<emulator::recipe> emulator::make_recipe(int output) const
{
    auto made = new_recipe();
    for (int input = 0; input < d_config.n_inputs; input++) {
        const link& l = d_links[output * d_config.n_inputs + input];
        if (!l.enabled)
            continue;
        // taps(n) = (taps - slope) + slope * (n - begin) / (end - begin)
        if (l.slope.empty()) {
            hear(input, l, l.taps.first, l.taps.last, *made);
            continue;
        }
        const auto begin = sum_by_delay(l.taps.copy(), l.slope, -1.0f);
        hear(input, l, begin.data(), begin.data() + begin.size(), *made);
        auto same = std::find_if(made->ramps.begin(), made->ramps.end(), [&](const ramp& r) {
            return r.begin == l.ramp_begin && r.end == l.ramp_end;
        });
        if (same == made->ramps.end()) {
            same = made->ramps.emplace(same);
            same->clear();
            same->begin = l.ramp_begin;
            same->end = l.ramp_end;
        }
        hear(input, l, l.slope.data(), l.slope.data() + l.slope.size(), *same);
    }
    const auto& p = made->paths;
    made->is_copy = p.size() == 1 && made->ramps.empty() && p[0].gain == sample(1);
    made->born = d_position;
    made->expected_life = 0;
    if (const auto& before = d_recipes[output])
        made->expected_life = d_position - before->born;
    return made;
}

// First sample after d_position at which some output changes, or `limit`.
uint64_t emulator::next_change(uint64_t limit) const
{
    if (!d_pending.empty())
        limit = std::min(limit, d_pending.begin()->first);
    if (d_ramps)
        for (const link& l : d_links)
            if (!l.slope.empty())
                limit = std::min(limit, l.ramp_end);
    return limit;
}

// The samples up to `end`, cut where an update changes an output. Leaves d_position there.
emulator::pieces emulator::cut(uint64_t end)
{
    pieces all(d_config.n_outputs);
    while (d_position < end) {
        apply_due();
        const uint64_t until = next_change(end);
        for (int j = 0; j < d_config.n_outputs; j++) {
            if (d_changed[j]) {
                d_recipes[j] = make_recipe(j);
                d_changed[j] = false;
            }
            if (!all[j].empty() && all[j].back().made_by == d_recipes[j])
                all[j].back().end = until;
            else
                all[j].push_back({d_position, until, d_recipes[j], false});
        }
        d_position = until;
    }
    return all;
}

// Cost of a piece by overlap-save, the inputs' own transforms apart, in nanoseconds of the machine
// in cost::.
double emulator::dense_cost(const piece& p, uint64_t first) const
{
    const recipe& r = *p.made_by;
    const double block = d_dense.block();
    const double n_blocks =
        (p.end - 1 - first) / d_dense.block() - (p.begin - first) / d_dense.block() + 1;
    double cost = 0, n_spectra = 0;
    const auto add = [&](const dense_filter& filter) {
        const std::size_t n_used = filter.inputs.size();
        n_spectra += n_used;
        cost += n_blocks *
                (cost::transform(d_dense.n_bins()) + n_used * cost::product(d_dense.n_bins()));
    };
    add(r.filter);
    for (const ramp& slope : r.ramps)
        add(slope.filter);
    // Spectra of the taps serve until the next update; how long that is, the last one tells.
    const double life = std::max<double>({block, double(r.expected_life), double(p.end - r.born)});
    const double share = r.born == 0 ? 0 : std::min(1.0, double(p.end - p.begin) / life);
    return cost + share * n_spectra * cost::transform(d_dense.n_bins());
}

double emulator::sparse_cost(const piece& p) const
{
    std::size_t n_paths = p.made_by->paths.size();
    for (const ramp& slope : p.made_by->ramps)
        n_paths += slope.paths.size();
    return n_paths * double(p.end - p.begin) * cost::tap;
}

// The planner: every output in its cheaper way, if what that saves pays for the inputs' transforms.
// Returns the cost of all.
double emulator::choose(pieces& all, uint64_t first, std::size_t n) const
{
    const double n_blocks = (n + d_dense.block() - 1) / d_dense.block();
    const double transforms = n_blocks * d_config.n_inputs * cost::transform(d_dense.n_bins());
    double sparse = 0, mixed = transforms;
    for (auto& of_output : all)
        for (piece& p : of_output) {
            const double direct = sparse_cost(p);
            const double fast = d_may_be_dense ? dense_cost(p, first) : direct;
            p.dense = d_may_be_dense && !p.made_by->is_copy && !p.made_by->paths.empty() &&
                      (fast < direct || !d_may_be_sparse);
            sparse += direct;
            mixed += p.dense ? fast : direct;
        }
    if (mixed < sparse || !d_may_be_sparse)
        return mixed;
    for (auto& of_output : all)
        for (piece& p : of_output)
            p.dense = false;
    return sparse;
}

void emulator::process(const sample* const* in, sample* const* out, std::size_t n, levels* measured)
{
    std::vector<const sample*> x(in, in + d_config.n_inputs);
    std::vector<sample*> y(out, out + d_config.n_outputs);
    // All threads wait for each other at a round's end; converted inputs had better stay in the
    // cache.
    const std::size_t most = (d_fixed_point ? 1 : 4) * max_blocks * d_dense.block();
    for (std::size_t done = 0; done < n;) {
        const std::size_t now = std::min(most, n - done);
        round(x.data(), y.data(), now, measured);
        for (auto& pointer : x)
            pointer += now;
        for (auto& pointer : y)
            pointer += now;
        done += now;
    }
}

// On all threads, where there is more to do than waking them costs.
void emulator::share(unsigned n_jobs, const std::function<void(unsigned)>& job)
{
    if (d_worth_sharing)
        return d_threads.run(n_jobs, job);
    for (unsigned k = 0; k < n_jobs; k++)
        job(k);
}

void emulator::round(const sample* const* in, sample* const* out, std::size_t n, levels* measured)
{
    const uint64_t first = d_position;
    pieces all = cut(first + n);
    const double work = choose(all, first, n);
    const bool transforms = std::any_of(all.begin(), all.end(), [](const auto& of_output) {
        return std::any_of(of_output.begin(), of_output.end(),
                           [](const piece& p) { return p.dense; });
    });
    d_worth_sharing = work > (transforms ? cost::wake_threads_for_transforms : cost::wake_threads);
    std::vector<const sample*> x(in, in + d_config.n_inputs);
    if (d_fixed_point)
        x = quantize_inputs(in, n);
    const std::size_t most = max_blocks * d_dense.block();
    d_transformed.assign((n + d_dense.block() - 1) / d_dense.block(), false);
    for (std::size_t at = 0; at < n; at += most)
        run_dense(all, x.data(), out, first, at, std::min(most, n - at), in, measured);
    run_tiles(all, x.data(), out, first, n, in, measured);
}

std::vector<const sample*> emulator::quantize_inputs(const sample* const* in, std::size_t n)
{
    const std::size_t past = d_config.n_taps - 1;
    std::vector<const sample*> x(d_config.n_inputs);
    d_quantized.resize(d_config.n_inputs);
    share(d_config.n_inputs, [&](unsigned i) {
        d_quantized[i].resize(past + n);
        sample* made = d_quantized[i].data();
        const auto& f = *d_fixed_point;
        quantize(d_isa, in[i] - past, f.input_full_scale, f.bits, made,
                 past); // counted when they were new
        d_clipped += quantize(d_isa, in[i], f.input_full_scale, f.bits, made + past, n);
        x[i] = made + past;
    });
    return x;
}

// What a receiver does to its samples: noise, then its converter; then they are measured. `out`
// points at sample `begin`.
void emulator::finish(int output, sample* out, uint64_t begin, std::size_t n, level* measured)
{
    if (d_noise_power[output] > 0)
        add_noise(d_isa, d_config.seed, output, begin, std::sqrt(d_noise_power[output]), out, n);
    if (d_fixed_point)
        d_clipped +=
            quantize(d_isa, out, d_fixed_point->output_full_scale, d_fixed_point->bits, out, n);
    if (measured)
        measure(d_isa, out, n, *measured);
}

// Adds the ramps' part to samples that begin at number `begin`.
static void add_ramp(sample* out, const sample* full, std::size_t n, uint64_t begin,
                     uint64_t ramp_begin, uint64_t ramp_end)
{
    const double length = double(ramp_end - ramp_begin);
    for (std::size_t k = 0; k < n; k++)
        out[k] += float(double(begin + k - ramp_begin) / length) * full[k];
}

// The direct form, and all that is done to a sample alone, tile by tile: what one thread has made
// or read is in its cache for the next step.
void emulator::run_tiles(const pieces& all, const sample* const* in, sample* const* out,
                         uint64_t first, std::size_t n, const sample* const* came, levels* measured)
{
    const std::size_t tile = tile_length(n, d_threads.size()), n_tiles = (n + tile - 1) / tile;
    const std::size_t n_ports = d_config.n_inputs + d_config.n_outputs;
    d_seen.assign(measured ? n_tiles * n_ports : 0, {});
    share(n_tiles, [&](unsigned t) {
        const std::size_t at = t * tile, length = std::min(tile, n - at);
        level* seen = measured ? d_seen.data() + t * n_ports : nullptr;
        for (int i = 0; measured && i < d_config.n_inputs; i++)
            measure_tile(came[i], at, length, *seen++);
        // Other cores have written what comes in: it travels while this tile is computed.
        const std::size_t next = at + d_threads.size() * tile;
        for (int j = 0; j < d_config.n_outputs; j++)
            mix_tile(all[j], j, in, out[j], first, at, length, measured ? seen++ : nullptr,
                     j < d_config.n_inputs && next + tile <= n ? came[j] + next : nullptr);
    });
    const level* seen = d_seen.data();
    for (std::size_t t = 0; measured && t < n_tiles; t++) {
        for (level& l : measured->inputs)
            l += *seen++;
        for (level& l : measured->outputs)
            l += *seen++;
    }
}

// Where no transform has met the samples before.
void emulator::measure_tile(const sample* came, std::size_t at, std::size_t n, level& seen) const
{
    const std::size_t block = d_dense.block();
    for (const std::size_t end = at + n; at < end;) {
        const std::size_t until = std::min(end, (at / block + 1) * block);
        if (!d_transformed[at / block])
            measure(d_isa, came + at, until - at, seen);
        at = until;
    }
}

// Samples `at` … of what is made in the direct form; `out` points at sample `first`.
void emulator::mix_tile(const std::vector<piece>& of_output, int output, const sample* const* in,
                        sample* out, uint64_t first, std::size_t at, std::size_t n, level* measured,
                        const sample* soon)
{
    std::vector<const sample*> x(d_config.n_inputs);
    for (const piece& p : of_output) {
        const uint64_t begin = std::max(p.begin, first + at),
                       end = std::min<uint64_t>(p.end, first + at + n);
        if (p.dense || begin >= end)
            continue;
        for (int i = 0; i < d_config.n_inputs; i++)
            x[i] = in[i] + (begin - first);
        mix_sparse(*p.made_by, x.data(), out + (begin - first), begin, end - begin,
                   soon ? soon + (begin - first - at) : nullptr);
        finish(output, out + (begin - first), begin, end - begin, measured);
    }
}

// At most one tile. A sum in single precision rounds at every product, by what is in it by then:
// that of many paths is made in parts.
void emulator::mix_parts(const sample* const* in, const path_list& paths, sample* out,
                         std::size_t n, const sample* soon) const
{
    const std::size_t first = std::min(paths.size(), paths_in_part);
    mix_paths(d_isa, in, paths.data(), first, out, n, soon);
    for (std::size_t from = first; from < paths.size(); from += paths_in_part) {
        sample part[largest_tile];
        mix_paths(d_isa, in, paths.data() + from, std::min(paths.size() - from, paths_in_part),
                  part, n);
        for (std::size_t k = 0; k < n; k++)
            out[k] += part[k];
    }
}

// in[i] and out point at sample `begin`; at most one tile. As many samples from `soon` on are
// wanted next.
void emulator::mix_sparse(const recipe& r, const sample* const* in, sample* out, uint64_t begin,
                          std::size_t n, const sample* soon) const
{
    if (r.is_copy) {
        std::memcpy(out, in[r.paths[0].input] - r.paths[0].delay, n * sizeof(sample));
        return;
    }
    mix_parts(in, r.paths, out, n, soon);
    for (const ramp& slope : r.ramps) {
        sample full[largest_tile];
        mix_parts(in, slope.paths, full, n, nullptr);
        add_ramp(out, full, n, begin, slope.begin, slope.end);
    }
}

// Samples `at` …, at most max_blocks blocks; in[i] and out[j] point at sample `first`.
void emulator::run_dense(const pieces& all, const sample* const* in, sample* const* out,
                         uint64_t first, std::size_t at, std::size_t n, const sample* const* came,
                         levels* measured)
{
    const std::size_t block = d_dense.block();
    const uint64_t first_here = first + at;
    std::vector<dense_job> jobs;
    std::vector<recipe*> without_filter;
    bool needed[max_blocks] = {};
    for (int j = 0; j < d_config.n_outputs; j++)
        for (const piece& p : all[j]) {
            const uint64_t begin = std::max(p.begin, first_here),
                           end = std::min(p.end, first_here + n);
            if (!p.dense || begin >= end)
                continue;
            if (p.made_by->filter.taps.empty())
                without_filter.push_back(p.made_by.get());
            const int from = (begin - first_here) / block, to = (end - 1 - first_here) / block + 1;
            std::fill(needed + from, needed + to, true);
            jobs.push_back({&p, j, &p.made_by->filter, nullptr, from, to - from});
            for (const ramp& slope : p.made_by->ramps)
                jobs.push_back({&p, j, &slope.filter, &slope, from, to - from});
        }
    if (jobs.empty())
        return;
    make_filters(without_filter);
    std::copy(needed, needed + (n + block - 1) / block, d_transformed.begin() + at / block);

    const std::size_t n_transforms = max_blocks * d_config.n_inputs;
    d_seen.assign(measured ? n_transforms + jobs.size() * max_blocks : 0, {});
    d_dense.reserve(d_spectra, n_transforms);
    share(n_transforms, [&](unsigned k) {
        const int b = k / d_config.n_inputs, i = k % d_config.n_inputs;
        if (!needed[b])
            return;
        const std::size_t from = at + b * block, length = std::min(block, n - b * block);
        d_dense.transform(in[i] + from, length, d_spectra, k);
        if (measured)
            measure(d_isa, came[i] + from, length, d_seen[k]);
    });

    d_dense.reserve(d_products, jobs.size() * max_blocks);
    std::vector<overlap_save::product> products;
    for (const dense_job& job : jobs)
        products.push_back({job.filter, job.block, job.n_blocks, products.size() * max_blocks});
    const std::size_t bins = d_dense.n_bins() / n_slices;
    share(n_slices, [&](unsigned slice) {
        d_dense.multiply(d_spectra, d_config.n_inputs, products, d_products, slice * bins,
                         (slice + 1) * bins);
    });

    // Ramps add to what their piece's own filter left: one thread does a piece's jobs of a block in
    // turn.
    share(jobs.size() * max_blocks, [&](unsigned k) {
        const int b = k % max_blocks;
        std::size_t job = k / max_blocks;
        if (jobs[job].of_ramp || b >= jobs[job].n_blocks)
            return;
        const piece* of = jobs[job].of;
        const int output = jobs[job].output;
        const uint64_t block_begin = first_here + (jobs[job].block + b) * block;
        const uint64_t begin = std::max(of->begin, block_begin),
                       end = std::min(of->end, std::min(block_begin + block, first_here + n));
        sample* to = out[output] + (begin - first);
        for (; job < jobs.size() && jobs[job].of == of; job++)
            put_block(jobs[job].of_ramp, job * max_blocks + b, begin, begin - block_begin,
                      end - block_begin, to);
        finish(output, to, begin, end - begin, measured ? &d_seen[n_transforms + k] : nullptr);
    });
    for (std::size_t k = 0; measured && k < d_seen.size(); k++)
        if (k < n_transforms)
            measured->inputs[k % d_config.n_inputs] += d_seen[k];
        else
            measured->outputs[jobs[(k - n_transforms) / max_blocks].output] += d_seen[k];
}

// Samples [from, to) of a block from its product, which is lost, or what a ramp adds to them; `out`
// points at the first of them, which is number `begin`.
void emulator::put_block(const ramp* of_ramp, std::size_t product, uint64_t begin, std::size_t from,
                         std::size_t to, sample* out)
{
    if (!of_ramp)
        return d_dense.transform_back(d_products, product, from, to, out);
    thread_local spectrum full;
    full.resize(to - from);
    d_dense.transform_back(d_products, product, from, to, full.data());
    add_ramp(out, full.data(), to - from, begin, of_ramp->begin, of_ramp->end);
}

void emulator::make_filters(const std::vector<recipe*>& without)
{
    struct job {
        mixture* of;
        int used;
    };
    std::vector<job> jobs;
    const auto add = [&](mixture& of) {
        d_dense.reserve(of.filter);
        for (std::size_t used = 0; used < of.filter.inputs.size(); used++)
            jobs.push_back({&of, int(used)});
    };
    for (recipe* r : without) {
        add(*r);
        for (ramp& slope : r->ramps)
            add(slope);
    }
    share(jobs.size(),
          [&](unsigned k) { d_dense.fill(jobs[k].of->filter, jobs[k].of->paths, jobs[k].used); });
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
    const std::size_t n = max_blocks * d_dense.block();
    pieces all(d_config.n_outputs);
    for (int j = 0; j < d_config.n_outputs; j++)
        all[j].push_back(
            {d_position, d_position + n, d_changed[j] ? make_recipe(j) : d_recipes[j], false});
    choose(all, d_position, n);
    const auto n_dense = std::count_if(all.begin(), all.end(),
                                       [](const auto& of_output) { return of_output[0].dense; });
    std::string words;
    if (n_dense < d_config.n_outputs)
        words += "sparse direct form";
    if (n_dense > 0 && n_dense < d_config.n_outputs)
        words += " and ";
    if (n_dense > 0)
        words += "dense overlap-save in " + std::to_string(d_dense.n_bins()) + " bins for " +
                 std::to_string(n_dense) + " of " + std::to_string(d_config.n_outputs) + " outputs";
    return words + ", " + isa_name(d_isa) + ", " + std::to_string(d_threads.size()) +
           (d_threads.size() == 1 ? " thread" : " threads");
}

} // namespace kernel
} // namespace cast
} // namespace gr
