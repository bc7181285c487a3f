// SPDX-License-Identifier: GPL-3.0-or-later
// Eight numbers that are worked on at once.
#pragma once

#include <cstddef>

namespace gr
{
namespace cast
{
namespace tracing
{

constexpr size_t LANES = 8;

// Its alignment is said: without AVX a compiler would be content with less than the clones of a
// function for AVX2 rely on.
typedef float lanes
    __attribute__((vector_size(LANES * sizeof(float)), aligned(LANES * sizeof(float))));

struct pair_of_lanes {
    lanes real, imag;
};

} // namespace tracing
} // namespace cast
} // namespace gr
