// SPDX-License-Identifier: GPL-3.0-or-later
// The inner loops of the emulator, for every instruction set.
#pragma once

#include "isa.h"

#include <complex>
#include <cstddef>
#include <cstdint>

namespace gr
{
namespace cast
{
namespace kernel
{

using sample = std::complex<float>;

// One non-zero tap of one link, seen from its receiver.
struct path {
    int input;
    int delay; // samples
    sample gain;
};

// out[k] = sum over paths of gain * in[input][k - delay], k = 0 … n-1.
// in[i] points at sample 0; the samples before it, down to the longest delay, must be readable.
// Every sample sees the same operations in the same order, wherever a call begins or ends. On the
// way n samples from `soon` on are brought near, unless it is nullptr.
void mix_paths(isa set, const sample* const* in, const path* paths, std::size_t n_paths,
               sample* out, std::size_t n, const sample* soon = nullptr);

// The spectra of taps are stored in tiles of this many bins, so that what is used together lies
// together.
constexpr std::size_t bins_per_tile = 16;
// Blocks of samples that share one pass over the spectra of the taps.
constexpr int max_blocks = 8;

// result b = sum over u of spectrum(block + b, inputs[u]) * taps(u), bin by bin.
struct spectral_product {
    const sample* taps; // [tile][used input][bin]
    const int* inputs;
    int n_used;
    int block, n_blocks; // of the inputs' spectra, at most max_blocks
    sample* results;     // of the first block
};

// All products over bins [begin, end), multiples of bins_per_tile: the inputs' bins are read once
// for all. The spectrum of input i in block b begins at spectra + (b * n_inputs + i) * stride,
// result b at results + b * stride.
void multiply_spectra(isa set, const sample* spectra, std::size_t stride, int n_inputs,
                      const spectral_product* products, std::size_t n_products, std::size_t begin,
                      std::size_t end);

// Adds circular Gaussian noise of power amplitude^2 to samples number `number` …; equal numbers of
// a stream get equal noise, streams and seeds are independent.
void add_noise(isa set, uint64_t seed, uint32_t stream, uint64_t number, float amplitude,
               sample* out, std::size_t n);

// Rounds both parts to whole multiples of full_scale / 2^(bits-1) and saturates them, in two's
// complement. Returns how many samples were saturated.
std::size_t quantize(isa set, const sample* in, float full_scale, int bits, sample* out,
                     std::size_t n);

// Power of samples: their sum, and the largest one's.
struct level {
    double energy = 0;
    float peak = 0; // |sample|^2
    std::size_t n = 0;

    level& operator+=(const level& more)
    {
        energy += more.energy;
        peak = more.peak > peak ? more.peak : peak;
        n += more.n;
        return *this;
    }
};

// Adds samples to what was measured before. A NaN among them makes the energy NaN.
void measure(isa set, const sample* in, std::size_t n, level& total);

// Multiply-adds on registers alone, and how many they were: the most that any kernel could do.
double turn_multiply_adds(isa set, long turns);

} // namespace kernel
} // namespace cast
} // namespace gr
