// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "vec.h"
#include <cstddef>
#include <cstdint>

namespace gr
{
namespace cast
{
namespace tracing
{

// An upright cylinder over its foot.
struct body {
    double radius_m, height_m;
};

// Whether a leg of a path goes through the body. Feet are `places` x `rows`, paths of `points`
// points `rows` x `paths`, `out` is `places` x `rows` x `paths`.
void shaded(const body& one, const vec* foot_m, size_t places, size_t rows, const vec* points_m,
            size_t paths, size_t points, uint8_t* out);

} // namespace tracing
} // namespace cast
} // namespace gr
