// SPDX-License-Identifier: GPL-3.0-or-later
#include "check.h"
#include "kernel/emulator.h"
#include <algorithm>
#include <random>
#include <vector>

using namespace gr::cast::kernel;

namespace
{

constexpr int n_taps = 64, n = 3000, n_inputs = 3, n_outputs = 2;

struct signal {
    std::vector<std::vector<sample>> x; // n_taps-1 zeros first
    std::vector<const sample*> in;

    explicit signal(unsigned seed)
    {
        std::mt19937 random(seed);
        std::normal_distribution<float> normal;
        for (int i = 0; i < n_inputs; i++) {
            x.emplace_back(n_taps - 1 + n);
            for (int k = 0; k < n; k++)
                x[i][n_taps - 1 + k] = {normal(random), normal(random)};
        }
        for (auto& samples : x)
            in.push_back(samples.data() + n_taps - 1);
    }
};

std::vector<std::vector<sample>> run(const signal& s, emulator& e, std::size_t chunk)
{
    std::vector<std::vector<sample>> y(n_outputs, std::vector<sample>(n));
    for (std::size_t at = 0; at < n; at += chunk) {
        std::vector<const sample*> in;
        std::vector<sample*> out;
        for (auto* pointer : s.in)
            in.push_back(pointer + at);
        for (auto& samples : y)
            out.push_back(samples.data() + at);
        e.process(in.data(), out.data(), std::min<std::size_t>(chunk, n - at));
    }
    return y;
}

std::vector<link_update> network()
{
    std::mt19937 random(5);
    std::normal_distribution<float> normal;
    std::vector<link_update> updates;
    for (int i = 0; i < n_inputs; i++)
        for (int j = 0; j < n_outputs; j++) {
            std::vector<tap> taps;
            for (int p = 0; p < 4; p++)
                taps.push_back({int(random() % n_taps), {normal(random), normal(random)}});
            updates.push_back({i, j, std::nullopt, taps, std::nullopt, std::nullopt, 0});
        }
    return updates;
}

std::vector<std::string> instruction_sets()
{
    std::vector<std::string> names;
    for (isa set : {isa::generic, isa::avx2, isa::avx512})
        if (set <= best_isa())
            names.push_back(isa_name(set));
    return names;
}

void every_instruction_set_gives_the_sum_of_the_paths()
{
    const signal s(1);
    const auto updates = network();
    for (const std::string& set : instruction_sets()) {
        emulator e({n_inputs, n_outputs, n_taps, 2, set});
        for (const auto& update : updates)
            e.schedule(update);
        const auto y = run(s, e, 701);
        for (int j = 0; j < n_outputs; j++)
            for (int k = 0; k < n; k++) {
                std::complex<double> expected = 0;
                for (const auto& update : updates)
                    if (update.output == j)
                        for (const tap& t : *update.taps)
                            expected += std::complex<double>(t.gain) *
                                        std::complex<double>(s.in[update.input][k - t.delay]);
                CHECK(std::abs(expected - std::complex<double>(y[j][k])) < 1e-5);
            }
    }
}

void result_does_not_depend_on_chunks_or_threads()
{
    const signal s(2);
    std::vector<std::vector<sample>> first;
    for (int threads : {1, 2, 5})
        for (std::size_t chunk : {1, 13, 512, 3000}) {
            emulator e({n_inputs, n_outputs, n_taps, threads, "auto"});
            for (const auto& update : network())
                e.schedule(update);
            e.schedule(
                {1, 1, 1717, std::vector<tap>{{3, {0, 1}}}, std::nullopt, std::nullopt, 600});
            const auto y = run(s, e, chunk);
            if (first.empty())
                first = y;
            CHECK(y == first);
        }
}

// The count of samples so far is all that a long run leaves behind.
void far_into_a_stream_taps_change_at_their_sample()
{
    const signal s(3);
    emulator e({n_inputs, n_outputs, n_taps, 1, "auto"});
    const uint64_t far = 10'000'000'000;
    e.seek(far);
    e.schedule({0, 0, far + 1000, std::vector<tap>{{0, 1}}, std::nullopt, std::nullopt, 0});
    e.schedule({0, 0, far + 2001, std::vector<tap>{}, std::nullopt, std::nullopt, 0});
    const auto y = run(s, e, 997);
    for (int k = 0; k < n; k++)
        CHECK(y[0][k] == (k >= 1000 && k < 2001 ? s.in[0][k] : sample(0)));
    CHECK(e.n_late() == 0);
    e.schedule({0, 0, far, std::vector<tap>{}, std::nullopt, std::nullopt, 0});
    CHECK(e.n_late() == 1);
}

void update_that_cannot_be_is_refused_whole()
{
    emulator e({n_inputs, n_outputs, n_taps, 1, "auto"});
    const std::vector<tap> good{{0, 1}};
    const float nan = std::numeric_limits<float>::quiet_NaN();
    for (const link_update& bad :
         {link_update{n_inputs, 0, {}, good, {}, {}, 0}, link_update{0, -1, {}, good, {}, {}, 0},
          link_update{0, 0, {}, std::vector<tap>{{0, 1}, {n_taps, 1}}, {}, {}, 0},
          link_update{0, 0, {}, std::vector<tap>{{0, {0, nan}}}, {}, {}, 0}}) {
        bool refused = false;
        try {
            e.schedule(bad);
        } catch (const std::invalid_argument&) {
            refused = true;
        }
        CHECK(refused && e.n_active_links() == 0);
    }
}

level seen_in(const sample* first, std::size_t count)
{
    level seen;
    for (const sample* s = first; s < first + count; s++) {
        seen.energy += std::norm(std::complex<double>(*s));
        seen.peak = std::max(seen.peak, std::norm(*s));
    }
    seen.n = count;
    return seen;
}

bool is_same(const level& a, const level& b)
{
    return a.n == b.n && std::abs(a.energy - b.energy) <= 1e-5 * b.energy &&
           std::abs(a.peak - b.peak) <= 1e-5f * b.peak;
}

// Every sample once, whichever form meets it: the direct one, transforms, or a plain wire.
void powers_of_ports_are_those_of_all_their_samples()
{
    const signal s(4);
    for (const char* method : {"sparse", "dense", "auto"})
        for (const std::string& set : instruction_sets())
            for (std::size_t chunk : {1, 700, 3000}) {
                emulator e({n_inputs, n_outputs, n_taps, 2, set, method});
                for (const auto& update : network())
                    if (update.output == 0) // the other hears one input, as it is
                        e.schedule(update);
                e.schedule({2, 1, std::nullopt, std::vector<tap>{{5, 1}}, {}, {}, 0});
                e.set_noise_power(0, 0.5f);
                emulator::levels measured{std::vector<level>(n_inputs),
                                          std::vector<level>(n_outputs)};
                std::vector<std::vector<sample>> y(n_outputs, std::vector<sample>(n));
                for (std::size_t at = 0; at < n; at += chunk) {
                    std::vector<const sample*> in;
                    std::vector<sample*> out;
                    for (auto* pointer : s.in)
                        in.push_back(pointer + at);
                    for (auto& samples : y)
                        out.push_back(samples.data() + at);
                    e.process(in.data(), out.data(), std::min(chunk, n - at), &measured);
                }
                for (int i = 0; i < n_inputs; i++)
                    CHECK(is_same(measured.inputs[i], seen_in(s.in[i], n)));
                for (int j = 0; j < n_outputs; j++)
                    CHECK(is_same(measured.outputs[j], seen_in(y[j].data(), n)));
            }
}

void what_comes_late_is_counted_and_what_is_cleared_is_gone()
{
    const signal s(6);
    emulator e({n_inputs, n_outputs, n_taps, 1, "auto"});
    e.schedule({0, 0, std::nullopt, std::vector<tap>{{0, 1}, {3, 2}}, {}, {}, 0});
    e.schedule({1, 0, 0, std::vector<tap>{{1, 1}}, {}, {}, 0});
    e.schedule({1, 1, 50, std::vector<tap>{{1, 1}}, {}, {}, 0}, 80);
    CHECK(e.n_active_links() == 2 && e.n_active_taps() == 3 && e.n_late() == 1);
    e.schedule({1, 0, 0, std::nullopt, false, {}, 0});
    CHECK(e.n_active_links() == 1 && e.n_active_taps() == 2 && e.n_processed() == 0);
    e.skip_to(79);
    CHECK(e.n_active_links() == 1);
    e.skip_to(81);
    CHECK(e.n_active_links() == 2 && e.n_processed() == 81);
    std::vector<int> delays(n_inputs * n_outputs, 2);
    std::vector<sample> gains(n_inputs * n_outputs, sample(0.5f));
    e.schedule_all(80, delays.data(), gains.data(), 1);
    CHECK(e.n_late() == 1 + n_inputs * n_outputs);
    CHECK(e.n_active_links() == n_inputs * n_outputs - 1 &&
          e.n_active_taps() == n_inputs * n_outputs - 1);
    e.schedule_all(200, delays.data(), gains.data(), 1);
    e.clear();
    CHECK(e.n_active_links() == 0 && e.n_active_taps() == 0);
    e.skip_to(300);
    CHECK(e.n_active_links() == 0 && e.n_late() == 1 + n_inputs * n_outputs);
}

} // namespace

int main()
{
    powers_of_ports_are_those_of_all_their_samples();
    what_comes_late_is_counted_and_what_is_cleared_is_gone();
    every_instruction_set_gives_the_sum_of_the_paths();
    result_does_not_depend_on_chunks_or_threads();
    far_into_a_stream_taps_change_at_their_sample();
    update_that_cannot_be_is_refused_whole();
}
