// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cmath>

namespace gr
{
namespace cast
{
namespace tracing
{

// A point or a direction in space; `T` is double, or complex for fields.
template <typename T> struct vec3 {
    T x, y, z;
};
using vec = vec3<double>;

template <typename A, typename B>
auto operator+(const vec3<A>& a, const vec3<B>& b) -> vec3<decltype(a.x + b.x)>
{
    return {a.x + b.x, a.y + b.y, a.z + b.z};
}

template <typename A, typename B>
auto operator-(const vec3<A>& a, const vec3<B>& b) -> vec3<decltype(a.x - b.x)>
{
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}

template <typename S, typename B>
auto operator*(const S& s, const vec3<B>& b) -> vec3<decltype(s * b.x)>
{
    return {s * b.x, s * b.y, s * b.z};
}

template <typename A, typename B>
auto dot(const vec3<A>& a, const vec3<B>& b) -> decltype(a.x * b.x)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

inline vec cross(const vec& a, const vec& b)
{
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

inline double norm(const vec& a) { return std::sqrt(dot(a, a)); }

} // namespace tracing
} // namespace cast
} // namespace gr
