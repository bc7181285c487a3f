// SPDX-License-Identifier: GPL-3.0-or-later
// Complex transforms in AVX-512 lanes, for convolutions: bins lie in an order of their own, sixteen
// real parts and then their imaginary parts, so that most steps need no shuffle. Of many spectra
// the first 256 bins lie together, then the next ones: what a product reads at once is in few
// pages.
#pragma once

#include "vector_kernels.h"

#include <memory>
#include <vector>

namespace gr
{
namespace cast
{
namespace kernel
{

class lane_fft
{
public:
    // nullptr where the instruction set or the number of bins does not fit.
    static std::unique_ptr<lane_fft> make(isa set, std::size_t n_bins);

    static constexpr std::size_t group = 256;
    // From one spectrum to the next, where caches do not clash.
    static constexpr std::size_t stride = group + 16;

    // Samples x[0 … n-1] and zeros up to n_bins; tile t of group g of the bins, 16 of them, at
    // bins + g * next_group + t * next_tile.
    void forward(const sample* x, std::size_t n, sample* bins, std::size_t next_group,
                 std::size_t next_tile = 16) const;

    // Samples [begin, end) of the transform back, n_bins times as large; the bins are lost.
    void backward(sample* bins, std::size_t next_group, std::size_t begin, std::size_t end,
                  sample* out) const;

    // As multiply_spectra(), of such spectra.
    static void multiply(const sample* spectra, std::size_t next_group, int n_inputs,
                         const spectral_product* products, std::size_t n_products,
                         std::size_t next_result_group, std::size_t begin, std::size_t end);

private:
    explicit lane_fft(std::size_t n_bins);

    const std::size_t d_n_bins;
    // Twiddle factors, [re, im][lane] of each: after the first radix, for every m2 those of
    // ka = 1, 2, 4 …; before the last one those of every kb.
    std::vector<float> d_first, d_last;
};

} // namespace kernel
} // namespace cast
} // namespace gr
