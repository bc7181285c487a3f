// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "kernel/glfsr.h"
#include <gnuradio/cast/glfsr_source.h>

namespace gr
{
namespace cast
{

class glfsr_source_impl : public glfsr_source
{
public:
    glfsr_source_impl(unsigned degree, uint32_t mask, uint32_t seed, unsigned samples_per_chip);

    uint32_t mask() const override { return d_mask; }

    int work(int noutput_items, gr_vector_const_void_star& input_items,
             gr_vector_void_star& output_items) override;

private:
    const uint32_t d_mask;
    const unsigned d_samples_per_chip;
    kernel::glfsr d_register;
    float d_chip = 0.0f;
    unsigned d_samples_left = 0; // of the chip that a buffer's end cut
    uint64_t d_period = 0;
};

} // namespace cast
} // namespace gr
