// SPDX-License-Identifier: GPL-3.0-or-later
#include "sparse.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace gr
{
namespace cast
{
namespace kernel
{

namespace generic
{
// Four lanes: what SSE2 and NEON have.
typedef float vec __attribute__((vector_size(16)));
typedef float loose_vec __attribute__((vector_size(16), aligned(4), may_alias));
typedef int lanes __attribute__((vector_size(16)));
constexpr int width = 4, register_blocks = 4;
static inline vec zero() { return vec{}; }
static inline vec broadcast(float a) { return vec{a, a, a, a}; }
static inline vec load(const float* p) { return *reinterpret_cast<const loose_vec*>(p); }
static inline void store(float* p, vec v) { *reinterpret_cast<loose_vec*>(p) = v; }
static inline vec multiply_add(vec a, vec b, vec c) { return a * b + c; }
static inline float multiply_add(float a, float b, float c) { return a * b + c; }
static inline vec add_turned(vec a, vec b)
{
    const vec turned = __builtin_shuffle(b, lanes{1, 0, 3, 2});
    return a + turned * vec{-1, 1, -1, 1};
}
#include "sparse_body.h"
} // namespace generic

#if defined(__x86_64__)
#pragma GCC push_options
#pragma GCC target("avx2,fma")
namespace avx2
{
typedef __m256 vec;
constexpr int width = 8, register_blocks = 4;
static inline vec zero() { return _mm256_setzero_ps(); }
static inline vec broadcast(float a) { return _mm256_set1_ps(a); }
static inline vec load(const float* p) { return _mm256_loadu_ps(p); }
static inline void store(float* p, vec v) { _mm256_storeu_ps(p, v); }
static inline vec multiply_add(vec a, vec b, vec c) { return _mm256_fmadd_ps(a, b, c); }
static inline float multiply_add(float a, float b, float c) { return __builtin_fmaf(a, b, c); }
static inline vec add_turned(vec a, vec b)
{
    return _mm256_addsub_ps(a, _mm256_permute_ps(b, 0xB1));
}
#include "sparse_body.h"
} // namespace avx2
#pragma GCC pop_options

#pragma GCC push_options
#pragma GCC target("avx512f,fma")
namespace avx512
{
typedef __m512 vec;
typedef int lanes __attribute__((vector_size(64)));
constexpr int width = 16, register_blocks = 8;
static inline vec zero() { return _mm512_setzero_ps(); }
static inline vec broadcast(float a) { return _mm512_set1_ps(a); }
static inline vec load(const float* p) { return _mm512_loadu_ps(p); }
static inline void store(float* p, vec v) { _mm512_storeu_ps(p, v); }
static inline vec multiply_add(vec a, vec b, vec c) { return _mm512_fmadd_ps(a, b, c); }
static inline float multiply_add(float a, float b, float c) { return __builtin_fmaf(a, b, c); }
static inline vec add_turned(vec a, vec b)
{
    const lanes swap = {1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 13, 12, 15, 14};
    return _mm512_fmaddsub_ps(_mm512_set1_ps(1.0f), a, __builtin_shuffle(b, swap));
}
#include "sparse_body.h"
} // namespace avx512
#pragma GCC pop_options
#endif

void mix_sparse(isa set, const sample* const* in, const path* paths, std::size_t n_paths,
                sample* out, std::size_t n)
{
    const auto* x = reinterpret_cast<const float* const*>(in);
    auto* y = reinterpret_cast<float*>(out);
#if defined(__x86_64__)
    if (set == isa::avx512)
        return avx512::mix(x, paths, n_paths, y, 2 * n);
    if (set == isa::avx2)
        return avx2::mix(x, paths, n_paths, y, 2 * n);
#endif
    (void)set;
    generic::mix(x, paths, n_paths, y, 2 * n);
}

} // namespace kernel
} // namespace cast
} // namespace gr
