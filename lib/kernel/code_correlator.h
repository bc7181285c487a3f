// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <complex>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

namespace gr
{
namespace cast
{
namespace kernel
{

// Circular correlation of received periods with a known ±1 code, h = (r ⊗ s) / sᵀs (CaST, IEEE TMC
// 2024).
//
// Each chip is held for samples_per_chip samples; a period has chips.size() * samples_per_chip
// samples. m-sequences take a fast Walsh-Hadamard transform (Cohn and Lempel 1977), other codes an
// FFT.
class code_correlator
{
public:
    using complex = std::complex<float>;

    // Throws std::invalid_argument where a chip is not ±1 or there is none.
    static void validate(const std::vector<float>& chips, unsigned samples_per_chip);

    // Parameters as `validate` lets them pass.
    code_correlator(const std::vector<float>& chips, unsigned samples_per_chip);
    ~code_correlator();

    size_t period() const { return d_period; }
    bool is_fast() const { return !d_input_row.empty(); }

    // `count` contiguous periods in, as many channel impulse responses of period() taps out.
    void correlate(const complex* periods, complex* responses, size_t count);

private:
    static constexpr size_t lanes =
        8; // m-sequence periods transformed side by side: a cache line of complex floats

    const size_t d_period;
    const size_t d_samples_per_chip;
    const float d_scale; // 1 / sᵀs

    std::vector<uint32_t> d_input_row;  // row of the transform that chip m of a period goes to
    std::vector<uint32_t> d_output_row; // row of the transform that holds the response at delay τ
    std::vector<float> d_rows;
    std::vector<complex> d_chip_sums;

    struct fft_pair;
    std::unique_ptr<fft_pair> d_fft;
    std::vector<complex> d_code_spectrum;

    bool plan_walsh_hadamard(const std::vector<float>& chips);
    static size_t fft_size(size_t period);
    void plan_fft(const std::vector<float>& chips);
    void correlate_lanes(const complex* samples, complex* responses, size_t n_lanes);
    void correlate_fft(const complex* period, complex* response);
    const complex* sum_over_chips(const complex* periods, size_t count);
};

} // namespace kernel
} // namespace cast
} // namespace gr
