// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <complex>
#include <cstddef>
#include <vector>

namespace gr
{
namespace cast
{
namespace tracing
{

// One response at some tones: paths x tones that turn by `rate` rad per unit of each axis, axes x
// paths x tones; what stays and what was heard, conjugate. All are over the noise.
struct turning {
    const std::complex<double>* path;
    const double* rate;
    const std::complex<double>*rest, *heard;
    size_t paths, tones;
    bool is_free; // the phase of what was heard is unknown
};

// What the response has over a grid of two or three axes, the first one's values first:
// Σ|model|², and what of Σ heard·model lies along it. Both are numbers of the last axis, if there
// is a third, x first x second.
void over_grid(const turning& heard, const std::vector<std::vector<double>>& axes, float* power,
               float* along);

// The same response at each of some places (n x axes): what it leaves, turned as suits it, and the
// normal equations of a step from there, top n x axes x axes and side n x axes, in which what
// leaves more than noise has, `count`, has the say of its noise alone.
void steps_from(const turning& heard, double count, const double* places, size_t n, size_t axes,
                double* top, double* side, double* left);

} // namespace tracing
} // namespace cast
} // namespace gr
