// SPDX-License-Identifier: GPL-3.0-or-later
// The steps of arrays.py for a graphics card, compiled at run time. Defined from outside, per form
// of the network: BINS (L), TILE (blocks transformed together), PAST (n_taps - 1), STORED (spectra:
// 0 floats, 1 halves, 2 halves and what rounding leaves of them), INT16_IN, INT16_OUT.
// tests/emulation/test_gpu_kernels.py compiles the same text for the processor, where host_cuda.h
// stands in for CUDA.
#ifdef HOST_CUDA
#include "host_cuda.h"
#else
#define SHARED_MEMORY(name) extern __shared__ float2 name[]
__device__ inline unsigned half_of(float x)
{
    unsigned short h;
    asm("cvt.rn.f16.f32 %0, %1;" : "=h"(h) : "f"(x));
    return h;
}
__device__ inline float float_of(unsigned half)
{
    float x;
    asm("cvt.f32.f16 %0, %1;" : "=f"(x) : "h"((unsigned short)half));
    return x;
}
#endif

typedef unsigned long long u64;
typedef long long i64;
typedef unsigned short delay_type;

constexpr int each = 16;          // bins that one thread holds
constexpr int team = BINS / each; // threads of one transform
constexpr int step = BINS - PAST; // samples that one block brings forth
constexpr int row =
    BINS + BINS / 16 + 4; // of shared memory, per transform: no two threads meet in a bank
constexpr int threads = TILE * team,
              blocks_at_once = threads > 512 ? 1 : 1024 / threads; // on one multiprocessor
constexpr int bins_per_thread = 32;                                // of a sparse filter's spectrum

// What a converter gives: within its full scale, and 0 for what is no number.
__device__ inline float held(float x, float low, float high)
{
    return x != x ? 0.0f : fminf(fmaxf(x, low), high);
}
__device__ inline int place(int bin) { return bin + (bin >> 4); }
__device__ inline float2 times(float2 a, float2 b)
{
    return make_float2(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}
__device__ inline float2 plus(float2 a, float2 b) { return make_float2(a.x + b.x, a.y + b.y); }
__device__ inline float2 minus(float2 a, float2 b) { return make_float2(a.x - b.x, a.y - b.y); }
__device__ inline float2 turned(float2 a) { return make_float2(a.y, -a.x); } // times -i

// --- transforms: Stockham, radices 16, 16 and BINS / 256, in registers between exchanges

__device__ inline void dft4(float2& a, float2& b, float2& c, float2& d)
{
    const float2 p = plus(a, c), q = minus(a, c), r = plus(b, d), s = turned(minus(b, d));
    a = plus(p, r);
    b = plus(q, s);
    c = minus(p, r);
    d = minus(q, s);
}

// exp(-2πi m / 16) for the products of the radices' inner factors
__device__ inline float2 sixteenth(int m)
{
    constexpr float one = 0.92387953251128674f, two = 0.70710678118654752f,
                    three = 0.38268343236508977f;
    switch (m) {
    case 1:
        return make_float2(one, -three);
    case 2:
        return make_float2(two, -two);
    case 3:
        return make_float2(three, -one);
    case 4:
        return make_float2(0.0f, -1.0f);
    case 6:
        return make_float2(-two, -two);
    case 9:
        return make_float2(-one, three);
    default:
        return make_float2(1.0f, 0.0f);
    }
}

// Radix-point transform of u[0 … radix-1], in natural order.
template <int radix> __device__ inline void dft(float2* u)
{
    if constexpr (radix == 2) {
        const float2 a = u[0];
        u[0] = plus(a, u[1]);
        u[1] = minus(a, u[1]);
    } else if constexpr (radix == 4) {
        dft4(u[0], u[1], u[2], u[3]);
    } else if constexpr (radix == 8) {
        float2 a[8];
#pragma unroll
        for (int n = 0; n < 4; n++) {
            a[n] = plus(u[n], u[n + 4]);
            a[n + 4] = times(minus(u[n], u[n + 4]), sixteenth(2 * n));
        }
        dft4(a[0], a[1], a[2], a[3]);
        dft4(a[4], a[5], a[6], a[7]);
#pragma unroll
        for (int k = 0; k < 4; k++) {
            u[2 * k] = a[k];
            u[2 * k + 1] = a[4 + k];
        }
    } else {
        float2 a[16];
#pragma unroll
        for (int n = 0; n < 4; n++) {
            dft4(u[n], u[n + 4], u[n + 8], u[n + 12]);
#pragma unroll
            for (int k = 0; k < 4; k++)
                a[4 * k + n] = times(u[n + 4 * k], sixteenth(n * k));
        }
#pragma unroll
        for (int k = 0; k < 4; k++)
            dft4(a[4 * k], a[4 * k + 1], a[4 * k + 2], a[4 * k + 3]);
#pragma unroll
        for (int k = 0; k < 16; k++)
            u[k] = a[4 * (k % 4) + k / 4];
    }
}

// One pass on v[e], the bins t + team * e, whose parts of `done` bins are transformed already.
template <int radix, int done> __device__ inline void pass(float2* v, int t, const float2* twiddles)
{
    constexpr int n = each / radix;
#pragma unroll
    for (int q = 0; q < n; q++) {
        float2 u[radix];
#pragma unroll
        for (int r = 0; r < radix; r++)
            u[r] = v[q + r * n];
        if constexpr (done > 1) {
            float2 power[radix];
            power[0] = make_float2(1.0f, 0.0f);
            power[1] = twiddles[((t + q * team) % done) * (BINS / (done * radix))];
#pragma unroll
            for (int r = 2; r < radix; r++)
                power[r] = times(power[r / 2], power[r - r / 2]);
#pragma unroll
            for (int r = 1; r < radix; r++)
                u[r] = times(u[r], power[r]);
        }
        dft<radix>(u);
#pragma unroll
        for (int r = 0; r < radix; r++)
            v[q + r * n] = u[r];
    }
}

// v[e], samples t + team * e of one block, into bins t + team * e; `mine` is this transform's row
// of shared memory.
__device__ inline void transform(float2* v, int t, float2* mine, const float2* twiddles)
{
    pass<16, 1>(v, t, twiddles);
#pragma unroll
    for (int r = 0; r < 16; r++)
        mine[place(16 * t + r)] = v[r];
    __syncthreads();
#pragma unroll
    for (int e = 0; e < each; e++)
        v[e] = mine[place(t + team * e)];
    __syncthreads();
    pass<16, 16>(v, t, twiddles);
#pragma unroll
    for (int r = 0; r < 16; r++)
        mine[place((t / 16) * 256 + t % 16 + 16 * r)] = v[r];
    __syncthreads();
#pragma unroll
    for (int e = 0; e < each; e++)
        v[e] = mine[place(t + team * e)];
    pass<BINS / 256, 256>(v, t, twiddles);
}

// --- how spectra are stored

// Element `at` of an array of filters: as it is.
__device__ inline void store(float2 z, i64 at, void* high, void* low)
{
#if STORED == 0
    static_cast<float2*>(high)[at] = z;
#else
    const unsigned re = half_of(z.x), im = half_of(z.y);
    static_cast<unsigned*>(high)[at] = re | im << 16;
#if STORED == 2
    static_cast<unsigned*>(low)[at] = half_of(z.x - float_of(re)) | half_of(z.y - float_of(im))
                                                                        << 16;
#endif
#endif
}

// Block b of a node's bin; as halves twice, as real matrices need it: (re, im), and a row further
// (-im, re).
__device__ inline void store_sent(float2 z, i64 bin, int node, int n_nodes, int b, int n_blocks,
                                  void* high, void* low)
{
#if STORED == 0
    store(z, (bin * n_nodes + node) * n_blocks + b, high, low);
#else
    const i64 at = (bin * n_nodes + node) * 2 * n_blocks + b;
    store(z, at, high, low);
    store(make_float2(-z.y, z.x), at + n_blocks, high, low);
#endif
}

// --- samples in

#if INT16_IN
typedef short2 sample_in;
#else
typedef float2 sample_in;
#endif

struct inputs {
    const sample_in* before; // the last PAST of each row's n_before
    const sample_in* now;
    i64 before_stride, now_stride;
    int n_before, n;
    float gain, levels; // full scale to 1; steps of it that floats are rounded to, or 0
};

// Sample `at` of a node, counted from PAST samples before the chunk; zero behind it.
__device__ inline float2 fetch(const inputs& x, int node, int at)
{
    sample_in s;
    if (at < PAST)
        s = x.before[node * x.before_stride + x.n_before - PAST + at];
    else if (at - PAST < x.n)
        s = x.now[node * x.now_stride + at - PAST];
    else
        return make_float2(0.0f, 0.0f);
    float re = s.x * x.gain, im = s.y * x.gain;
#if !INT16_IN
    if (x.levels > 0) {
        re = held(rintf(re * x.levels), -x.levels, x.levels - 1) / x.levels;
        im = held(rintf(im * x.levels), -x.levels, x.levels - 1) / x.levels;
    }
#endif
    return make_float2(re, im);
}

// --- samples out

struct outputs {
    void* out;
    float2* partial; // of the layers so far
    i64 stride;
    int is_first, is_last;
    float gain, levels, scale; // behind the links; steps of full scale, or 0; full scale
    const float* noise;        // amplitude per receiver, or nullptr
    unsigned seed_low, seed_high;
    u64 first_sample;
    u64* clipped;
};

// Unit noise of a receiver's sample: Philox4x32-10, Box-Muller; reference.receiver_noise in single
// precision.
__device__ inline float2 noise_of(unsigned seed_low, unsigned seed_high, unsigned receiver,
                                  u64 number)
{
    const u64 pair = number / 2;
    unsigned c0 = (unsigned)pair, c1 = (unsigned)(pair >> 32), c2 = receiver, c3 = 0, k0 = seed_low,
             k1 = seed_high;
#pragma unroll
    for (int k = 0; k < 10; k++) {
        const u64 a = (u64)0xD2511F53u * c0, b = (u64)0xCD9E8D57u * c2;
        c0 = (unsigned)(b >> 32) ^ c1 ^ k0;
        c1 = (unsigned)b;
        c2 = (unsigned)(a >> 32) ^ c3 ^ k1;
        c3 = (unsigned)a;
        k0 += 0x9E3779B9u;
        k1 += 0xBB67AE85u;
    }
    const unsigned word = number % 2 ? c2 : c0, turn = number % 2 ? c3 : c1;
    const float radius = sqrtf(-logf(((word >> 8) + 0.5f) / 16777216.0f));
    float s, c;
    sincospif((int)turn * (1.0f / 2147483648.0f), &s, &c); // turns of 2^32, signed: ±1 is ±π
    return make_float2(radius * c, radius * s);
}

// What the links made of sample n of the chunk, on its way out.
__device__ inline void finish(float2 y, float weight, int receiver, int n, const outputs& to)
{
    y.x *= weight;
    y.y *= weight;
    const i64 at = receiver * to.stride + n;
    if (!to.is_first)
        y = plus(y, to.partial[at]);
    if (!to.is_last) {
        to.partial[at] = y;
        return;
    }
    if (to.noise && to.noise[receiver] > 0) {
        const float2 w = noise_of(to.seed_low, to.seed_high, receiver, to.first_sample + n);
        y.x += to.noise[receiver] * w.x;
        y.y += to.noise[receiver] * w.y;
    }
    if (to.levels > 0) {
        const float per_unit = to.levels / to.scale, low = -to.levels, high = to.levels - 1;
        const float re = rintf(y.x * per_unit), im = rintf(y.y * per_unit);
        if (!(re >= low) || re > high || !(im >= low) || im > high)
            atomicAdd(to.clipped, (u64)1);
        y.x = held(re, low, high);
        y.y = held(im, low, high);
#if !INT16_OUT
        y.x *= to.scale / to.levels;
        y.y *= to.scale / to.levels;
#endif
    }
#if INT16_OUT
    static_cast<short2*>(to.out)[at] = make_short2((short)y.x, (short)y.y);
#else
    static_cast<float2*>(to.out)[at] = y;
#endif
}

// --- the steps. Segments are rows (begin, end, weight, slope).

// What makes the loudest link of each receiver 4096 or a little less: scale[segment][receiver]; one
// thread block each.
extern "C" __global__ void scales(const float2* gains, int n_links, int n_taps, float* scale)
{
    SHARED_MEMORY(shared);
    float* largest = reinterpret_cast<float*>(shared);
    const int t = threadIdx.x, receiver = blockIdx.x;
    const float2* mine = gains + (i64)receiver * n_links * n_taps;
    float most = 0;
    for (int link = t; link < n_links; link += blockDim.x) {
        float sum = 0;
        for (int p = 0; p < n_taps; p++) {
            const float2 g = mine[(i64)link * n_taps + p];
            sum += sqrtf(g.x * g.x + g.y * g.y);
        }
        most = fmaxf(most, sum);
    }
    largest[t] = most;
    for (int half = blockDim.x / 2; half > 0; half /= 2) {
        __syncthreads();
        if (t < half)
            largest[t] = fmaxf(largest[t], largest[t + half]);
    }
    if (t == 0) {
        int power = 0;
        if (largest[0] > 0 && frexpf(largest[0], &power) == 0.5f)
            power--;
        scale[receiver] = ldexpf(1.0f, (power > 100 ? 100 : power < -100 ? -100 : power) - 12);
    }
}

// Spectra of links with few taps: phasors that turn from bin to bin. Thread: one link,
// bins_per_thread bins.
extern "C" __global__ void sparse_filters(const delay_type* delays, const float2* gains,
                                          const float* scale, int n_inputs, int n_links, int n_taps,
                                          const float2* twiddles, void* high, void* low)
{
    const int link = blockIdx.x * blockDim.x + threadIdx.x, first = blockIdx.y * bins_per_thread,
              segment = blockIdx.z;
    if (link >= n_links)
        return;
    const i64 taps = ((i64)segment * n_links + link) * n_taps;
    const float inverse = 1.0f / scale[segment * (n_links / n_inputs) + link / n_inputs];
    float2 sum[bins_per_thread];
#pragma unroll
    for (int k = 0; k < bins_per_thread; k++)
        sum[k] = make_float2(0.0f, 0.0f);
    for (int p = 0; p < n_taps; p++) {
        const float2 gain = gains[taps + p];
        if (gain.x == 0 && gain.y == 0)
            continue;
        const int delay = delays[taps + p];
        const float2 turn = twiddles[delay & (BINS - 1)];
        float2 phasor = times(make_float2(gain.x * inverse, gain.y * inverse),
                              twiddles[(delay * first) & (BINS - 1)]);
#pragma unroll
        for (int k = 0; k < bins_per_thread; k++) {
            sum[k] = plus(sum[k], phasor);
            phasor = times(phasor, turn);
        }
    }
#pragma unroll
    for (int k = 0; k < bins_per_thread; k++)
        store(sum[k], ((i64)segment * BINS + first + k) * n_links + link, high, low);
}

// The same of links with many taps: TILE transforms per thread block.
extern "C" __global__ void __launch_bounds__(threads, blocks_at_once)
    dense_filters(const delay_type* delays, const float2* gains, const float* scale, int n_inputs,
                  int n_links, int n_taps, const float2* twiddles, void* high, void* low)
{
    SHARED_MEMORY(shared);
    const int t = threadIdx.x % team, s = threadIdx.x / team, segment = blockIdx.y;
    const int link = blockIdx.x * TILE + s;
    float2* mine = shared + s * row;
    for (int e = 0; e < each; e++)
        mine[place(t + team * e)] = make_float2(0.0f, 0.0f);
    __syncthreads();
    if (link < n_links) {
        const i64 taps = ((i64)segment * n_links + link) * n_taps;
        const float inverse = 1.0f / scale[segment * (n_links / n_inputs) + link / n_inputs];
        for (int p = t; p < n_taps; p += team) {
            const float2 gain = gains[taps + p];
            if (gain.x != 0 || gain.y != 0) { // two taps may have one delay
                float2& sum = mine[place(delays[taps + p])];
                atomicAdd(&sum.x, gain.x * inverse);
                atomicAdd(&sum.y, gain.y * inverse);
            }
        }
    }
    __syncthreads();
    float2 v[each];
#pragma unroll
    for (int e = 0; e < each; e++)
        v[e] = mine[place(t + team * e)];
    __syncthreads();
    transform(v, t, mine, twiddles);
    __syncthreads();
#pragma unroll
    for (int e = 0; e < each; e++)
        mine[place(t + team * e)] = v[e];
    __syncthreads();
    for (int m = threadIdx.x; m < TILE * BINS; m += threads) {
        const int one = m % TILE, k = m / TILE;
        if (blockIdx.x * TILE + one < n_links)
            store(shared[one * row + place(k)],
                  ((i64)segment * BINS + k) * n_links + blockIdx.x * TILE + one, high, low);
    }
}

// Spectra of TILE blocks of one transmitter in one segment.
extern "C" __global__ void __launch_bounds__(threads, blocks_at_once)
    forward(const sample_in* before, i64 before_stride, int n_before, const sample_in* now,
            i64 now_stride, int n, float gain, float levels, int n_inputs, const double* segments,
            int n_blocks, const float2* twiddles, void* high, void* low)
{
    SHARED_MEMORY(shared);
    const inputs x = {before, now, before_stride, now_stride, n_before, n, gain, levels};
    const int t = threadIdx.x % team, s = threadIdx.x / team, block = blockIdx.x * TILE,
              node = blockIdx.y, segment = blockIdx.z;
    const int begin = (int)segments[4 * segment], end = (int)segments[4 * segment + 1];
    if (begin + block * step >= end)
        return; // room that this segment does not need
    const int first = begin + (block + s) * step;
    float2* mine = shared + s * row;
    float2 v[each];
#pragma unroll
    for (int e = 0; e < each; e++)
        v[e] = fetch(x, node, first + t + team * e);
    transform(v, t, mine, twiddles);
    __syncthreads();
#pragma unroll
    for (int e = 0; e < each; e++)
        mine[place(t + team * e)] = v[e];
    __syncthreads();
#pragma unroll 4
    for (int m = threadIdx.x; m < TILE * BINS; m += threads) {
        const int one = m % TILE, k = m / TILE;
        store_sent(shared[one * row + place(k)], (i64)segment * BINS + k, node, n_inputs,
                   block + one, n_blocks, high, low);
    }
}

// Samples of TILE blocks of one receiver in one segment.
extern "C" __global__ void __launch_bounds__(threads, blocks_at_once)
    inverse(const float2* product, const float* row_scale, const double* segments, int n_blocks,
            int n_outputs, const float2* twiddles, void* out, float2* partial, i64 stride,
            int is_first, int is_last, float gain, float levels, float scale, const float* noise,
            unsigned seed_low, unsigned seed_high, u64 first_sample, u64* clipped)
{
    SHARED_MEMORY(shared);
    const outputs to = {out,   partial, stride,   is_first,  is_last,      gain,   levels,
                        scale, noise,   seed_low, seed_high, first_sample, clipped};
    const int t = threadIdx.x % team, s = threadIdx.x / team, block = blockIdx.x * TILE,
              receiver = blockIdx.y, segment = blockIdx.z;
    const int begin = (int)segments[4 * segment], end = (int)segments[4 * segment + 1];
    const float weight = (float)segments[4 * segment + 2], slope = (float)segments[4 * segment + 3];
    if (begin + block * step >= end)
        return;
#pragma unroll 8
    for (int m = threadIdx.x; m < TILE * BINS; m += threads) {
        const int one = m % TILE, k = m / TILE;
        const float2 z =
            product[(((i64)segment * BINS + k) * n_outputs + receiver) * n_blocks + block + one];
        shared[one * row + place(k)] = make_float2(z.x, -z.y);
    }
    __syncthreads();
    float2* mine = shared + s * row;
    float2 v[each];
#pragma unroll
    for (int e = 0; e < each; e++)
        v[e] = mine[place(t + team * e)];
    __syncthreads();
    transform(v, t, mine, twiddles);
    const float back = gain * row_scale[segment * n_outputs + receiver] / BINS;
    const int first = begin + (block + s) * step - PAST;
#pragma unroll
    for (int e = 0; e < each; e++) {
        const int at = t + team * e, n = first + at;
        if (at >= PAST && n < end)
            finish(make_float2(v[e].x * back, -v[e].y * back), weight + slope * (n - begin),
                   receiver, n, to);
    }
}

// The network by its definition. Thread: samples_each samples of one receiver; paths pass through
// shared memory.
constexpr int wide = 256, samples_each = 4;
extern "C" __global__ void __launch_bounds__(wide)
    direct(const sample_in* before, i64 before_stride, int n_before, const sample_in* now,
           i64 now_stride, int n, float gain_in, float levels_in, const delay_type* delays,
           const float2* gains, int n_inputs, int n_taps, const double* segments, int n_outputs,
           void* out, float2* partial, i64 stride, int is_first, int is_last, float gain,
           float levels, float scale, const float* noise, unsigned seed_low, unsigned seed_high,
           u64 first_sample, u64* clipped)
{
    SHARED_MEMORY(shared);
    float2* path_gain = shared;
    int* path_from = reinterpret_cast<int*>(shared + wide); // delay and transmitter
    const inputs x = {before, now, before_stride, now_stride, n_before, n, gain_in, levels_in};
    const outputs to = {out,   partial, stride,   is_first,  is_last,      gain,   levels,
                        scale, noise,   seed_low, seed_high, first_sample, clipped};
    const int receiver = blockIdx.y, segment = blockIdx.z;
    const int begin = (int)segments[4 * segment], end = (int)segments[4 * segment + 1];
    const float weight = (float)segments[4 * segment + 2], slope = (float)segments[4 * segment + 3];
    const int first = begin + blockIdx.x * wide * samples_each;
    if (first >= end)
        return;
    const int n_paths = n_inputs * n_taps;
    const i64 paths = ((i64)segment * n_outputs + receiver) * n_paths;
    float2 sum[samples_each];
#pragma unroll
    for (int q = 0; q < samples_each; q++)
        sum[q] = make_float2(0.0f, 0.0f);
    for (int from = 0; from < n_paths; from += wide) {
        const int taken = n_paths - from < wide ? n_paths - from : wide;
        __syncthreads();
        if ((int)threadIdx.x < taken) {
            const int p = from + threadIdx.x;
            path_gain[threadIdx.x] = gains[paths + p];
            path_from[2 * threadIdx.x] = delays[paths + p];
            path_from[2 * threadIdx.x + 1] = p / n_taps;
        }
        __syncthreads();
        for (int p = 0; p < taken; p++) {
            const float2 g = path_gain[p];
            if (g.x == 0 && g.y == 0)
                continue;
            const int at = first + PAST - path_from[2 * p] + threadIdx.x,
                      node = path_from[2 * p + 1];
#pragma unroll
            for (int q = 0; q < samples_each; q++)
                sum[q] = plus(sum[q], times(g, fetch(x, node, at + q * wide)));
        }
    }
#pragma unroll
    for (int q = 0; q < samples_each; q++) {
        const int at = first + q * wide + threadIdx.x;
        if (at < end)
            finish(make_float2(sum[q].x * gain, sum[q].y * gain), weight + slope * (at - begin),
                   receiver, at, to);
    }
}
