// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/tests/check.h"
#include "tracing/unknowns.h"
#include <array>
#include <cmath>
#include <complex>
#include <vector>

using namespace gr::cast::tracing;
using complex = std::complex<double>;

static const double TAU = 2 * std::acos(-1.0);
static const size_t LINKS = 3, INSTANTS = 9, TONES = 21; // no multiples of what is done at once
static const double SPACING_HZ = 1e6, FIRST = -10;

struct heard {
    heard(bool is_turned, const std::array<double, LINKS>& delay_s,
          const std::array<double, LINKS>& gain)
        : h(LINKS * INSTANTS * TONES), y(h.size()), weight(h.size(), 1e4), omega(TONES)
    {
        for (size_t k = 0; k < TONES; k++)
            omega[k] = TAU * SPACING_HZ * (FIRST + double(k));
        for (size_t i = 0; i < h.size(); i++) {
            const size_t row = i / TONES, link = row / INSTANTS;
            h[i] = std::polar(1 + 0.3 * std::sin(double(i)), 2.0 * std::cos(7.0 * double(row)));
            y[i] =
                gain[link] * h[i] *
                std::polar(1.0, double(is_turned) * double(row) - delay_s[link] * omega[i % TONES]);
        }
        y[5] = weight[5] = 0; // missing
    }

    std::vector<complex> h, y;
    std::vector<double> weight, omega;
};

// Whatever phases, delays and gains of nodes made a sounding of a model are found, and nothing is
// left of it.
static void what_made_it_is_found(bool is_turned, shared delay, shared gain)
{
    const std::array<int64_t, 6> ends{0, 1, 1, 2, 0, 2};
    const double step_s = 1 / (256 * SPACING_HZ);
    const bool is_late = delay != shared::none;
    const heard one(
        is_turned, {is_late * 3.2 * step_s, is_late * 9.1 * step_s, is_late * 5.3 * step_s},
        gain == shared::none ? std::array<double, 3>{1, 1, 1} : std::array<double, 3>{0.6, 2, 1.2});
    const size_t rows = is_turned ? INSTANTS : 1;
    std::vector<complex> cross(LINKS * rows * TONES), sums(LINKS * rows), phase(LINKS * rows);
    std::vector<double> moments(LINKS * rows * 3), delay_s(LINKS), log_gain(LINKS);
    const sounding told{LINKS, INSTANTS, TONES, one.y.data(), one.weight.data(), one.omega.data()};
    cross_with(told, one.h.data(), !is_turned, cross.data(), moments.data());
    std::array<int64_t, LINKS> coarse{};
    if (is_late) {
        coarse_delays(cross.data(), LINKS, rows, TONES, 256, FIRST, is_turned, coarse.data());
        CHECK((coarse == std::array<int64_t, 3>{3, 9, 5}));
        for (size_t link = 0; link < LINKS; link++)
            delay_s[link] = double(coarse[link]) * step_s;
    }
    settle({LINKS, rows, TONES, cross.data(), moments.data(), one.omega.data(), ends.data(), 3,
            is_turned, gain, delay},
           12, delay_s.data(), log_gain.data(), sums.data(), phase.data());
    std::vector<complex> factor(LINKS * rows * TONES), model(one.h.size()), left(one.h.size());
    for (size_t i = 0; i < factor.size(); i++)
        factor[i] =
            phase[i / TONES] * std::polar(std::exp(log_gain[i / TONES / rows]),
                                          -delay_s[i / TONES / rows] * one.omega[i % TONES]);
    const double energy =
        leave(told, one.h.data(), factor.data(), is_turned, true, model.data(), left.data());
    CHECK(energy < 1e-6 && left[5] == complex() && std::abs(model[5]) > 0.1);
}

int main()
{
    for (bool is_turned : {false, true})
        for (shared delay : {shared::none, shared::node, shared::link})
            for (shared gain : {shared::none, shared::node, shared::link})
                what_made_it_is_found(is_turned, delay, gain);
}
