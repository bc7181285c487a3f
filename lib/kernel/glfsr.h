// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>

namespace gr
{
namespace cast
{
namespace kernel
{

// Galois linear feedback shift register, shifting right; bit-exact with GNU Radio's digital::glfsr.
class glfsr
{
public:
    glfsr(uint32_t mask, uint32_t seed) : d_mask(mask), d_seed(seed), d_state(seed) {}

    // Throws std::invalid_argument where (degree, mask, seed) is no register with a period through
    // its seed.
    static void validate(unsigned degree, uint32_t mask, uint32_t seed);

    // Feedback mask of a primitive polynomial, degree 1 to 32.
    static uint32_t primitive_mask(unsigned degree);

    bool at_period_start() const { return d_state == d_seed; }

    float next_chip()
    {
        const uint32_t bit = d_state & 1u;
        d_state = (d_state >> 1) ^ (d_mask & (0u - bit));
        return bit ? 1.0f : -1.0f;
    }

private:
    const uint32_t d_mask;
    const uint32_t d_seed;
    uint32_t d_state;
};

} // namespace kernel
} // namespace cast
} // namespace gr
