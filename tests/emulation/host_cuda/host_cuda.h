// SPDX-License-Identifier: GPL-3.0-or-later
// As much of CUDA as kernels.cu needs, on the processor: threads of a block are fibers that meet in
// __syncthreads().
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <tuple>
#include <ucontext.h>
#include <utility>
#include <vector>

#define __device__
#define __global__
#define __launch_bounds__(...)

struct float2 {
    float x, y;
};
struct short2 {
    short x, y;
};
struct dim3 {
    unsigned x, y, z;
};
inline float2 make_float2(float x, float y) { return {x, y}; }
inline short2 make_short2(short x, short y) { return {x, y}; }
inline void sincospif(float x, float* s, float* c)
{
    *s = float(std::sin(M_PI * x));
    *c = float(std::cos(M_PI * x));
}
inline unsigned half_of(float x)
{
    const _Float16 h = static_cast<_Float16>(x);
    uint16_t bits;
    std::memcpy(&bits, &h, 2);
    return bits;
}
inline float float_of(unsigned bits)
{
    const uint16_t low = static_cast<uint16_t>(bits);
    _Float16 h;
    std::memcpy(&h, &low, 2);
    return static_cast<float>(h);
}
template <class T> inline void atomicAdd(T* to, T value) { *to += value; }

static dim3 threadIdx, blockIdx, blockDim;
static std::vector<float2> host_shared;
#define SHARED_MEMORY(name) float2* name = host_shared.data()

namespace host
{
static ucontext_t scheduler, *running;
static void (*body)(void*);
static void* body_arguments;

inline void begin_fiber()
{
    body(body_arguments);
    running = nullptr; // done
}

inline void run_block(std::size_t n_shared_bytes)
{
    constexpr std::size_t stack = 1 << 16;
    static std::vector<char> stacks;
    const unsigned n = blockDim.x;
    stacks.resize(n * stack);
    const float nan = std::numeric_limits<float>::quiet_NaN(); // what nobody wrote shows
    host_shared.assign(n_shared_bytes / sizeof(float2) + 1, float2{nan, nan});
    std::vector<ucontext_t> fibers(n);
    std::vector<char> alive(n, 1);
    for (unsigned t = 0; t < n; t++) {
        getcontext(&fibers[t]);
        fibers[t].uc_stack.ss_sp = stacks.data() + t * stack;
        fibers[t].uc_stack.ss_size = stack;
        fibers[t].uc_link = &scheduler;
        makecontext(&fibers[t], begin_fiber, 0);
    }
    for (unsigned left = n; left > 0;)
        for (unsigned t = 0; t < n; t++) {
            if (!alive[t])
                continue;
            threadIdx = {t, 0, 0};
            running = &fibers[t];
            swapcontext(&scheduler, &fibers[t]);
            if (!running) {
                alive[t] = 0;
                left--;
            }
        }
}

template <class... A, std::size_t... I>
void launch(void (*kernel)(A...), const unsigned* grid, unsigned block, std::size_t shared,
            void** arguments, std::index_sequence<I...>)
{
    std::tuple<void (*)(A...), A...> call(kernel, *static_cast<A*>(arguments[I])...);
    using call_type = decltype(call);
    body_arguments = &call;
    body = [](void* raw) {
        auto& made = *static_cast<call_type*>(raw);
        std::get<0>(made)(std::get<I + 1>(made)...);
    };
    blockDim = {block, 1, 1};
    for (unsigned z = 0; z < grid[2]; z++)
        for (unsigned y = 0; y < grid[1]; y++)
            for (unsigned x = 0; x < grid[0]; x++) {
                blockIdx = {x, y, z};
                run_block(shared);
            }
}

template <class... A>
void launch(void (*kernel)(A...), const unsigned* grid, unsigned block, std::size_t shared,
            void** arguments)
{
    launch(kernel, grid, block, shared, arguments, std::index_sequence_for<A...>{});
}
} // namespace host

inline void __syncthreads()
{
    const dim3 me = threadIdx;
    swapcontext(host::running, &host::scheduler);
    threadIdx = me;
}
