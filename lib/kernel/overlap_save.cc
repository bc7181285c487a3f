// SPDX-License-Identifier: GPL-3.0-or-later
#include "overlap_save.h"
#include <algorithm>
#include <cstring>
#include <fftw3.h>
#include <gnuradio/fft/fft.h>
#include <mutex>

namespace gr
{
namespace cast
{
namespace kernel
{

namespace
{

// Four times the filter spends a quarter of every block on overlap; below 1024 bins that matters
// more than the transform's own cost, above 4096 a block leaves the first cache.
std::size_t choose_bins(std::size_t n_taps)
{
    std::size_t bins = 1024;
    while (bins < 4 * n_taps)
        bins *= 2;
    return bins;
}

fftwf_complex* fftw(sample* p) { return reinterpret_cast<fftwf_complex*>(p); }

} // namespace

// FFTW_ESTIMATE: measured plans differ from run to run, and so would the last bit of every sample.
struct overlap_save::plans {
    fftwf_plan forward, backward;

    explicit plans(std::size_t n_bins)
    {
        spectrum a(n_bins), b(n_bins);
        std::lock_guard lock(gr::fft::planner::mutex());
        forward =
            fftwf_plan_dft_1d(n_bins, fftw(a.data()), fftw(b.data()), FFTW_FORWARD, FFTW_ESTIMATE);
        backward =
            fftwf_plan_dft_1d(n_bins, fftw(a.data()), fftw(b.data()), FFTW_BACKWARD, FFTW_ESTIMATE);
    }
    ~plans()
    {
        std::lock_guard lock(gr::fft::planner::mutex());
        fftwf_destroy_plan(forward);
        fftwf_destroy_plan(backward);
    }
};

overlap_save::overlap_save(int n_taps)
    : d_n_taps(n_taps), d_n_bins(choose_bins(n_taps)), d_plans(std::make_unique<plans>(d_n_bins))
{
}

overlap_save::~overlap_save() = default;

void overlap_save::fill(dense_filter& filter, const path_list& paths, int used) const
{
    thread_local spectrum response, bins;
    response.resize(d_n_bins, 0); // zeros from one call to the next but where taps are
    bins.resize(d_n_bins);
    const float scale =
        1.0f / float(d_n_bins); // FFTW's transforms do not normalise; a power of two is exact
    for (std::size_t k = filter.first[used]; k < filter.first[used + 1]; k++)
        response[paths[k].delay] += paths[k].gain * scale;
    fftwf_execute_dft(d_plans->forward, fftw(response.data()), fftw(bins.data()));
    std::fill_n(response.begin(), d_n_taps, sample(0));
    constexpr std::size_t tile_bytes = bins_per_tile * sizeof(sample);
    const std::size_t stride = filter.inputs.size() * bins_per_tile;
    sample* to = filter.taps.data() + used * bins_per_tile;
    for (std::size_t bin = 0; bin < d_n_bins; bin += bins_per_tile, to += stride)
        std::memcpy(static_cast<void*>(to), bins.data() + bin, tile_bytes);
}

void overlap_save::transform(const sample* x, std::size_t n, sample* bins) const
{
    thread_local spectrum samples;
    samples.resize(d_n_bins);
    const std::size_t reach = d_n_taps - 1;
    std::copy_n(x - reach, reach + n, samples.begin());
    std::fill(samples.begin() + reach + n, samples.end(), sample(0));
    fftwf_execute_dft(d_plans->forward, fftw(samples.data()), fftw(bins));
}

void overlap_save::transform_back(const sample* bins, sample* samples) const
{
    fftwf_execute_dft(d_plans->backward, fftw(const_cast<sample*>(bins)), fftw(samples));
}

} // namespace kernel
} // namespace cast
} // namespace gr
