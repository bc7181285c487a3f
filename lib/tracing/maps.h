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

// What is heard at one instant on one link: its energy over noise, in so many numbers, and what of
// it noise leaves without anybody, `before`. Of each kind of what somebody may hide, the energy of
// what is predicted then and what that has in common with what is heard, whose phase may be free.
struct response {
    double power, count, before;
    bool is_free;
    const double* own;
    const std::complex<double>* shared;
};

// An echo of 1 m^2 from each cell: what it has in common with what is heard, with what is predicted
// of each kind (kinds x cells), and its energy.
struct echo {
    const float *real, *imag, *common, *loud;
};

// By how many nats the response is likelier with somebody in each of `cells`, who hides what `kind`
// says and echoes as `roots` times so strong: `out` is roots x cells.
void likelier(const response& heard, const echo& from, const uint8_t* kind, size_t cells,
              const double* roots, size_t count, float* out);

} // namespace tracing
} // namespace cast
} // namespace gr
