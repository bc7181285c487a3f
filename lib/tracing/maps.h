// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <complex>
#include <cstddef>
#include <cstdint>

namespace gr
{
namespace cast
{
namespace tracing
{

// Maps of `wide` x `deep` cells, one after the other, summed along ways that begin at each cell and
// have moved by `moved` (ways x maps x 2) cells at each map: `out` is ways x wide x deep.
void summed_along(const double* map, size_t maps, size_t wide, size_t deep, const int64_t* moved,
                  size_t ways, double* out);

// `kinds` of square maps of `size` x `size` cells of `step_m`, from `begin_m` on either way, of
// each kind one at each of `instants` times `after_s`.
struct strip {
    const float* map;
    size_t kinds, instants, size;
    double begin_m, step_m;
    const double* after_s;
};

// Sums of the maps of each kind at some instants where lines are: those at `at_m` (lines x 2) that
// go at `turn`; `out` is kinds x lines.
void along(const strip& one, const int64_t* instant, size_t instants, const double* at_m,
           const double* turn, size_t lines, double* out);

// Real parts of fields (knots x knots) that are turned by so many radians, both linear between
// knots, at cells (cells x cells) whose places `at` along either axis are counted in knots and rise
// in equal steps.
void turned_between(const std::complex<double>* field, const double* turned, size_t knots,
                    const double* at, size_t cells, float* out);

} // namespace tracing
} // namespace cast
} // namespace gr
