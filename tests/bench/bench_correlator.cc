// SPDX-License-Identifier: GPL-3.0-or-later
// Samples per second of the correlator's kernel and of GNU Radio's FFT filter as the matched
// filter, one thread each, in turns in the same run. Prints one line of JSON per code.
#include "kernel/code_correlator.h"
#include "kernel/glfsr.h"
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <functional>
#include <gnuradio/filter/fft_filter.h>
#include <random>

using gr::cast::kernel::code_correlator;
using gr::cast::kernel::glfsr;
using complex = std::complex<float>;

static double samples_per_second(size_t samples, const std::function<void()>& work)
{
    using clock = std::chrono::steady_clock;
    double best = 0;
    for (int turn = 0; turn < 7; turn++) {
        const auto begin = clock::now();
        work();
        const double took = std::chrono::duration<double>(clock::now() - begin).count();
        best = std::max(best, samples / took);
    }
    return best;
}

static void compare(const char* name, const std::vector<float>& chips, unsigned samples_per_chip)
{
    std::mt19937 random(1);
    std::normal_distribution<float> normal;
    code_correlator correlator(chips, samples_per_chip);
    const size_t period = correlator.period(), periods = 4'000'000 / period;
    std::vector<complex> in(period * periods), out(in.size());
    for (complex& x : in)
        x = complex(normal(random), normal(random));

    std::vector<gr_complex> taps(period);
    for (size_t k = 0; k < period; k++)
        taps[period - 1 - k] = chips[k / samples_per_chip];
    gr::filter::kernel::fft_filter_ccc filter(1, taps);
    const int block = filter.set_taps(taps); // samples per call that the kernel wants
    const size_t blocks = in.size() / block;

    // Cache-sized pieces for both: what a scheduler hands over, not what memory can stream.
    const size_t piece = std::max<size_t>(1, 8192 / period);
    const double ours = samples_per_second(in.size(), [&] {
        for (size_t p = 0; p + piece <= periods; p += piece)
            correlator.correlate(in.data() + p * period, out.data(), piece);
    });
    const double stock = samples_per_second(in.size(), [&] {
        for (size_t b = 0; b < blocks; b++)
            filter.filter(block, in.data() + b * block, out.data());
    });
    std::printf(
        "{\"code\": \"%s\", \"samples_per_chip\": %u, \"walsh_hadamard\": %s, \"kernel\": %.4g, "
        "\"fft_filter_kernel\": %.4g, \"ratio\": %.3g}\n",
        name, samples_per_chip, correlator.is_fast() ? "true" : "false", ours, stock, ours / stock);
}

int main()
{
    for (unsigned degree : {8u, 9u, 10u, 12u}) {
        glfsr source(glfsr::primitive_mask(degree), 1);
        std::vector<float> chips((size_t(1) << degree) - 1);
        for (float& chip : chips)
            chip = source.next_chip();
        const std::string name = "glfsr:" + std::to_string(degree);
        for (unsigned samples_per_chip : {1u, 4u})
            compare(name.c_str(), chips, samples_per_chip);
    }
    std::mt19937 random(2);
    for (size_t length : {128, 255, 256, 511}) {
        std::vector<float> chips(length);
        for (float& chip : chips)
            chip = random() & 1 ? 1.0f : -1.0f;
        compare(("random:" + std::to_string(length)).c_str(), chips, 1);
    }
}
