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

overlap_save::overlap_save(int n_taps, isa set)
    : d_isa(set), d_n_taps(n_taps), d_n_bins(choose_bins(n_taps)),
      d_past((d_n_taps - 1 + 15) / 16 * 16), d_shift(d_past - (d_n_taps - 1)),
      d_lanes(lane_fft::make(set, d_n_bins)),
      d_stride(d_lanes ? lane_fft::stride : d_n_bins + bins_per_tile),
      d_plans(d_lanes ? nullptr : std::make_unique<plans>(d_n_bins))
{
}

overlap_save::~overlap_save() = default;

void overlap_save::fill(dense_filter& filter, const path_list& paths, int used) const
{
    thread_local spectrum response, bins;
    response.resize(d_n_bins, 0); // zeros from one call to the next but where taps are
    const float scale =
        1.0f / float(d_n_bins); // the transforms do not normalise; a power of two is exact
    for (std::size_t k = filter.first[used]; k < filter.first[used + 1]; k++)
        response[paths[k].delay + d_shift] += paths[k].gain * scale;
    const std::size_t next_tile = filter.inputs.size() * bins_per_tile;
    sample* to = filter.taps.data() + used * bins_per_tile;
    if (d_lanes)
        d_lanes->forward(response.data(), d_past + 1, to, lane_fft::group / 16 * next_tile,
                         next_tile);
    else {
        bins.resize(d_n_bins);
        fftwf_execute_dft(d_plans->forward, fftw(response.data()), fftw(bins.data()));
        for (std::size_t bin = 0; bin < d_n_bins; bin += bins_per_tile, to += next_tile)
            std::copy_n(bins.data() + bin, bins_per_tile, to);
    }
    std::fill_n(response.begin(), d_past + 1, sample(0));
}

void overlap_save::reserve(spectra& of, std::size_t n) const
{
    of.next_group = d_lanes ? n * d_stride : 0;
    of.bins.resize(n * d_stride * (d_lanes ? d_n_bins / lane_fft::group : 1));
}

void overlap_save::transform(const sample* x, std::size_t n, spectra& to, std::size_t k) const
{
    const std::size_t reach = d_n_taps - 1;
    sample* bins = to.bins.data() + k * d_stride;
    if (d_lanes)
        return d_lanes->forward(x - reach, reach + n, bins, to.next_group);
    thread_local spectrum samples;
    samples.resize(d_n_bins);
    std::copy_n(x - reach, reach + n, samples.begin());
    std::fill(samples.begin() + reach + n, samples.end(), sample(0));
    fftwf_execute_dft(d_plans->forward, fftw(samples.data()), fftw(bins));
}

void overlap_save::multiply(const spectra& of, int n_inputs, const std::vector<product>& products,
                            spectra& to, std::size_t begin, std::size_t end) const
{
    std::vector<spectral_product> sums;
    for (const product& p : products)
        sums.push_back({p.filter->taps.data(), p.filter->inputs.data(),
                        int(p.filter->inputs.size()), p.block, p.n_blocks,
                        to.bins.data() + p.first_result * d_stride});
    if (d_lanes)
        lane_fft::multiply(of.bins.data(), of.next_group, n_inputs, sums.data(), sums.size(),
                           to.next_group, begin, end);
    else
        multiply_spectra(d_isa, of.bins.data(), d_stride, n_inputs, sums.data(), sums.size(), begin,
                         end);
}

void overlap_save::transform_back(spectra& of, std::size_t k, std::size_t begin, std::size_t end,
                                  sample* out) const
{
    sample* bins = of.bins.data() + k * d_stride;
    if (d_lanes)
        return d_lanes->backward(bins, of.next_group, d_past + begin, d_past + end, out);
    thread_local spectrum samples;
    samples.resize(d_n_bins);
    fftwf_execute_dft(d_plans->backward, fftw(bins), fftw(samples.data()));
    std::copy(samples.begin() + d_past + begin, samples.begin() + d_past + end, out);
}

} // namespace kernel
} // namespace cast
} // namespace gr
