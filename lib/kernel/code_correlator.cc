// SPDX-License-Identifier: GPL-3.0-or-later
#include "code_correlator.h"
#include <algorithm>
#include <gnuradio/fft/fft.h>
#include <stdexcept>
#include <string>
#include <volk/volk.h>

namespace gr
{
namespace cast
{
namespace kernel
{

namespace
{

// One radix-4 pass of the unnormalised Walsh-Hadamard transform over rows of `width` floats: rows
// at distances `stride`, 2·stride and 3·stride meet.
template <size_t width> inline void radix4_pass(float* rows, size_t n_rows, size_t stride)
{
    for (size_t base = 0; base < n_rows; base += 4 * stride) {
        for (size_t row = base; row < base + stride; row++) {
            float* a = rows + row * width;
            float* b = a + stride * width;
            float* c = b + stride * width;
            float* d = c + stride * width;
            for (size_t i = 0; i < width; i++) {
                const float ab = a[i] + b[i], ab_ = a[i] - b[i];
                const float cd = c[i] + d[i], cd_ = c[i] - d[i];
                a[i] = ab + cd;
                b[i] = ab_ + cd_;
                c[i] = ab - cd;
                d[i] = ab_ - cd_;
            }
        }
    }
}

template <size_t width> inline void radix2_pass(float* rows, size_t n_rows, size_t stride)
{
    for (size_t base = 0; base < n_rows; base += 2 * stride) {
        for (size_t row = base; row < base + stride; row++) {
            float* a = rows + row * width;
            float* b = a + stride * width;
            for (size_t i = 0; i < width; i++) {
                const float sum = a[i] + b[i];
                b[i] = a[i] - b[i];
                a[i] = sum;
            }
        }
    }
}

constexpr size_t row_width = 16; // 8 complex lanes

__attribute__((target_clones("default", "avx2", "avx512f"))) void walsh_hadamard(float* rows,
                                                                                 size_t n_rows)
{
    size_t stride = 1;
    for (; 4 * stride <= n_rows; stride *= 4)
        radix4_pass<row_width>(rows, n_rows, stride);
    if (stride < n_rows)
        radix2_pass<row_width>(rows, n_rows, stride);
}

} // namespace

struct code_correlator::fft_pair {
    fft::fft_complex_fwd forward;
    fft::fft_complex_rev inverse;
    explicit fft_pair(int size) : forward(size), inverse(size) {}
};

void code_correlator::validate(const std::vector<float>& chips, unsigned samples_per_chip)
{
    if (chips.empty() || samples_per_chip == 0)
        throw std::invalid_argument("code: needs one chip and one sample per chip at least, got " +
                                    std::to_string(chips.size()) + " chips of " +
                                    std::to_string(samples_per_chip) + " samples");
    for (size_t m = 0; m < chips.size(); m++)
        if (chips[m] != 1.0f && chips[m] != -1.0f)
            throw std::invalid_argument("code: chip " + std::to_string(m) + ": got " +
                                        std::to_string(chips[m]) + ", needs +1 or -1");
}

code_correlator::code_correlator(const std::vector<float>& chips, unsigned samples_per_chip)
    : d_period(chips.size() * samples_per_chip), d_samples_per_chip(samples_per_chip),
      d_scale(1.0f / static_cast<float>(d_period))
{
    if (!plan_walsh_hadamard(chips))
        plan_fft(chips);
}

code_correlator::~code_correlator() = default;

// With bits a[m] of an m-sequence of degree d, every shift a[m − τ] is the inner product over GF(2)
// of the window x_m = (a[m] … a[m+d−1]) with a vector y_τ. So the correlation is a Walsh-Hadamard
// transform of the input put at rows x_m, read at rows y_τ. Bit i of y_τ is a[m_i − τ], where the
// window at m_i has bit i alone.
bool code_correlator::plan_walsh_hadamard(const std::vector<float>& chips)
{
    const size_t n = chips.size();
    unsigned degree = 0;
    while ((size_t(1) << degree) < n + 1)
        degree++;
    if ((size_t(1) << degree) != n + 1 || degree < 2 || degree > 20)
        return false;

    const auto bit = [&](size_t m) -> uint32_t { return chips[m % n] > 0.0f; };
    std::vector<uint32_t> window(n);
    std::vector<size_t> place(n + 1, n);
    for (size_t m = 0; m < n; m++) {
        for (unsigned i = 0; i < degree; i++)
            window[m] |= bit(m + i) << i;
        if (window[m] == 0 || place[window[m]] != n)
            return false; // not every window occurs once: no m-sequence
        place[window[m]] = m;
    }
    const auto functional = [&](size_t shift) {
        uint32_t y = 0;
        for (unsigned i = 0; i < degree; i++)
            y |= bit(place[size_t(1) << i] + shift) << i;
        return y;
    };
    // All windows once is a de Bruijn property; linearity is what the transform needs besides.
    const uint32_t recurrence = functional(degree);
    for (size_t m = 0; m < n; m++)
        if (bit(m + degree) != uint32_t(__builtin_parity(window[m] & recurrence)))
            return false;

    d_output_row.resize(n);
    for (size_t delay = 0; delay < n; delay++)
        d_output_row[delay] = functional(n - delay);
    d_input_row = std::move(window);
    d_rows.resize((n + 1) * row_width);
    return true;
}

// A period whose length an FFT likes is its own circle. Any other is unrolled to twice its length:
// of a circle long enough not to wrap, the first period() values are the circular correlation.
size_t code_correlator::fft_size(size_t period)
{
    const auto is_smooth = [](size_t size) {
        for (size_t prime : {2, 3, 5, 7})
            while (size % prime == 0)
                size /= prime;
        return size == 1;
    };
    if (is_smooth(period))
        return period;
    size_t size = 2 * period - 1;
    while (!is_smooth(size) || size % 8 != 0)
        size++;
    return size;
}

void code_correlator::plan_fft(const std::vector<float>& chips)
{
    const size_t size = fft_size(d_period);
    d_fft = std::make_unique<fft_pair>(static_cast<int>(size));
    std::fill_n(d_fft->forward.get_inbuf(), size, complex(0.0f));
    for (size_t k = 0; k < d_period; k++)
        d_fft->forward.get_inbuf()[k] = chips[k / d_samples_per_chip];
    d_fft->forward.execute();
    d_code_spectrum.resize(size);
    const float scale = d_scale / static_cast<float>(size); // the inverse FFT is not normalised
    for (size_t k = 0; k < size; k++)
        d_code_spectrum[k] = d_fft->forward.get_outbuf()[k] * scale;
    std::fill_n(d_fft->forward.get_inbuf(), size, complex(0.0f));
}

void code_correlator::correlate(const complex* periods, complex* responses, size_t count)
{
    if (!is_fast()) {
        for (size_t p = 0; p < count; p++)
            correlate_fft(periods + p * d_period, responses + p * d_period);
        return;
    }
    // A lane is one phase of one period: whole periods while they fit side by side, otherwise one
    // period in turns.
    const size_t step = d_samples_per_chip;
    const size_t batch = std::max<size_t>(1, lanes / step);
    for (size_t p = 0; p < count; p += batch) {
        const size_t now = std::min(batch, count - p);
        const complex* samples = sum_over_chips(periods + p * d_period, now);
        complex* out = responses + p * d_period;
        for (size_t lane = 0; lane < now * step; lane += lanes)
            correlate_lanes(samples + lane, out + lane, std::min(lanes, now * step - lane));
    }
}

// A chip held for n samples correlates as n samples summed, then as one chip.
const code_correlator::complex* code_correlator::sum_over_chips(const complex* periods,
                                                                size_t count)
{
    if (d_samples_per_chip == 1)
        return periods;
    d_chip_sums.resize(count * d_period);
    for (size_t p = 0; p < count; p++) {
        const complex* in = periods + p * d_period;
        complex* out = d_chip_sums.data() + p * d_period;
        std::copy(in, in + d_period, out);
        for (size_t q = 1; q < d_samples_per_chip; q++) {
            volk_32fc_x2_add_32fc(out, out, in + q, d_period - q);
            volk_32fc_x2_add_32fc(out + d_period - q, out + d_period - q, in, q); // circular
        }
    }
    return d_chip_sums.data();
}

void code_correlator::correlate_lanes(const complex* samples, complex* responses, size_t n_lanes)
{
    const size_t n = d_input_row.size(), step = d_samples_per_chip;
    size_t start[lanes];
    for (size_t l = 0; l < n_lanes; l++)
        start[l] = (l / step) * d_period + l % step;

    complex* rows = reinterpret_cast<complex*>(d_rows.data());
    std::fill_n(rows, lanes, complex(0.0f));
    if (n_lanes == lanes) {
        for (size_t m = 0; m < n; m++) {
            complex* row = rows + d_input_row[m] * lanes;
            for (size_t l = 0; l < lanes; l++)
                row[l] = samples[start[l] + m * step];
        }
    } else {
        for (size_t m = 0; m < n; m++) {
            complex* row = rows + d_input_row[m] * lanes;
            for (size_t l = 0; l < lanes; l++)
                row[l] = l < n_lanes ? samples[start[l] + m * step] : complex(0.0f);
        }
    }
    walsh_hadamard(d_rows.data(), n + 1);
    for (size_t delay = 0; delay < n; delay++) {
        const complex* row = rows + d_output_row[delay] * lanes;
        for (size_t l = 0; l < n_lanes; l++)
            responses[start[l] + delay * step] = -d_scale * row[l]; // bit 1 is chip +1: c = −(−1)^a
    }
}

void code_correlator::correlate_fft(const complex* period, complex* response)
{
    complex* in = d_fft->forward.get_inbuf();
    const size_t size = d_code_spectrum.size();
    std::copy_n(period, d_period, in);
    if (size > d_period)
        std::copy_n(period, d_period - 1, in + d_period);
    d_fft->forward.execute();
    volk_32fc_x2_multiply_conjugate_32fc(d_fft->inverse.get_inbuf(), d_fft->forward.get_outbuf(),
                                         d_code_spectrum.data(), size);
    d_fft->inverse.execute();
    std::copy_n(d_fft->inverse.get_outbuf(), d_period, response);
}

} // namespace kernel
} // namespace cast
} // namespace gr
