// SPDX-License-Identifier: GPL-3.0-or-later
#include "vector_kernels.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

// Lanes are moved, loops over registers unrolled, and instruction sets chosen for parts of this
// file, in the words of either compiler.
#define PRAGMA(words) _Pragma(#words)
#if defined(__clang__)
#define SHUFFLE(v, ...) __builtin_shufflevector(v, v, __VA_ARGS__)
#define UNROLL(n) PRAGMA(clang loop unroll_count(n))
#define BEGIN_TARGET(set)                                                                          \
    PRAGMA(clang attribute push(__attribute__((target(set))), apply_to = function))
#define END_TARGET PRAGMA(clang attribute pop)
#else
#define SHUFFLE(v, ...) __builtin_shuffle(v, lanes{__VA_ARGS__})
#define UNROLL(n) PRAGMA(GCC unroll n)
#define BEGIN_TARGET(set) PRAGMA(GCC push_options) PRAGMA(GCC target(set))
#define END_TARGET PRAGMA(GCC pop_options)
#endif

namespace gr
{
namespace cast
{
namespace kernel
{

constexpr int noise_pairs = 64; // made at once

// In each namespace keep() pins a value in a register: a sample loaded for two uses would otherwise
// be read from memory twice, and reads are what limits these loops.
namespace generic
{
// Four lanes: what SSE2 and NEON have.
typedef float vec __attribute__((vector_size(16)));
typedef float loose_vec __attribute__((vector_size(16), aligned(4), may_alias));
typedef int lanes __attribute__((vector_size(16)));
constexpr int width = 4, register_blocks = 4, most_blocks = 4;
static inline vec zero() { return vec{}; }
static inline vec broadcast(float a) { return vec{a, a, a, a}; }
static inline vec keep(vec v)
{
#if defined(__x86_64__)
    __asm__("" : "+x"(v));
#endif
    return v;
}
static inline vec load(const float* p) { return *reinterpret_cast<const loose_vec*>(p); }
static inline void store(float* p, vec v) { *reinterpret_cast<loose_vec*>(p) = v; }
static inline vec square_root(vec a)
{
    for (int lane = 0; lane < width; lane++)
        a[lane] = __builtin_sqrtf(a[lane]);
    return a;
}
static inline vec multiply_add(vec a, vec b, vec c) { return a * b + c; }
static inline float multiply_add(float a, float b, float c) { return a * b + c; }
static inline vec add_turned(vec a, vec b)
{
    const vec turned = SHUFFLE(b, 1, 0, 3, 2);
    return a + turned * vec{-1, 1, -1, 1};
}
static inline vec even_twice(vec a) { return SHUFFLE(a, 0, 0, 2, 2); }
static inline vec odd_twice(vec a) { return SHUFFLE(a, 1, 1, 3, 3); }
#include "vector_kernels_body.h"
} // namespace generic

#if defined(__x86_64__)
BEGIN_TARGET("avx2,fma")
namespace avx2
{
typedef __m256 vec;
constexpr int width = 8, register_blocks = 4, most_blocks = 4;
static inline vec zero() { return _mm256_setzero_ps(); }
static inline vec broadcast(float a) { return _mm256_set1_ps(a); }
static inline vec keep(vec v)
{
    __asm__("" : "+x"(v));
    return v;
}
static inline vec load(const float* p) { return keep(_mm256_loadu_ps(p)); }
static inline void store(float* p, vec v) { _mm256_storeu_ps(p, v); }
static inline vec square_root(vec a) { return _mm256_sqrt_ps(a); }
static inline vec multiply_add(vec a, vec b, vec c) { return _mm256_fmadd_ps(a, b, c); }
static inline float multiply_add(float a, float b, float c) { return __builtin_fmaf(a, b, c); }
static inline vec add_turned(vec a, vec b)
{
    return _mm256_addsub_ps(a, _mm256_permute_ps(b, 0xB1));
}
static inline vec even_twice(vec a) { return _mm256_moveldup_ps(a); }
static inline vec odd_twice(vec a) { return _mm256_movehdup_ps(a); }
#include "vector_kernels_body.h"
} // namespace avx2
END_TARGET

BEGIN_TARGET("avx512f,fma")
namespace avx512
{
typedef __m512 vec;
constexpr int width = 16, register_blocks = 12, most_blocks = 8;
static inline vec zero() { return _mm512_setzero_ps(); }
static inline vec broadcast(float a) { return _mm512_set1_ps(a); }
static inline vec keep(vec v)
{
    __asm__("" : "+v"(v));
    return v;
}
static inline vec load(const float* p) { return keep(_mm512_loadu_ps(p)); }
static inline void store(float* p, vec v) { _mm512_storeu_ps(p, v); }
static inline vec square_root(vec a) { return _mm512_maskz_sqrt_ps(0xffff, a); }
static inline vec multiply_add(vec a, vec b, vec c) { return _mm512_fmadd_ps(a, b, c); }
static inline float multiply_add(float a, float b, float c) { return __builtin_fmaf(a, b, c); }
static inline vec add_turned(vec a, vec b)
{
    return _mm512_fmaddsub_ps(_mm512_set1_ps(1.0f), a, _mm512_maskz_permute_ps(0xffff, b, 0xB1));
}
static inline vec even_twice(vec a) { return _mm512_maskz_moveldup_ps(0xffff, a); }
static inline vec odd_twice(vec a) { return _mm512_maskz_movehdup_ps(0xffff, a); }
#include "vector_kernels_body.h"
} // namespace avx512
END_TARGET
#endif

void mix_paths(isa set, const sample* const* in, const path* paths, std::size_t n_paths,
               sample* out, std::size_t n, const sample* soon)
{
    const auto* x = reinterpret_cast<const float* const*>(in);
    const auto* s = reinterpret_cast<const float*>(soon);
    auto* y = reinterpret_cast<float*>(out);
#if defined(__x86_64__)
    if (set == isa::avx512)
        return avx512::mix(x, paths, n_paths, y, 2 * n, s);
    if (set == isa::avx2)
        return avx2::mix(x, paths, n_paths, y, 2 * n, s);
#endif
    (void)set;
    generic::mix(x, paths, n_paths, y, 2 * n, s);
}

void multiply_spectra(isa set, const sample* spectra, std::size_t stride, int n_inputs,
                      const spectral_product* products, std::size_t n_products, std::size_t begin,
                      std::size_t end)
{
    const auto* x = reinterpret_cast<const float*>(spectra);
#if defined(__x86_64__)
    if (set == isa::avx512)
        return avx512::multiply(x, 2 * stride, n_inputs, products, n_products, begin, end);
    if (set == isa::avx2)
        return avx2::multiply(x, 2 * stride, n_inputs, products, n_products, begin, end);
#endif
    (void)set;
    generic::multiply(x, 2 * stride, n_inputs, products, n_products, begin, end);
}

void add_noise(isa set, uint64_t seed, uint32_t stream, uint64_t number, float amplitude,
               sample* out, std::size_t n)
{
    auto* y = reinterpret_cast<float*>(out);
#if defined(__x86_64__)
    if (set == isa::avx512)
        return avx512::add_noise(seed, stream, number, amplitude, y, n);
    if (set == isa::avx2)
        return avx2::add_noise(seed, stream, number, amplitude, y, n);
#endif
    (void)set;
    generic::add_noise(seed, stream, number, amplitude, y, n);
}

std::size_t quantize(isa set, const sample* in, float full_scale, int bits, sample* out,
                     std::size_t n)
{
    const float levels = float(1 << (bits - 1));
    const auto* x = reinterpret_cast<const float*>(in);
    auto* y = reinterpret_cast<float*>(out);
#if defined(__x86_64__)
    if (set == isa::avx512)
        return avx512::quantize(x, levels / full_scale, levels - 1, y, n);
    if (set == isa::avx2)
        return avx2::quantize(x, levels / full_scale, levels - 1, y, n);
#endif
    (void)set;
    return generic::quantize(x, levels / full_scale, levels - 1, y, n);
}

void measure(isa set, const sample* in, std::size_t n, level& total)
{
    const auto* x = reinterpret_cast<const float*>(in);
    total.n += n;
#if defined(__x86_64__)
    if (set == isa::avx512)
        return avx512::measure(x, 2 * n, total.energy, total.peak);
    if (set == isa::avx2)
        return avx2::measure(x, 2 * n, total.energy, total.peak);
#endif
    (void)set;
    generic::measure(x, 2 * n, total.energy, total.peak);
}

double turn_multiply_adds(isa set, long turns)
{
#if defined(__x86_64__)
    if (set == isa::avx512)
        return avx512::turn(turns);
    if (set == isa::avx2)
        return avx2::turn(turns);
#endif
    (void)set;
    return generic::turn(turns);
}

} // namespace kernel
} // namespace cast
} // namespace gr
