// SPDX-License-Identifier: GPL-3.0-or-later
#include "check.h"
#include "kernel/lane_fft.h"
#include <random>
#include <vector>

using namespace gr::cast::kernel;

namespace
{

using exact = std::complex<double>;

constexpr std::size_t tile = 16, tiles_per_group = lane_fft::group / tile;

std::vector<sample> noise(std::size_t n, unsigned seed)
{
    std::mt19937 random(seed);
    std::normal_distribution<float> normal;
    std::vector<sample> made(n);
    for (auto& x : made)
        x = {normal(random), normal(random)};
    return made;
}

// Sum over k of a[k] b[n - k], the indices in a circle.
exact circular(const std::vector<sample>& a, const std::vector<sample>& b, std::size_t n,
               std::size_t n_bins)
{
    exact sum = 0;
    for (std::size_t k = 0; k < a.size(); k++)
        if ((n + n_bins - k) % n_bins < b.size())
            sum += exact(a[k]) * exact(b[(n + n_bins - k) % n_bins]);
    return sum;
}

// Two inputs in two blocks, heard through filters of a quarter of the bins, as the emulator does
// it.
void products_of_spectra_are_convolutions(std::size_t n_bins)
{
    const auto fft = lane_fft::make(best_isa(), n_bins);
    if (!fft)
        return;
    const std::size_t n_groups = n_bins / lane_fft::group;
    const std::size_t next_group = 4 * lane_fft::stride, next_result_group = 2 * lane_fft::stride;
    std::vector<sample> spectra(n_groups * next_group), results(n_groups * next_result_group),
        taps(2 * n_bins), y(n_bins);
    std::vector<std::vector<sample>> x, h;
    for (std::size_t k = 0; k < 4; k++) { // [block][input], of any length
        x.push_back(noise(n_bins - 37 * k, unsigned(k)));
        fft->forward(x[k].data(), x[k].size(), spectra.data() + k * lane_fft::stride, next_group);
    }
    for (std::size_t u = 0; u < 2; u++) {
        h.push_back(noise(n_bins / 4 + 1 - 100 * u, unsigned(10 + u)));
        fft->forward(h[u].data(), h[u].size(), taps.data() + u * tile, tiles_per_group * 2 * tile,
                     2 * tile);
    }
    const int inputs[] = {0, 1};
    const spectral_product both{taps.data(), inputs, 2, 0, 2, results.data()};
    lane_fft::multiply(spectra.data(), next_group, 2, &both, 1, next_result_group, 0, n_bins);
    const std::size_t begin = 11, end = n_bins - 9;
    for (std::size_t b = 0; b < 2; b++) {
        y.assign(n_bins, 7);
        fft->backward(results.data() + b * lane_fft::stride, next_result_group, begin, end,
                      y.data());
        for (std::size_t n = begin; n < end; n += 31) {
            const exact law =
                circular(h[0], x[2 * b], n, n_bins) + circular(h[1], x[2 * b + 1], n, n_bins);
            CHECK(std::abs(exact(y[n - begin]) / double(n_bins) - law) <
                  3e-6 * std::sqrt(double(n_bins)));
        }
        CHECK(y[end - begin] == sample(7)); // nothing is written beyond what is wanted
    }
}

} // namespace

int main()
{
    for (std::size_t n_bins : {1024, 2048, 4096})
        products_of_spectra_are_convolutions(n_bins);
    CHECK(!lane_fft::make(isa::generic, 2048) && !lane_fft::make(isa::avx512, 8192));
}
