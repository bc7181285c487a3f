// SPDX-License-Identifier: GPL-3.0-or-later
// Long filters by fast convolution: one transform per input is shared by every output, products are
// summed bin by bin, one transform back per output (overlap-save).
#pragma once

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

class overlap_save
{
public:
    explicit overlap_save(int n_taps);
    ~overlap_save();
    overlap_save(const overlap_save&) = delete;
    overlap_save& operator=(const overlap_save&) = delete;

    std::size_t n_bins() const { return d_n_bins; }
    // Samples that one block brings forth.
    std::size_t block() const { return d_n_bins - (d_n_taps - 1); }

    // Room for the spectra of what is heard; fill() then makes each input's part.
    void reserve(dense_filter& filter) const
    {
        filter.taps.resize(filter.inputs.size() * d_n_bins);
    }
    void fill(dense_filter& filter, const path_list& paths, int used) const;

    // Samples between the spectra of two inputs: not a multiple of 4096 bytes, where caches would
    // clash.
    std::size_t stride() const { return d_n_bins + bins_per_tile; }

    // Samples x[0 … n-1], n <= block(), and the n_taps-1 before them, into bins[0 … n_bins()-1].
    void transform(const sample* x, std::size_t n, sample* bins) const;

    // Back to samples, of which the block's first has index n_taps-1.
    void transform_back(const sample* bins, sample* samples) const;

private:
    const std::size_t d_n_taps, d_n_bins;
    struct plans;
    std::unique_ptr<plans> d_plans;
};

} // namespace kernel
} // namespace cast
} // namespace gr
