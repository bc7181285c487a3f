// SPDX-License-Identifier: GPL-3.0-or-later
#include "grids.h"
#include "lanes.h"
#include <algorithm>
#include <cmath>

namespace gr
{
namespace cast
{
namespace tracing
{

namespace
{

using complex = std::complex<double>;

constexpr double LEAST = 1e-300;
constexpr double EQUAL = 1e-9; // steps of a grid that differ by less of themselves are one

// exp(−j·value·rate), each from the one before: equal steps turn alike.
std::vector<complex> turns(const std::vector<double>& values, double rate)
{
    std::vector<complex> out(values.size());
    double step = 0;
    complex by = 1;
    for (size_t i = 0; i < values.size(); i++) {
        const double more = i ? values[i] - values[i - 1] : values[i];
        if (i < 2 || std::abs(more - step) > EQUAL * std::abs(step)) {
            step = more;
            by = std::polar(1.0, -more * rate);
        }
        out[i] = i ? out[i - 1] * by : by;
    }
    return out;
}

struct factor {
    float real, imag;
};

factor single(const complex& one) { return {float(one.real()), float(one.imag())}; }

// One value of the first axis: `left` is tones x paths, `right` tones x paths x blocks.
#if defined(__x86_64__)
__attribute__((target_clones("default", "avx2")))
#endif
void row_of_grid(const factor* left, const pair_of_lanes* right, const factor* rest,
                 const factor* heard, size_t paths, size_t tones, size_t blocks, bool is_free,
                 size_t seconds, float* power, float* along)
{
    for (size_t block = 0; block < blocks; block++) {
        lanes loud{}, real{}, imag{};
        for (size_t tone = 0; tone < tones; tone++) {
            lanes x = lanes{} + rest[tone].real, y = lanes{} + rest[tone].imag;
            const factor* own = left + tone * paths;
            const pair_of_lanes* turned = right + tone * paths * blocks + block;
            for (size_t path = 0; path < paths; path++, turned += blocks) {
                x += own[path].real * turned->real - own[path].imag * turned->imag;
                y += own[path].real * turned->imag + own[path].imag * turned->real;
            }
            loud += x * x + y * y;
            real += x * heard[tone].real - y * heard[tone].imag;
            imag += x * heard[tone].imag + y * heard[tone].real;
        }
        for (size_t lane = 0, at = block * LANES; lane < LANES && at < seconds; lane++, at++) {
            power[at] = loud[lane];
            along[at] =
                is_free ? std::sqrt(real[lane] * real[lane] + imag[lane] * imag[lane]) : real[lane];
        }
    }
}

} // namespace

void over_grid(const turning& heard, const std::vector<std::vector<double>>& axes, float* power,
               float* along)
{
    const size_t paths = heard.paths, tones = heard.tones, each = paths * tones;
    const size_t firsts = axes[0].size(), seconds = axes[1].size();
    const size_t blocks = (seconds + LANES - 1) / LANES;
    const std::vector<double> levels = axes.size() > 2 ? axes[2] : std::vector<double>{0.0};
    std::vector<complex> first(firsts * each), third(levels.size() * each);
    std::vector<pair_of_lanes> right(each * blocks, pair_of_lanes{});
    std::vector<factor> rest(tones), told(tones), left(each);
    for (size_t tone = 0; tone < tones; tone++) {
        rest[tone] = single(heard.rest[tone]);
        told[tone] = single(heard.heard[tone]);
        for (size_t path = 0; path < paths; path++) {
            const size_t from = path * tones + tone, to = tone * paths + path;
            const auto by_first = turns(axes[0], heard.rate[from]);
            for (size_t i = 0; i < firsts; i++)
                first[i * each + to] = by_first[i];
            const auto by_second = turns(axes[1], heard.rate[each + from]);
            for (size_t i = 0; i < seconds; i++) {
                right[to * blocks + i / LANES].real[i % LANES] = float(by_second[i].real());
                right[to * blocks + i / LANES].imag[i % LANES] = float(by_second[i].imag());
            }
            const auto by_third =
                turns(levels, axes.size() > 2 ? heard.rate[2 * each + from] : 0.0);
            for (size_t i = 0; i < levels.size(); i++)
                third[i * each + to] = by_third[i] * heard.path[from];
        }
    }
    for (size_t level = 0; level < levels.size(); level++)
        for (size_t i = 0; i < firsts; i++, power += seconds, along += seconds) {
            for (size_t one = 0; one < each; one++)
                left[one] = single(first[i * each + one] * third[level * each + one]);
            row_of_grid(left.data(), right.data(), rest.data(), told.data(), paths, tones, blocks,
                        heard.is_free, seconds, power, along);
        }
}

void steps_from(const turning& heard, double count, const double* places, size_t n, size_t axes,
                double* top, double* side, double* left)
{
    const size_t paths = heard.paths, tones = heard.tones, each = paths * tones;
    std::vector<complex> model(tones), lacks(tones), slopes(axes * tones);
    for (size_t place = 0; place < n; place++, places += axes, side += axes, top += axes * axes) {
        std::copy_n(heard.rest, tones, model.begin());
        std::fill(slopes.begin(), slopes.end(), complex());
        for (size_t path = 0; path < paths; path++)
            for (size_t tone = 0; tone < tones; tone++) {
                const size_t at = path * tones + tone;
                double turn = 0;
                for (size_t axis = 0; axis < axes; axis++)
                    turn += places[axis] * heard.rate[axis * each + at];
                const complex own = heard.path[at] * complex(std::cos(turn), -std::sin(turn));
                const complex turned(own.imag(), -own.real()); // times −j
                model[tone] += own;
                for (size_t axis = 0; axis < axes; axis++)
                    slopes[axis * tones + tone] += turned * heard.rate[axis * each + at];
            }
        complex said = 0; // of heard, which is conjugate, by the model
        double power = 0, energy = 0;
        for (size_t tone = 0; tone < tones; tone++) {
            said += heard.heard[tone] * model[tone];
            power += std::norm(model[tone]);
        }
        const double size = std::abs(said);
        const complex face = heard.is_free && size > 0 ? said / size : complex(1);
        for (size_t tone = 0; tone < tones; tone++) {
            lacks[tone] = std::conj(heard.heard[tone]) * face - model[tone];
            energy += std::norm(lacks[tone]);
        }
        left[place] = energy;
        if (heard.is_free) // what turns all tones alike, the phase makes up for
            for (size_t axis = 0; axis < axes; axis++) {
                complex* own = slopes.data() + axis * tones;
                double along = 0;
                for (size_t tone = 0; tone < tones; tone++)
                    along += (own[tone] * std::conj(model[tone])).imag();
                const complex less(0, along / std::max(power, LEAST));
                for (size_t tone = 0; tone < tones; tone++)
                    own[tone] -= less * model[tone];
            }
        const double share = std::min(1.0, count / std::max(energy, LEAST));
        for (size_t a = 0; a < axes; a++)
            for (size_t tone = 0; tone < tones; tone++) {
                const complex told = share * std::conj(slopes[a * tones + tone]);
                side[a] += (told * lacks[tone]).real();
                for (size_t b = 0; b < axes; b++)
                    top[a * axes + b] += (told * slopes[b * tones + tone]).real();
            }
    }
}

} // namespace tracing
} // namespace cast
} // namespace gr
