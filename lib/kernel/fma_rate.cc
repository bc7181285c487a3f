// SPDX-License-Identifier: GPL-3.0-or-later
#include "fma_rate.h"
#include "vector_kernels.h"
#include <algorithm>
#include <chrono>

namespace gr
{
namespace cast
{
namespace kernel
{

double fma_rate(const std::string& isa_name)
{
    const isa set = isa_from_name(isa_name);
    double best = 0;
    for (int repeat = 0; repeat < 8; repeat++) {
        const auto begin = std::chrono::steady_clock::now();
        const double made = turn_multiply_adds(set, 2'000'000);
        const std::chrono::duration<double> took = std::chrono::steady_clock::now() - begin;
        best = std::max(best, made / took.count());
    }
    return best;
}

} // namespace kernel
} // namespace cast
} // namespace gr
