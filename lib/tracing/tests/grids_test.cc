// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/tests/check.h"
#include "tracing/grids.h"
#include <array>
#include <cmath>
#include <complex>
#include <vector>

using namespace gr::cast::tracing;
using complex = std::complex<double>;

static std::vector<double> steps(double first, double by, size_t count)
{
    std::vector<double> out(count);
    for (size_t i = 0; i < count; i++)
        out[i] = first + by * double(i);
    return out;
}

// Two paths at one tone interfere as the cosine of what turns them apart, on grids of any size.
static void two_paths_interfere()
{
    const std::array<complex, 2> path{complex(2), complex(1)};
    const std::array<double, 6> rate{3, 0, 5, 0, 7, 0}; // of the first alone
    const complex nothing = 0, heard(0, -1);
    for (size_t seconds : {1, 8, 9, 33}) {
        const std::vector<std::vector<double>> axes{steps(-1, 0.3, 4), steps(0.1, 0.07, seconds),
                                                    steps(-0.2, 0.2, 2)};
        std::vector<float> power(axes[2].size() * axes[0].size() * seconds), along(power.size());
        for (bool is_free : {false, true}) {
            over_grid({path.data(), rate.data(), &nothing, &heard, 2, 1, is_free}, axes,
                      power.data(), along.data());
            size_t at = 0;
            for (double c : axes[2])
                for (double a : axes[0])
                    for (double b : axes[1]) {
                        const double turn = 3 * a + 5 * b + 7 * c;
                        CHECK(std::abs(power[at] - (5 + 4 * std::cos(turn))) < 1e-5);
                        const double said =
                            is_free ? std::sqrt(5 + 4 * std::cos(turn)) : -2 * std::sin(turn);
                        CHECK(std::abs(along[at] - said) < 1e-3);
                        at++;
                    }
        }
    }
}

// From beside the place where a path was heard, a step leads there, and nothing is left then.
static void a_step_leads_to_where_it_was_heard()
{
    const std::array<complex, 2> path{complex(1), complex(0, 2)};
    const std::array<double, 4> rate{1, 0.5, -0.4, 2}; // two axes, one path, two tones
    const std::array<complex, 2> rest{};
    const std::array<double, 2> there{0.3, -0.2};
    std::array<complex, 2> heard{};
    for (size_t tone = 0; tone < 2; tone++)
        heard[tone] = std::conj(
            path[tone] * std::polar(1.0, -(there[0] * rate[tone] + there[1] * rate[2 + tone])));
    const std::array<double, 4> places{there[0], there[1], there[0] + 1e-4, there[1] - 2e-4};
    std::array<double, 8> top{};
    std::array<double, 4> side{};
    std::array<double, 2> left{};
    steps_from({path.data(), rate.data(), rest.data(), heard.data(), 1, 2, false}, 2.0,
               places.data(), 2, 2, top.data(), side.data(), left.data());
    CHECK(left[0] < 1e-30 && std::abs(side[0]) < 1e-15 && left[1] > 1e-9);
    const double *own = top.data() + 4, *to = side.data() + 2;
    const double size = own[0] * own[3] - own[1] * own[2];
    CHECK(std::abs((own[3] * to[0] - own[1] * to[1]) / size + 1e-4) < 1e-7);
    CHECK(std::abs((own[0] * to[1] - own[2] * to[0]) / size - 2e-4) < 1e-7);
}

int main()
{
    two_paths_interfere();
    a_step_leads_to_where_it_was_heard();
}
