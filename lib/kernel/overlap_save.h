// SPDX-License-Identifier: GPL-3.0-or-later
// Long filters by fast convolution: one transform per input is shared by every output, products are
// summed bin by bin, one transform back per output (overlap-save).
#pragma once

#include "lane_fft.h"
#include "vector_kernels.h"
#include <memory>
#include <new>
#include <utility>
#include <vector>

namespace gr
{
namespace cast
{
namespace kernel
{

template <class T> struct cache_aligned {
    using value_type = T;
    cache_aligned() = default;
    template <class U> cache_aligned(const cache_aligned<U>&) {}
    T* allocate(std::size_t n)
    {
        return static_cast<T*>(::operator new(n * sizeof(T), std::align_val_t(64)));
    }
    // What is only made room for is written before it is read: no zeros first.
    template <class U> void construct(U*) {}
    template <class U, class A, class... B> void construct(U* p, A&& a, B&&... b)
    {
        ::new (static_cast<void*>(p)) U(std::forward<A>(a), std::forward<B>(b)...);
    }
    void deallocate(T* p, std::size_t) { ::operator delete(p, std::align_val_t(64)); }
    bool operator==(const cache_aligned&) const { return true; }
    bool operator!=(const cache_aligned&) const { return false; }
};
using spectrum = std::vector<sample, cache_aligned<sample>>;
using path_list = std::vector<path, cache_aligned<path>>; // in order of input

// The filters of one output as spectra, of the inputs that it hears.
struct dense_filter {
    std::vector<int> inputs;
    std::vector<std::size_t> first; // path of each input heard, and one past the last
    spectrum taps;                  // [tile][input heard][bin]; empty until needed

    // Hears nothing, and keeps its room.
    void clear()
    {
        inputs.clear();
        first.assign(1, 0);
        taps.clear();
    }
};

// Of many signals; only overlap_save knows how they lie.
struct spectra {
    spectrum bins;
    std::size_t next_group = 0; // of bins, see lane_fft
};

class overlap_save
{
public:
    overlap_save(int n_taps, isa set);
    ~overlap_save();
    overlap_save(const overlap_save&) = delete;
    overlap_save& operator=(const overlap_save&) = delete;

    std::size_t n_bins() const { return d_n_bins; }
    // Samples that one block brings forth: whole vectors.
    std::size_t block() const { return d_n_bins - d_past; }

    // Room for the spectra of what is heard; fill() then makes each input's part.
    void reserve(dense_filter& filter) const
    {
        filter.taps.resize(filter.inputs.size() * d_n_bins);
    }
    void fill(dense_filter& filter, const path_list& paths, int used) const;

    // Room for n spectra.
    void reserve(spectra& of, std::size_t n) const;

    // Samples x[0 … n-1], n <= block(), and the n_taps-1 before them, into spectrum k.
    void transform(const sample* x, std::size_t n, spectra& to, std::size_t k) const;

    // What outputs hear: results of products are spectra `first_result` … of `to`, the spectrum of
    // input i in block b is number b * n_inputs + i. Bins [begin, end).
    struct product {
        const dense_filter* filter;
        int block, n_blocks;
        std::size_t first_result;
    };
    void multiply(const spectra& of, int n_inputs, const std::vector<product>& products,
                  spectra& to, std::size_t begin, std::size_t end) const;

    // Spectrum k back to samples, of which [begin, end) of the block are wanted; it is lost.
    void transform_back(spectra& of, std::size_t k, std::size_t begin, std::size_t end,
                        sample* out) const;

private:
    const isa d_isa;
    const std::size_t d_n_taps, d_n_bins;
    const std::size_t d_past;  // samples before those of the block: n_taps-1, in whole vectors
    const std::size_t d_shift; // which that makes more; by so much all filters are late
    const std::unique_ptr<lane_fft> d_lanes;
    const std::size_t d_stride; // from one spectrum to the next: not a multiple of 4096 bytes
    struct plans;
    std::unique_ptr<plans> d_plans; // where there are no lanes
};

} // namespace kernel
} // namespace cast
} // namespace gr
