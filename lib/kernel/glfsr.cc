// SPDX-License-Identifier: GPL-3.0-or-later
#include "glfsr.h"
#include <array>
#include <stdexcept>
#include <string>

namespace gr
{
namespace cast
{
namespace kernel
{

namespace
{

const std::array<uint32_t, 32> primitive_masks = {
    0x1,       0x3,       0x5,       0x9,       0x12,       0x21,       0x41,       0x8E,
    0x108,     0x204,     0x402,     0x829,     0x100D,     0x2015,     0x4001,     0x8016,
    0x10004,   0x20013,   0x40013,   0x80004,   0x100002,   0x200001,   0x400010,   0x80000D,
    0x1000004, 0x2000023, 0x4000013, 0x8000004, 0x10000002, 0x20000029, 0x40000004, 0x80000057};

} // namespace

uint32_t glfsr::primitive_mask(unsigned degree) { return primitive_masks.at(degree - 1); }

void glfsr::validate(unsigned degree, uint32_t mask, uint32_t seed)
{
    if (degree < 1 || degree > 32)
        throw std::invalid_argument("glfsr: degree: got " + std::to_string(degree) +
                                    ", needs 1 to 32");
    // Without feedback into the highest bit the register forgets its seed and has no period through
    // it.
    if (mask != 0 && (mask >> (degree - 1)) != 1)
        throw std::invalid_argument("glfsr: mask: got " + std::to_string(mask) +
                                    ", needs 0 or bit " + std::to_string(degree - 1) +
                                    " as its highest for this degree");
    const uint64_t largest = (uint64_t(1) << degree) - 1;
    if (seed < 1 || seed > largest)
        throw std::invalid_argument("glfsr: seed: got " + std::to_string(seed) + ", needs 1 to " +
                                    std::to_string(largest) + " for this degree");
}

} // namespace kernel
} // namespace cast
} // namespace gr
