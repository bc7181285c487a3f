// SPDX-License-Identifier: GPL-3.0-or-later
#include "maps.h"
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>
#include <volk/volk.h>

namespace gr
{
namespace cast
{
namespace tracing
{

namespace
{

// Cells of an axis that have one `by` cells farther on.
struct span {
    span(int64_t by, size_t cells)
        : begin(std::max<int64_t>(-by, 0)), end(int64_t(cells) - std::max<int64_t>(by, 0))
    {
    }

    int64_t begin, end;
};

// Number of the knot before a place, of which there is one behind it.
size_t knot_before(double at, size_t knots) { return std::min(size_t(at), knots - 2); }

// What is heard where somebody in each of some cells hides what he does: gathered first, for then
// what follows is the same for all of them, many at once.
constexpr size_t AT_ONCE = 1024;
constexpr double MOST = 1e38; // of a float

struct hidden_cells {
    std::array<double, AT_ONCE> energy, real, imag;
    std::array<float, AT_ONCE> common;

    void gather(const response& heard, const echo& from, const uint8_t* kind, size_t cells,
                size_t begin, size_t number)
    {
        for (size_t i = 0; i < number; i++) {
            const size_t own = kind[begin + i];
            energy[i] = heard.power + heard.own[own];
            real[i] = heard.shared[own].real();
            imag[i] = heard.shared[own].imag();
            common[i] = from.common[own * cells + begin + i];
        }
    }
};

// Energy of the response over that of noise, or 1 where that is more. Its logarithm is right to
// 1e-5, a little otherwise on other processors.
template <bool is_free>
void above_noise(const response& heard, const echo& from, const hidden_cells& some, size_t begin,
                 size_t number, double root, float* out)
{
    for (size_t i = 0; i < number; i++) {
        const double x = some.real[i] + root * double(from.real[begin + i]),
                     y = some.imag[i] + root * double(from.imag[begin + i]);
        const double said = is_free ? std::sqrt(x * x + y * y) : x,
                     more = root * double(from.loud[begin + i]) + 2.0 * double(some.common[i]);
        const double energy = some.energy[i] + root * more - 2 * said;
        out[i] = float(std::min(std::max(heard.count, energy) / heard.count, MOST));
    }
}

} // namespace

void summed_along(const double* map, size_t maps, size_t wide, size_t deep, const int64_t* moved,
                  size_t ways, double* out)
{
    const size_t cells = wide * deep;
    std::fill_n(out, ways * cells, 0.0);
    for (size_t way = 0; way < ways; way++, out += cells)
        for (size_t one = 0; one < maps; one++, moved += 2) {
            const span x(moved[0], wide), y(moved[1], deep);
            for (int64_t i = x.begin; i < x.end; i++) {
                double* total = out + i * int64_t(deep);
                const double* row = map + one * cells + (i + moved[0]) * int64_t(deep) + moved[1];
                for (int64_t j = y.begin; j < y.end; j++)
                    total[j] += row[j];
            }
        }
}

void along(const strip& one, const int64_t* instant, size_t instants, const double* at_m,
           const double* turn, size_t lines, double* out)
{
    std::fill_n(out, one.kinds * lines, 0.0);
    const auto size = double(one.size);
    const size_t cells = one.size * one.size, next = one.instants * cells;
    for (size_t number = 0; number < instants; number++) {
        const float* map = one.map + size_t(instant[number]) * cells;
        const double after_s = one.after_s[instant[number]];
        for (size_t line = 0; line < lines; line++) {
            double cell[2];
            for (size_t axis = 0; axis < 2; axis++)
                cell[axis] = std::rint(
                    (at_m[2 * line + axis] + after_s * turn[2 * line + axis] - one.begin_m) /
                    one.step_m);
            // A place that is no number is on no map.
            if (!(cell[0] >= 0 && cell[1] >= 0 && cell[0] < size && cell[1] < size))
                continue;
            const float* at = map + size_t(cell[0]) * one.size + size_t(cell[1]);
            for (size_t kind = 0; kind < one.kinds; kind++)
                out[kind * lines + line] += double(at[kind * next]);
        }
    }
}

void turned_between(const std::complex<double>* field, const double* turned, size_t knots,
                    const double* at, size_t cells, float* out)
{
    std::vector<std::complex<double>> own(knots);
    std::vector<double> phase(knots);
    const double step = cells > 1 ? at[1] - at[0] : 0;
    for (size_t i = 0; i < cells; i++) {
        const size_t row = knot_before(at[i], knots) * knots;
        const double share = at[i] - double(row / knots);
        for (size_t k = 0; k < knots; k++) {
            own[k] = (1 - share) * field[row + k] + share * field[row + knots + k];
            phase[k] = (1 - share) * turned[row + k] + share * turned[row + knots + k];
        }
        for (size_t j = 0; j < cells;) { // between two knots phases go on evenly
            const size_t k = knot_before(at[j], knots);
            const double along = at[j] - double(k), more = phase[k + 1] - phase[k];
            const std::complex<double> once = std::polar(1.0, more * step),
                                       rise = (own[k + 1] - own[k]) * step;
            std::complex<double> now = std::polar(1.0, phase[k] + along * more),
                                 there = own[k] + along * (own[k + 1] - own[k]);
            for (; j < cells && knot_before(at[j], knots) == k; j++) {
                *out++ = float(there.real() * now.real() - there.imag() * now.imag());
                now *= once;
                there += rise;
            }
        }
    }
}

void likelier(const response& heard, const echo& from, const uint8_t* kind, size_t cells,
              const double* roots, size_t count, float* out)
{
    const auto most = float(heard.before - heard.count), each = float(-heard.count * std::log(2.0));
    hidden_cells some;
    for (size_t begin = 0; begin < cells; begin += AT_ONCE) {
        const size_t number = std::min(AT_ONCE, cells - begin);
        some.gather(heard, from, kind, cells, begin, number);
        for (size_t one = 0; one < count; one++) {
            float* own = out + one * cells + begin;
            (heard.is_free ? above_noise<true> : above_noise<false>)(heard, from, some, begin,
                                                                     number, roots[one], own);
            volk_32f_log2_32f(own, own, unsigned(number)); // as much noise as suits it
            for (size_t i = 0; i < number; i++)
                own[i] = most + each * own[i];
        }
    }
}

} // namespace tracing
} // namespace cast
} // namespace gr
