// SPDX-License-Identifier: GPL-3.0-or-later
#include "unknowns.h"
#include "lanes.h"
#include <algorithm>
#include <cmath>
#include <vector>

namespace gr
{
namespace cast
{
namespace tracing
{

namespace
{

using complex = std::complex<double>;

constexpr double FAINT = 1e-200; // as in diagnose/places/likelihood.py, which says why
constexpr double LEAST = 1e-300;
constexpr double RIDGE = 1e-13;   // of what is told of a node
constexpr double LOUDER = 1e-6;   // least share of a model's power that a gain leaves
constexpr double MOST_STEP = 1.0; // nepers

// `value` (links) as sums of their nodes', by least squares: Cholesky's way with the normal
// equations, each node's in units of what tells of it, for some may be heard ten thousand times as
// well as others. No sum tells of what one side of a network has more and the other less.
void by_nodes(const unknowns& told, const std::vector<double>& weight, std::vector<double>& value)
{
    const size_t n = told.nodes;
    std::vector<double> top(n * n), side(n), scale(n);
    for (size_t link = 0; link < told.links; link++)
        for (size_t a = 0; a < 2; a++) {
            const auto i = size_t(told.ends[2 * link + a]);
            side[i] += weight[link] * value[link];
            for (size_t b = 0; b < 2; b++)
                top[i * n + size_t(told.ends[2 * link + b])] += weight[link];
        }
    for (size_t i = 0; i < n; i++) {
        scale[i] = top[i * n + i] > 0 ? 1 / std::sqrt(top[i * n + i]) : 0.0;
        side[i] *= scale[i];
    }
    for (size_t i = 0; i < n; i++) { // lower triangle in place
        for (size_t j = 0; j <= i; j++) {
            double sum = top[i * n + j] * scale[i] * scale[j] + (i == j ? RIDGE : 0.0);
            for (size_t k = 0; k < j; k++)
                sum -= top[i * n + k] * top[j * n + k];
            top[i * n + j] = i == j ? std::sqrt(std::max(sum, RIDGE)) : sum / top[j * n + j];
        }
        for (size_t k = 0; k < i; k++)
            side[i] -= top[i * n + k] * side[k];
        side[i] /= top[i * n + i];
    }
    for (size_t i = n; i-- > 0;) {
        for (size_t k = i + 1; k < n; k++)
            side[i] -= top[k * n + i] * side[k];
        side[i] /= top[i * n + i];
    }
    for (size_t link = 0; link < told.links; link++) {
        const auto a = size_t(told.ends[2 * link]), b = size_t(told.ends[2 * link + 1]);
        value[link] = scale[a] * side[a] + scale[b] * side[b];
    }
}

// Σ x_k·exp(2πi·kn/size) in each lane, in place: number n comes where its bits lie mirrored.
#if defined(__x86_64__)
__attribute__((target_clones("default", "avx2")))
#endif
void transform(pair_of_lanes* x, size_t size, const std::complex<float>* turn)
{
    for (size_t span = size; span > 1; span /= 2) {
        const size_t half = span / 2, stride = size / span;
        for (size_t begin = 0; begin < size; begin += span)
            for (size_t j = 0; j < half; j++) {
                pair_of_lanes &a = x[begin + j], &b = x[begin + j + half];
                const lanes real = a.real - b.real, imag = a.imag - b.imag;
                const float c = turn[j * stride].real(), s = turn[j * stride].imag();
                a.real += b.real;
                a.imag += b.imag;
                b.real = real * c - imag * s;
                b.imag = real * s + imag * c;
            }
    }
}

std::vector<size_t> mirrored(size_t size)
{
    std::vector<size_t> out(size);
    for (size_t bit = 1, value = size / 2; bit < size; bit *= 2, value /= 2)
        for (size_t i = 0; i < bit; i++)
            out[bit + i] = out[i] + value;
    return out;
}

struct fit {
    fit(const unknowns& one, double* delay, double* gain, complex* own, complex* turn)
        : told(one), delay_s(delay), log_gain(gain), sums(own), phase(turn),
          slopes(one.links * one.instants), wanted(one.links), have(one.links), weight(one.links)
    {
    }

    // Over tones, and times them.
    void sum()
    {
        for (size_t link = 0; link < told.links; link++) {
            turn.resize(told.tones);
            for (size_t k = 0; k < told.tones; k++)
                turn[k] = std::polar(1.0, delay_s[link] * told.omega[k]);
            for (size_t t = 0; t < told.instants; t++) {
                const complex* own = told.cross + (link * told.instants + t) * told.tones;
                complex total = 0, slope = 0;
                for (size_t k = 0; k < told.tones; k++) {
                    const complex one = own[k] * turn[k];
                    total += one;
                    slope += one * told.omega[k];
                }
                sums[link * told.instants + t] = total;
                slopes[link * told.instants + t] = slope;
            }
        }
    }

    void face()
    {
        for (size_t i = 0; i < told.links * told.instants; i++) {
            const double size = std::abs(sums[i]);
            phase[i] = told.is_phase_free && size > FAINT ? sums[i] / size : complex(1);
        }
    }

    void strengthen(bool is_first)
    {
        double all_wanted = 0, all_have = 0;
        for (size_t link = 0; link < told.links; link++) {
            wanted[link] = have[link] = 0;
            for (size_t t = 0; t < told.instants; t++) {
                const size_t i = link * told.instants + t;
                wanted[link] += (sums[i] * std::conj(phase[i])).real();
                have[link] += told.moments[3 * i];
            }
            all_wanted += wanted[link];
            all_have += have[link];
        }
        if (told.gain == shared::common) {
            const double ratio =
                std::max({all_wanted, LOUDER * all_have, LEAST}) / std::max(all_have, LEAST);
            std::fill_n(log_gain, told.links, std::log(ratio));
            return;
        }
        for (size_t link = 0; link < told.links; link++) { // 1: nothing is predicted
            const double ratio =
                have[link] > 0 ? std::max(wanted[link], LOUDER * have[link]) / have[link] : 1.0;
            const double now =
                is_first ? std::min(ratio, 1 / std::max(ratio, 1e-12)) : std::exp(log_gain[link]);
            weight[link] = have[link] * now * now;
            wanted[link] =
                is_first || told.gain == shared::link ? std::log(ratio) : ratio / now - 1;
        }
        if (told.gain == shared::node)
            by_nodes(told, weight, wanted);
        for (size_t link = 0; link < told.links; link++)
            log_gain[link] = is_first || told.gain == shared::link
                                 ? wanted[link]
                                 : log_gain[link] + std::clamp(wanted[link], -MOST_STEP, MOST_STEP);
    }

    void delay()
    {
        for (size_t link = 0; link < told.links; link++) {
            const double gain = std::exp(log_gain[link]);
            double top = 0, bend = 0;
            for (size_t t = 0; t < told.instants; t++) {
                const size_t i = link * told.instants + t;
                const double* own = told.moments + 3 * i;
                // Of what delays turn, an unknown phase makes up for the middle of the power.
                const double middle = told.is_phase_free ? own[1] / std::max(own[0], LEAST) : 0.0;
                const complex back = std::conj(phase[i]);
                top += middle * (sums[i] * back).imag() - (slopes[i] * back).imag();
                bend += own[2] - 2 * middle * own[1] + middle * middle * own[0];
            }
            weight[link] = std::max(bend * gain * gain, FAINT);
            wanted[link] = weight[link] > FAINT ? top * gain / weight[link] : 0.0;
        }
        if (told.delay == shared::node)
            by_nodes(told, weight, wanted);
        for (size_t link = 0; link < told.links; link++)
            delay_s[link] += wanted[link];
    }

    const unknowns& told;
    double *delay_s, *log_gain;
    complex *sums, *phase;
    std::vector<complex> slopes, turn;
    std::vector<double> wanted, have, weight;
};

} // namespace

void cross_with(const sounding& heard, const complex* model, bool together, complex* cross,
                double* moments)
{
    const size_t rows = together ? 1 : heard.instants, tones = heard.tones;
    std::fill_n(cross, heard.links * rows * tones, complex());
    if (moments)
        std::fill_n(moments, heard.links * rows * 3, 0.0);
    for (size_t link = 0; link < heard.links; link++)
        for (size_t t = 0; t < heard.instants; t++) {
            const size_t from = (link * heard.instants + t) * tones,
                         to = link * rows + (together ? 0 : t);
            double power = 0, middle = 0, spread = 0;
            for (size_t k = 0; k < tones; k++) {
                const complex h = model[from + k];
                const complex own = heard.y[from + k] * heard.weight[from + k];
                cross[to * tones + k] += std::conj(h) * own;
                const double loud = std::norm(h) * heard.weight[from + k];
                power += loud;
                middle += loud * heard.omega[k];
                spread += loud * heard.omega[k] * heard.omega[k];
            }
            if (moments) {
                moments[3 * to] += power;
                moments[3 * to + 1] += middle;
                moments[3 * to + 2] += spread;
            }
        }
}

void coarse_delays(const complex* cross, size_t links, size_t instants, size_t tones, size_t size,
                   double first, bool is_phase_free, int64_t* best)
{
    const double tau = 2 * std::acos(-1.0);
    std::vector<std::complex<float>> turn(size / 2), face(is_phase_free ? 0 : size);
    const std::vector<size_t> own = mirrored(size);
    for (size_t i = 0; i < turn.size(); i++)
        turn[i] = std::complex<float>(std::polar(1.0, tau * double(i) / double(size)));
    for (size_t i = 0; i < face.size(); i++) {
        const double at = double(i) / double(size) - (2 * i < size ? 0.0 : 1.0);
        face[i] = std::complex<float>(std::polar(1.0, tau * first * at));
    }
    std::vector<double> most(links, FAINT), score(links * size);
    for (size_t link = 0; link < links; link++) // single precision holds no powers of amplitudes
        for (size_t i = link * instants * tones; i < (link + 1) * instants * tones; i++)
            most[link] = std::max(most[link], std::abs(cross[i]));
    std::vector<pair_of_lanes> x(size);
    for (size_t row = 0; row < links * instants; row += LANES) {
        const size_t rows = std::min(LANES, links * instants - row);
        std::fill(x.begin(), x.end(), pair_of_lanes{});
        for (size_t lane = 0; lane < rows; lane++) {
            const double scale = 1 / most[(row + lane) / instants];
            for (size_t k = 0; k < tones; k++) {
                const complex one = cross[(row + lane) * tones + k] * scale;
                x[k].real[lane] = float(one.real());
                x[k].imag[lane] = float(one.imag());
            }
        }
        transform(x.data(), size, turn.data());
        for (size_t lane = 0; lane < rows; lane++) {
            double* sum = score.data() + (row + lane) / instants * size;
            for (size_t i = 0; i < size; i++) {
                const float real = x[i].real[lane], imag = x[i].imag[lane];
                sum[i] += is_phase_free ? std::sqrt(real * real + imag * imag)
                                        : real * face[own[i]].real() - imag * face[own[i]].imag();
            }
        }
    }
    for (size_t link = 0; link < links; link++) {
        const double* sum = score.data() + link * size;
        size_t found = 0;
        for (size_t i = 1; i < size; i++) // of equal ones the first
            if (sum[i] > sum[found] || (sum[i] == sum[found] && own[i] < own[found]))
                found = i;
        best[link] = int64_t(own[found]);
    }
}

void settle(const unknowns& told, size_t rounds, double* delay_s, double* log_gain, complex* sums,
            complex* phase)
{
    std::fill_n(log_gain, told.links, 0.0);
    fit one(told, delay_s, log_gain, sums, phase);
    const bool is_late = told.delay != shared::none, is_louder = told.gain != shared::none;
    for (size_t number = 0; number < (is_late || is_louder ? rounds : 1); number++) {
        if (is_late || !number) {
            one.sum();
            one.face();
        }
        if (is_louder)
            one.strengthen(!number);
        if (is_late && number + 1 < rounds)
            one.delay();
    }
}

double leave(const sounding& heard, const complex* h, const complex* factor, bool by_instant,
             bool by_tone, complex* model, complex* residual)
{
    const size_t tones = heard.tones, wide = by_tone ? tones : 1;
    double energy = 0;
    for (size_t link = 0; link < heard.links; link++)
        for (size_t t = 0; t < heard.instants; t++) {
            const size_t from = (link * heard.instants + t) * tones;
            const complex* own = factor + (by_instant ? link * heard.instants + t : link) * wide;
            for (size_t k = 0; k < tones; k++) {
                const size_t i = from + k;
                model[i] = h[i] * own[by_tone ? k : 0];
                residual[i] = heard.weight[i] > 0 ? heard.y[i] - model[i] : complex();
                energy += std::norm(residual[i]) * heard.weight[i];
            }
        }
    return energy;
}

} // namespace tracing
} // namespace cast
} // namespace gr
