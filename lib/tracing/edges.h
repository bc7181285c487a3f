// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <complex>
#include <cstddef>

namespace gr
{
namespace cast
{
namespace tracing
{

// Fields (edges x count) of edges whose strengths are each so much more than one as a complex
// Gaussian number of unit power has it: to `model`, and off `residual` where this has a `weight`
// over noise, goes what the likeliest strengths change. Returns what these cost, in nats.
double loosen(const std::complex<double>* field, size_t edges, size_t count, const double* weight,
              std::complex<double>* model, std::complex<double>* residual);

} // namespace tracing
} // namespace cast
} // namespace gr
