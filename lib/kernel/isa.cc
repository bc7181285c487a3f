// SPDX-License-Identifier: GPL-3.0-or-later
#include "isa.h"

#include <stdexcept>

namespace gr
{
namespace cast
{
namespace kernel
{

isa best_isa()
{
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx512f"))
        return isa::avx512;
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
        return isa::avx2;
#endif
    return isa::generic;
}

isa isa_from_name(const std::string& name)
{
    if (name == "auto")
        return best_isa();
    for (isa set : {isa::generic, isa::avx2, isa::avx512}) {
        if (name != isa_name(set))
            continue;
        if (set > best_isa())
            throw std::invalid_argument("instruction set: got '" + name +
                                        "', this processor has none better than '" +
                                        isa_name(best_isa()) + "'");
        return set;
    }
    throw std::invalid_argument("instruction set: got '" + name +
                                "', expected auto, generic, avx2 or avx512");
}

const char* isa_name(isa set)
{
    switch (set) {
    case isa::avx2:
        return "avx2";
    case isa::avx512:
        return "avx512";
    default:
        return "generic";
    }
}

} // namespace kernel
} // namespace cast
} // namespace gr
