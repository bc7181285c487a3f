// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "vec.h"
#include <complex>
#include <cstddef>
#include <cstdint>

namespace gr
{
namespace cast
{
namespace tracing
{

using complex = std::complex<double>;

enum class pattern { iso, dipole, hw_dipole, tr38901 };

// Field that an antenna sends along `direction`, or takes from it; `rotation`: rows of its axes in
// space.
vec far_field(pattern shape, const vec rotation[3], const vec& direction);

// What objects are made of at the carrier: complex permittivity, thickness and roughness in m,
// share of the reflected amplitude that is scattered, whether the object is there.
struct surface {
    const complex* permittivity;
    const double* thickness_m;
    const double* height_rms_m;
    const double* scattering;
    const uint8_t* present;
};

// Paths as mesh.h has them, with unit directions (depth + 1) and length of each, and what its ends
// send and take.
struct way {
    size_t count;
    unsigned depth;
    const int64_t* faces;
    size_t crossings;
    const int64_t *crossing_path, *crossing_leg, *crossing_face;
    const vec* direction;
    const double* length_m;
    const vec *start, *end;
};

// Gains of paths, without the phase of their delay: wavelength/(4 pi length) times fields and
// dyads.
void gains(const way& paths, const vec* normal, const int64_t* owner, const surface& made_of,
           double wavelength_m, complex* out);

// Sum of gain·exp(-j 2 pi f length/c) of paths at each instant: `out` is instants x steps, from
// `begin_hz` on.
void summed(size_t count, const int64_t* instant, const complex* gain, const double* length_m,
            double begin_hz, double step_hz, size_t steps, complex* out);

} // namespace tracing
} // namespace cast
} // namespace gr
