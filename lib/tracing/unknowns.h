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

enum class shared { none, common, node, link };

// A sounding: links x instants x tones of what was heard.
struct sounding {
    size_t links, instants, tones;
    const std::complex<double>* y;
    const double *weight, *omega; // 1 / noise power or 0; rad/s
};

// Sums of a model (links x instants x tones): `cross` = Σ conj(model)·heard, and unless null
// `moments` = Σ |model|²·weight·(1, ω, ω²), of each instant and tone, or of all instants together.
void cross_with(const sounding& heard, const std::complex<double>* model, bool together,
                std::complex<double>* cross, double* moments);

// The best delay of each link from a whole range, as a number of a grid of `size`, a power of two,
// steps of 1 / (size·spacing): of `cross` (links x instants x tones) turned by it the greatest sum
// over tones, its real part where phases are known. `first`: the first tone, in spacings.
void coarse_delays(const std::complex<double>* cross, size_t links, size_t instants, size_t tones,
                   size_t size, double first, bool is_phase_free, int64_t* best);

// What a sounding does not claim to know.
struct unknowns {
    size_t links, instants, tones; // of sums
    const std::complex<double>* cross;
    const double *moments, *omega;
    const int64_t* ends; // links x 2 numbers of nodes
    size_t nodes;
    bool is_phase_free;
    shared gain, delay;
};

// The likeliest of these by Gauss-Newton steps of gains and delays (links), from some delays:
// `sums` = Σ cross turned by the delay, over tones, and `phase` (links x instants).
void settle(const unknowns& told, size_t rounds, double* delay_s, double* log_gain,
            std::complex<double>* sums, std::complex<double>* phase);

// What `factor` (links x 1 or instants x 1 or tones) times `h` leaves: the model, and the
// residual, 0 where nothing is known; returns Σ |residual|²·weight.
double leave(const sounding& heard, const std::complex<double>* h,
             const std::complex<double>* factor, bool by_instant, bool by_tone,
             std::complex<double>* model, std::complex<double>* residual);

} // namespace tracing
} // namespace cast
} // namespace gr
