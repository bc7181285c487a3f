// SPDX-License-Identifier: GPL-3.0-or-later
// Direct form of a network's output: the sum of few delayed and scaled copies of the inputs.
#pragma once

#include "isa.h"

#include <complex>
#include <cstddef>

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
// Every sample sees the same operations in the same order, wherever a call begins or ends.
void mix_sparse(isa set, const sample* const* in, const path* paths, std::size_t n_paths,
                sample* out, std::size_t n);

} // namespace kernel
} // namespace cast
} // namespace gr
