// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/tests/check.h"
#include "tracing/maps.h"
#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <vector>

using namespace gr::cast::tracing;

// Ways that leave a map take nothing of it, however far they go.
static void maps_are_summed_where_ways_are_on_them()
{
    const std::array<double, 12> maps{1, 2, 3, 4, 5, 6, 10, 20, 30, 40, 50, 60}; // two of 2 x 3
    const std::array<int64_t, 12> moved{0, 0, 0, 0, 0, 0, 1, -1, 2, 0, -9, 99};
    std::array<double, 18> out{};
    summed_along(maps.data(), 2, 2, 3, moved.data(), 3, out.data());
    CHECK((out ==
           std::array<double, 18>{11, 22, 33, 44, 55, 66, 1, 42, 53, 4, 5, 6, 0, 0, 0, 0, 0, 0}));
}

// Lines are heard in the cell that they are in, at the instants that are asked for.
static void lines_are_heard_in_their_cells()
{
    std::array<float, 36> maps{1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 20, 30, 40, 50, 60, 70, 80, 90};
    std::copy_n(maps.begin(), 18, maps.begin() + 18); // of another kind, the same but for one cell
    maps[18 + 4] = 0.5F;
    const std::array<double, 2> after_s{-1, 1};
    const strip one{maps.data(), 2, 2, 3, -0.1, 0.1, after_s.data()};
    const std::array<double, 8> at_m{0.01, -0.01, 0, 0.1, 1e30, 0, 0, std::nan("")};
    const std::array<double, 8> turn{0, 0, 0.1, 0, 0, 0, 0, 0};
    const std::array<int64_t, 2> both{0, 1}, last{1, 1};
    std::array<double, 8> out{};
    along(one, both.data(), 2, at_m.data(), turn.data(), 4, out.data());
    CHECK((out == std::array<double, 8>{55, 93, 0, 0, 50.5, 93, 0, 0}));
    along(one, last.data(), 1, at_m.data(), turn.data(), 4, out.data());
    CHECK((out == std::array<double, 8>{50, 90, 0, 0, 50, 90, 0, 0}));
}

// Between knots strengths and phases are linear, whether cells lie on knots or not.
static void fields_are_turned_between_knots()
{
    const size_t knots = 4;
    std::vector<std::complex<double>> field(knots * knots);
    std::vector<double> turned(knots * knots);
    for (size_t i = 0; i < knots; i++)
        for (size_t j = 0; j < knots; j++) {
            field[i * knots + j] = {1.0 + double(i) - 0.5 * double(j), 0.3 * double(j)};
            turned[i * knots + j] = 5.0 * double(i) - 7.0 * double(j);
        }
    for (size_t cells : {size_t(1), size_t(4), size_t(7), size_t(10), size_t(50)}) {
        std::vector<double> at(cells);
        for (size_t i = 1; i < cells; i++)
            at[i] = 3.0 * double(i) / double(cells - 1);
        std::vector<float> out(cells * cells);
        turned_between(field.data(), turned.data(), knots, at.data(), cells, out.data());
        for (size_t i = 0; i < cells; i++)
            for (size_t j = 0; j < cells; j++) {
                const std::complex<double> there{1.0 + at[i] - 0.5 * at[j], 0.3 * at[j]};
                const double wanted = (there * std::polar(1.0, 5 * at[i] - 7 * at[j])).real();
                CHECK(std::abs(out[i * cells + j] - wanted) < 1e-5);
            }
    }
}

// A response is likelier by what somebody hides and echoes; what is left above noise counts by its
// logarithm.
static void somebody_makes_a_response_likelier()
{
    const std::array<double, 2> own{4, 1}, roots{0.5, 2};
    const std::array<std::complex<double>, 2> shared{{{2, 0}, {0.5, 0.5}}};
    const std::array<float, 3> real{1, 0, 3}, imag{0, 2, 4}, loud{4, 1, 9};
    const std::array<float, 6> common{0.5, 1, 1.5, 2, 2.5, 3};
    const std::array<uint8_t, 3> kind{0, 1, 1};
    for (bool is_free : {false, true}) {
        std::array<float, 6> out{};
        likelier({20, 6, 3, is_free, own.data(), shared.data()},
                 {real.data(), imag.data(), common.data(), loud.data()}, kind.data(), 3,
                 roots.data(), 2, out.data());
        for (size_t one = 0; one < 2; one++)
            for (size_t i = 0; i < 3; i++) {
                const double root = roots[one];
                const std::complex<double> both =
                    shared[kind[i]] + root * std::complex<double>(real[i], imag[i]);
                const double energy = 20 + own[kind[i]] + root * root * loud[i] +
                                      2 * root * common[kind[i] * 3 + i] -
                                      2 * (is_free ? std::abs(both) : both.real());
                const double told = energy > 6 ? 6 + 6 * std::log(energy / 6) : 6;
                CHECK(std::abs(out[one * 3 + i] - (3 - told)) < 1e-4);
            }
    }
}

// However many cells there are, each is told for itself.
static void many_cells_are_each_told()
{
    constexpr size_t cells = 2 * 1024 + 13;
    const std::array<double, 3> own{4, 1, 9}, roots{0.5, 2, 3};
    const std::array<std::complex<double>, 3> shared{{{2, 0}, {0.5, 0.5}, {-1, 3}}};
    std::vector<float> real(cells), imag(cells), loud(cells), common(3 * cells), all(3 * cells);
    std::vector<uint8_t> kind(cells);
    for (size_t i = 0; i < cells; i++) {
        real[i] = float(i % 17) - 8, imag[i] = float(i % 5), loud[i] = float(i % 7);
        kind[i] = uint8_t(i % 3);
        for (size_t k = 0; k < 3; k++)
            common[k * cells + i] = float(i % 11) - float(k);
    }
    const response heard{20, 6, 3, true, own.data(), shared.data()};
    likelier(heard, {real.data(), imag.data(), common.data(), loud.data()}, kind.data(), cells,
             roots.data(), 3, all.data());
    for (size_t i = 0; i < cells; i++) {
        const std::array<float, 3> its{common[i], common[cells + i], common[2 * cells + i]};
        std::array<float, 3> alone{};
        likelier(heard, {&real[i], &imag[i], its.data(), &loud[i]}, &kind[i], 1, roots.data(), 3,
                 alone.data());
        for (size_t one = 0; one < 3; one++)
            CHECK(std::abs(all[one * cells + i] - alone[one]) < 1e-3);
    }
}

int main()
{
    many_cells_are_each_told();
    somebody_makes_a_response_likelier();
    maps_are_summed_where_ways_are_on_them();
    lines_are_heard_in_their_cells();
    fields_are_turned_between_knots();
}
