// SPDX-License-Identifier: GPL-3.0-or-later
#include "body.h"
#include <algorithm>

namespace gr
{
namespace cast
{
namespace tracing
{

namespace
{

bool goes_through(const body& one, const vec& from, const vec& to)
{
    const vec step = to - from;
    const double flat = step.x * step.x + step.y * step.y;
    if (flat <= 0)
        return false;
    const double middle = std::clamp(-(from.x * step.x + from.y * step.y) / flat, 0.0, 1.0);
    const double x = from.x + middle * step.x, y = from.y + middle * step.y;
    const double depth = one.radius_m * one.radius_m - (x * x + y * y);
    if (depth <= 0)
        return false;
    const double half = std::sqrt(depth / flat);
    const double low_m = from.z + std::max(middle - half, 0.0) * step.z,
                 high_m = from.z + std::min(middle + half, 1.0) * step.z;
    return std::min(low_m, high_m) < one.height_m && std::max(low_m, high_m) > 0;
}

} // namespace

void shaded(const body& one, const vec* foot_m, size_t places, size_t rows, const vec* points_m,
            size_t paths, size_t points, uint8_t* out)
{
    for (size_t place = 0; place < places; place++)
        for (size_t row = 0; row < rows; row++) {
            const vec foot = foot_m[place * rows + row];
            for (size_t path = 0; path < paths; path++) {
                const vec* way = points_m + (row * paths + path) * points;
                bool hit = false;
                for (size_t leg = 0; leg + 1 < points && !hit; leg++)
                    hit = goes_through(one, way[leg] - foot, way[leg + 1] - foot);
                *out++ = hit;
            }
        }
}

} // namespace tracing
} // namespace cast
} // namespace gr
