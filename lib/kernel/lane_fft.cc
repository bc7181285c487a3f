// SPDX-License-Identifier: GPL-3.0-or-later
// n = 256 m1 + 16 m2 + l and k = ka + radix * kb + 16 radix * k2, with ka, m1 < radix and the
// others < 16; l is the lane of samples, kb that of bins, and tile ka * 16 + k2 of the spectrum
// holds all kb.
#include "lane_fft.h"

#include <cmath>
#include <utility>

#if defined(__x86_64__)
#include <immintrin.h>
#if defined(__clang__)
#pragma clang attribute push(__attribute__((target("avx512f,fma"))), apply_to = function)
#define UNROLL _Pragma("clang loop unroll(full)")
#else
#pragma GCC push_options
#pragma GCC target("avx512f,fma")
#define UNROLL _Pragma("GCC unroll 16")
#endif

namespace gr
{
namespace cast
{
namespace kernel
{
namespace
{

typedef __m512 vec;
constexpr __mmask16 all_lanes = 0xffff;

struct pair {
    vec re, im;
};

inline pair operator+(pair a, pair b) { return {a.re + b.re, a.im + b.im}; }
inline pair operator-(pair a, pair b) { return {a.re - b.re, a.im - b.im}; }

// a * (w_re + i w_im), or with the conjugate.
template <bool back> inline pair turned(pair a, vec w_re, vec w_im)
{
    if constexpr (back)
        return {_mm512_fmadd_ps(a.im, w_im, a.re * w_re), _mm512_fmsub_ps(a.im, w_re, a.re * w_im)};
    else
        return {_mm512_fmsub_ps(a.re, w_re, a.im * w_im), _mm512_fmadd_ps(a.re, w_im, a.im * w_re)};
}

template <bool back> inline pair turned(pair a, float w_re, float w_im)
{
    return turned<back>(a, _mm512_set1_ps(w_re), _mm512_set1_ps(w_im));
}

// a * exp(-i pi/4), exp(-i pi/2), exp(-3i pi/4), or with the conjugates.
template <bool back> inline pair turned_eighth(pair a)
{
    const vec half = _mm512_set1_ps(float(M_SQRT1_2));
    if constexpr (back)
        return {(a.re - a.im) * half, (a.re + a.im) * half};
    else
        return {(a.re + a.im) * half, (a.im - a.re) * half};
}

template <bool back> inline pair turned_quarter(pair a)
{
    if constexpr (back)
        return {-a.im, a.re};
    else
        return {a.im, -a.re};
}

// `one` is 1 in all lanes: additions wait for their units while those for multiply-adds have little
// to do, so that these do a quarter of them.
template <bool back> inline void dft4(vec one, pair& a, pair& b, pair& c, pair& d)
{
    const pair s = a + c, t = a - c, u = b + d, v = b - d;
    a = s + u;
    c = {_mm512_fnmadd_ps(u.re, one, s.re), _mm512_fnmadd_ps(u.im, one, s.im)};
    const pair plus{t.re + v.im, t.im - v.re};
    const pair minus{_mm512_fnmadd_ps(v.im, one, t.re), _mm512_fmadd_ps(v.re, one, t.im)};
    b = back ? minus : plus;
    d = back ? plus : minus;
}

template <bool back> inline void dft8(vec one, pair* x)
{
    dft4<back>(one, x[0], x[2], x[4], x[6]);
    dft4<back>(one, x[1], x[3], x[5], x[7]);
    const pair odd[4] = {x[1], turned_eighth<back>(x[3]), turned_quarter<back>(x[5]),
                         turned_quarter<back>(turned_eighth<back>(x[7]))};
    const pair even[4] = {x[0], x[2], x[4], x[6]};
    UNROLL
    for (int k = 0; k < 4; k++) {
        x[k] = even[k] + odd[k];
        x[k + 4] = even[k] - odd[k];
    }
}

template <bool back> inline void dft16(vec one, pair* x)
{
    UNROLL
    for (int r = 0; r < 4; r++)
        dft4<back>(one, x[r], x[r + 4], x[r + 8], x[r + 12]);
    const float c = 0.92387953251128674f, s = 0.38268343236508977f; // of pi/8
    x[5] = turned<back>(x[5], c, -s);
    x[9] = turned_eighth<back>(x[9]);
    x[13] = turned<back>(x[13], s, -c);
    x[6] = turned_eighth<back>(x[6]);
    x[10] = turned_quarter<back>(x[10]);
    x[14] = turned_quarter<back>(turned_eighth<back>(x[14]));
    x[7] = turned<back>(x[7], s, -c);
    x[11] = turned_quarter<back>(turned_eighth<back>(x[11]));
    x[15] = turned<back>(x[15], -c, s);
    UNROLL
    for (int q = 0; q < 4; q++)
        dft4<back>(one, x[4 * q], x[4 * q + 1], x[4 * q + 2], x[4 * q + 3]);
    // x[4 q + p] is bin q + 4 p
    UNROLL
    for (int q = 0; q < 4; q++)
        for (int p = 0; p < q; p++)
            std::swap(x[4 * q + p], x[4 * p + q]);
}

template <int radix, bool back> inline void dft(vec one, pair* x)
{
    if constexpr (radix == 4)
        dft4<back>(one, x[0], x[1], x[2], x[3]);
    else if constexpr (radix == 8)
        dft8<back>(one, x);
    else
        dft16<back>(one, x);
}

inline vec low(vec a, vec b)
{
    return _mm512_castpd_ps(
        _mm512_maskz_unpacklo_pd(0xff, _mm512_castps_pd(a), _mm512_castps_pd(b)));
}
inline vec high(vec a, vec b)
{
    return _mm512_castpd_ps(
        _mm512_maskz_unpackhi_pd(0xff, _mm512_castps_pd(a), _mm512_castps_pd(b)));
}

inline void swap_lanes(vec* v)
{
    vec t[16];
    UNROLL
    for (int k = 0; k < 16; k += 2) {
        t[k] = _mm512_maskz_unpacklo_ps(all_lanes, v[k], v[k + 1]);
        t[k + 1] = _mm512_maskz_unpackhi_ps(all_lanes, v[k], v[k + 1]);
    }
    UNROLL
    for (int k = 0; k < 16; k += 4) { // v[k + c]: lanes c of rows k … k+3, one per quarter
        v[k] = low(t[k], t[k + 2]);
        v[k + 1] = high(t[k], t[k + 2]);
        v[k + 2] = low(t[k + 1], t[k + 3]);
        v[k + 3] = high(t[k + 1], t[k + 3]);
    }
    UNROLL
    for (int k = 0; k < 8; k++) {
        const int a = k / 4 * 8 + k % 4;
        t[a] = _mm512_maskz_shuffle_f32x4(all_lanes, v[a], v[a + 4], 0x88);
        t[a + 4] = _mm512_maskz_shuffle_f32x4(all_lanes, v[a], v[a + 4], 0xdd);
    }
    UNROLL
    for (int k = 0; k < 4; k++) {
        v[k] = _mm512_maskz_shuffle_f32x4(all_lanes, t[k], t[k + 8], 0x88);
        v[k + 8] = _mm512_maskz_shuffle_f32x4(all_lanes, t[k], t[k + 8], 0xdd);
        v[k + 4] = _mm512_maskz_shuffle_f32x4(all_lanes, t[k + 4], t[k + 12], 0x88);
        v[k + 12] = _mm512_maskz_shuffle_f32x4(all_lanes, t[k + 4], t[k + 12], 0xdd);
    }
}

inline void swap_lanes(pair* x)
{
    vec part[16];
    UNROLL
    for (int k = 0; k < 16; k++)
        part[k] = x[k].re;
    swap_lanes(part);
    UNROLL
    for (int k = 0; k < 16; k++) {
        x[k].re = part[k];
        part[k] = x[k].im;
    }
    swap_lanes(part);
    UNROLL
    for (int k = 0; k < 16; k++)
        x[k].im = part[k];
}

inline pair load(const float* p) { return {_mm512_loadu_ps(p), _mm512_loadu_ps(p + 16)}; }
inline void store(float* p, pair a)
{
    _mm512_storeu_ps(p, a.re);
    _mm512_storeu_ps(p + 16, a.im);
}

// Of 16 samples, or the first so many of them.
inline pair load_samples(const float* x, long n_floats)
{
    vec a, b;
    if (n_floats >= 32) {
        a = _mm512_loadu_ps(x);
        b = _mm512_loadu_ps(x + 16);
    } else {
        const uint32_t mask = n_floats <= 0 ? 0 : (1u << n_floats) - 1;
        a = _mm512_maskz_loadu_ps(__mmask16(mask), x);
        b = _mm512_maskz_loadu_ps(__mmask16(mask >> 16), x + 16);
    }
    const __m512i even =
        _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
    const __m512i odd =
        _mm512_setr_epi32(1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
    return {_mm512_permutex2var_ps(a, even, b), _mm512_permutex2var_ps(a, odd, b)};
}

// Those of 16 samples that are numbers [from, to) of out, the first of them number `at`.
inline void store_samples(float* out, long at, long from, long to, pair v)
{
    const __m512i low = _mm512_setr_epi32(0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
    const __m512i high =
        _mm512_setr_epi32(8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
    const vec a = _mm512_permutex2var_ps(v.re, low, v.im);
    const vec b = _mm512_permutex2var_ps(v.re, high, v.im);
    float* y = out + 2 * (at - from);
    if (at >= from && at + 16 <= to) {
        _mm512_storeu_ps(y, a);
        _mm512_storeu_ps(y + 16, b);
        return;
    }
    uint32_t mask = 0xffffffffu;
    if (at < from)
        mask = from - at >= 16 ? 0 : mask << (2 * (from - at));
    if (at + 16 > to)
        mask = at >= to ? 0 : mask & (0xffffffffu >> (2 * (at + 16 - to)));
    _mm512_mask_storeu_ps(y, __mmask16(mask), a);
    _mm512_mask_storeu_ps(y + 16, __mmask16(mask >> 16), b);
}

// Powers 1 … radix-1 of a factor, of which the table has those to the powers of two.
template <int radix> inline void powers(const float* table, pair* w)
{
    UNROLL
    for (int k = 1; k < radix; k++) {
        const int top = k >= 8 ? 8 : k >= 4 ? 4 : k >= 2 ? 2 : 1;
        if (k == top) {
            w[k] = load(table);
            table += 32;
        } else
            w[k] = turned<false>(w[top], w[k - top].re, w[k - top].im);
    }
}

// Of as many values as fill a quarter, the others being 0.
template <int radix> inline void dft_of_quarter(vec one, pair* x)
{
    if constexpr (radix == 4)
        x[1] = x[2] = x[3] = x[0];
    else if constexpr (radix == 8) {
        const pair eighth = turned_eighth<false>(x[1]);
        const pair odd[4] = {x[1], eighth, turned_quarter<false>(x[1]),
                             turned_quarter<false>(eighth)};
        const pair even = x[0];
        UNROLL
        for (int k = 0; k < 4; k++) {
            x[k] = even + odd[k];
            x[k + 4] = even - odd[k];
        }
    } else {
        UNROLL
        for (int k = radix / 4; k < radix; k++)
            x[k] = {_mm512_setzero_ps(), _mm512_setzero_ps()};
        dft<radix, false>(one, x);
    }
}

// Tile k2 of group ka at bins + ka * next_group + k2 * next_tile; where tiles lie apart, steps
// before the last go to memory of their own.
template <int radix, bool apart>
void go_forward(const float* x, long n_floats, float* bins, std::size_t next_group,
                std::size_t next_tile, const float* first, const float* last)
{
    const vec one = _mm512_loadu_ps(last); // the power 0
    constexpr int n_tables = radix == 4 ? 2 : radix == 8 ? 3 : 4;
    alignas(64) float own[apart ? 512 * radix : 1];
    float* const steps = apart ? own : bins;
    const std::size_t next_step = apart ? 512 : next_group;
    for (int m2 = 0; m2 < 16; m2++, first += 32 * n_tables) {
        pair v[radix], w[radix];
        const long here = n_floats - 32 * m2;
        if (here <= 512 * (radix / 4)) {
            UNROLL
            for (int m1 = 0; m1 < radix / 4; m1++)
                v[m1] = load_samples(x + 512 * m1 + 32 * m2, here - 512 * m1);
            dft_of_quarter<radix>(one, v);
        } else {
            UNROLL
            for (int m1 = 0; m1 < radix; m1++)
                v[m1] = load_samples(x + 512 * m1 + 32 * m2, here - 512 * m1);
            dft<radix, false>(one, v);
        }
        powers<radix>(first, w);
        store(steps + 32 * m2, v[0]);
        UNROLL
        for (int ka = 1; ka < radix; ka++)
            store(steps + ka * next_step + 32 * m2, turned<false>(v[ka], w[ka].re, w[ka].im));
    }
    for (int ka = 0; ka < radix; ka++) {
        pair v[16];
        UNROLL
        for (int m2 = 0; m2 < 16; m2++)
            v[m2] = load(steps + ka * next_step + 32 * m2);
        dft16<false>(one, v);
        UNROLL
        for (int kb = 1; kb < 16; kb++) {
            const pair w = load(last + 32 * kb);
            v[kb] = turned<false>(v[kb], w.re, w.im);
        }
        swap_lanes(v);
        dft16<false>(one, v);
        float* to = bins + ka * next_group;
        UNROLL
        for (int k2 = 0; k2 < 16; k2++, to += apart ? next_tile : 32)
            store(to, v[k2]);
    }
}

template <int radix>
void go_back(float* bins, std::size_t next_group, long from, long to, float* out,
             const float* first, const float* last)
{
    const vec one = _mm512_loadu_ps(last); // the power 0
    constexpr int n_tables = radix == 4 ? 2 : radix == 8 ? 3 : 4;
    for (int ka = 0; ka < radix; ka++) {
        float* tiles = bins + ka * next_group;
        pair v[16];
        UNROLL
        for (int k2 = 0; k2 < 16; k2++)
            v[k2] = load(tiles + 32 * k2);
        dft16<true>(one, v);
        swap_lanes(v);
        UNROLL
        for (int kb = 1; kb < 16; kb++) {
            const pair w = load(last + 32 * kb);
            v[kb] = turned<true>(v[kb], w.re, w.im);
        }
        dft16<true>(one, v);
        UNROLL
        for (int m2 = 0; m2 < 16; m2++)
            store(tiles + 32 * m2, v[m2]);
    }
    for (int m2 = 0; m2 < 16; m2++, first += 32 * n_tables) {
        pair v[radix], w[radix];
        powers<radix>(first, w);
        v[0] = load(bins + 32 * m2);
        UNROLL
        for (int ka = 1; ka < radix; ka++)
            v[ka] = turned<true>(load(bins + ka * next_group + 32 * m2), w[ka].re, w[ka].im);
        dft<radix, true>(one, v);
        UNROLL
        for (int m1 = 0; m1 < radix; m1++)
            store_samples(out, 256 * m1 + 16 * m2, from, to, v[m1]);
    }
}

// One tile of all blocks of a product. A complex product takes three multiply-adds, of sums that
// are made where additions cost nothing: Re = hr (xr + xi) - xi (hr + hi), Im = hr (xr + xi) + xr
// (hi - hr).
template <int n_blocks>
void multiply_tile(const float* spectra, const float* taps, const spectral_product& product,
                   std::size_t next_block, float* result)
{
    constexpr std::size_t stride = 2 * lane_fft::stride;
    vec both[n_blocks], less[n_blocks], more[n_blocks];
    UNROLL
    for (int b = 0; b < n_blocks; b++)
        both[b] = less[b] = more[b] = _mm512_setzero_ps();
    for (int u = 0; u < product.n_used; u++) {
        const pair h = load(taps + 32 * u);
        const vec sum = h.re + h.im, difference = h.im - h.re;
        const float* of_input = spectra + product.inputs[u] * stride;
        UNROLL
        for (int b = 0; b < n_blocks; b++) {
            const pair x = load(of_input + b * next_block);
            both[b] = _mm512_fmadd_ps(h.re, x.re + x.im, both[b]);
            less[b] = _mm512_fmadd_ps(sum, x.im, less[b]);
            more[b] = _mm512_fmadd_ps(difference, x.re, more[b]);
        }
    }
    UNROLL
    for (int b = 0; b < n_blocks; b++)
        store(result + b * stride, {both[b] - less[b], both[b] + more[b]});
}

template <int n_blocks>
void multiply_blocks(const float* spectra, const float* taps, const spectral_product& product,
                     std::size_t next_block, float* result)
{
    if constexpr (n_blocks > 1)
        if (product.n_blocks < n_blocks)
            return multiply_blocks<n_blocks - 1>(spectra, taps, product, next_block, result);
    multiply_tile<n_blocks>(spectra, taps, product, next_block, result);
}

} // namespace
} // namespace kernel
} // namespace cast
} // namespace gr

#if defined(__clang__)
#pragma clang attribute pop
#else
#pragma GCC pop_options
#endif
#endif

namespace gr
{
namespace cast
{
namespace kernel
{

std::unique_ptr<lane_fft> lane_fft::make(isa set, std::size_t n_bins)
{
    if (set != isa::avx512 || (n_bins != 1024 && n_bins != 2048 && n_bins != 4096))
        return nullptr;
    return std::unique_ptr<lane_fft>(new lane_fft(n_bins));
}

lane_fft::lane_fft(std::size_t n_bins) : d_n_bins(n_bins)
{
    const auto add = [](std::vector<float>& to, double turns_per_lane, double turns) {
        for (int part = 0; part < 2; part++)
            for (int lane = 0; lane < 16; lane++) {
                const double angle = 2 * M_PI * (turns + lane * turns_per_lane);
                to.push_back(float(part == 0 ? std::cos(angle) : -std::sin(angle)));
            }
    };
    for (int m2 = 0; m2 < 16; m2++)
        for (std::size_t ka = 1; ka < n_bins / 256; ka *= 2)
            add(d_first, double(ka) / n_bins, 16.0 * m2 * ka / n_bins);
    for (int kb = 0; kb < 16; kb++)
        add(d_last, kb / 256.0, 0);
}

#if defined(__x86_64__)

void lane_fft::forward(const sample* x, std::size_t n, sample* bins, std::size_t next_group,
                       std::size_t next_tile) const
{
    const auto go = [&](auto&& in_place, auto&& apart) {
        (next_tile == 16 ? in_place : apart)(reinterpret_cast<const float*>(x), long(2 * n),
                                             reinterpret_cast<float*>(bins), 2 * next_group,
                                             2 * next_tile, d_first.data(), d_last.data());
    };
    d_n_bins == 1024   ? go(go_forward<4, false>, go_forward<4, true>)
    : d_n_bins == 2048 ? go(go_forward<8, false>, go_forward<8, true>)
                       : go(go_forward<16, false>, go_forward<16, true>);
}

void lane_fft::backward(sample* bins, std::size_t next_group, std::size_t begin, std::size_t end,
                        sample* out) const
{
    const auto go = [&](auto&& with) {
        with(reinterpret_cast<float*>(bins), 2 * next_group, long(begin), long(end),
             reinterpret_cast<float*>(out), d_first.data(), d_last.data());
    };
    d_n_bins == 1024 ? go(go_back<4>) : d_n_bins == 2048 ? go(go_back<8>) : go(go_back<16>);
}

void lane_fft::multiply(const sample* spectra, std::size_t next_group, int n_inputs,
                        const spectral_product* products, std::size_t n_products,
                        std::size_t next_result_group, std::size_t begin, std::size_t end)
{
    const std::size_t next_block = 2 * n_inputs * stride;
    const auto floats = [](auto* samples) { return reinterpret_cast<const float*>(samples); };
    for (std::size_t tile = begin / 16; tile < end / 16; tile++)
        for (const auto* p = products; p < products + n_products; p++)
            multiply_blocks<max_blocks>(
                floats(spectra + tile / 16 * next_group + tile % 16 * 16) + p->block * next_block,
                floats(p->taps + tile * p->n_used * 16), *p, next_block,
                reinterpret_cast<float*>(p->results + tile / 16 * next_result_group +
                                         tile % 16 * 16));
}

#else

void lane_fft::forward(const sample*, std::size_t, sample*, std::size_t, std::size_t) const {}
void lane_fft::backward(sample*, std::size_t, std::size_t, std::size_t, sample*) const {}
void lane_fft::multiply(const sample*, std::size_t, int, const spectral_product*, std::size_t,
                        std::size_t, std::size_t, std::size_t)
{
}

#endif

} // namespace kernel
} // namespace cast
} // namespace gr
