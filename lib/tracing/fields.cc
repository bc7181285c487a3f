// SPDX-License-Identifier: GPL-3.0-or-later
#include "fields.h"
#include <algorithm>

namespace gr
{
namespace cast
{
namespace tracing
{

namespace
{

constexpr double SPEED_OF_LIGHT_M_PER_S = 299792458.0;
constexpr double PI = 3.14159265358979323846;
constexpr double TINY = 1e-12;
constexpr size_t LANES = 4; // phasors that go on at the same time

complex turn(double turns)
{
    const double angle = -2 * PI * turns;
    return {std::cos(angle), std::sin(angle)};
}

double degrees(double rad) { return rad * (180 / PI); }

double amplitude(pattern shape, double cos_theta, double sin_theta, double phi)
{
    switch (shape) {
    case pattern::iso:
        return 1;
    case pattern::dipole:
        return std::sqrt(1.5) * sin_theta;
    case pattern::hw_dipole:
        return sin_theta > 1e-6 ? std::sqrt(1.643) * std::cos(PI / 2 * cos_theta) / sin_theta : 0;
    case pattern::tr38901:
        break;
    }
    const double down = (degrees(std::atan2(sin_theta, cos_theta)) - 90) / 65,
                 aside = degrees(phi) / 65;
    const double down_db = std::min(12 * down * down, 30.0),
                 aside_db = std::min(12 * aside * aside, 30.0);
    return std::pow(10, (8 - std::min(down_db + aside_db, 30.0)) / 20);
}

// Reflection and transmission of a slab in air (P.2040-3, equations 37 to 44).
struct slab {
    complex r_te, r_tm, t_te, t_tm;

    slab(const complex& permittivity, double thickness_m, double cos_in, double wavelength_m)
    {
        const complex root = std::sqrt(permittivity - (1 - cos_in * cos_in));
        const complex te = (cos_in - root) / (cos_in + root);
        const complex tm = (permittivity * cos_in - root) / (permittivity * cos_in + root);
        // Nothing comes back from the far side of endless ground.
        const complex once =
            std::isinf(thickness_m)
                ? 0
                : std::exp(complex(0, -2 * PI) * (thickness_m / wavelength_m) * root);
        const complex twice = once * once, te_2 = te * te, tm_2 = tm * tm;
        const complex from_te = 1.0 / (1.0 - te_2 * twice), from_tm = 1.0 / (1.0 - tm_2 * twice);
        r_te = te * (1.0 - twice) * from_te;
        r_tm = tm * (1.0 - twice) * from_tm;
        t_te = (1.0 - te_2) * once * from_te;
        t_tm = (1.0 - tm_2) * once * from_tm;
    }
};

// Unit vector across the plane of incidence; any one where a ray falls straight.
vec across_of(const vec& incoming, const vec& normal)
{
    const vec across = cross(incoming, normal);
    const double size = norm(across);
    if (size > 1e-9)
        return 1 / size * across;
    const vec other = cross(incoming, std::abs(incoming.x) < 0.9 ? vec{1, 0, 0} : vec{0, 1, 0});
    return 1 / norm(other) * other;
}

double cosine(const vec& incoming, const vec& normal)
{
    return std::clamp(std::abs(dot(incoming, normal)), 1e-9, 1.0);
}

} // namespace

vec far_field(pattern shape, const vec rotation[3], const vec& direction)
{
    const auto along = [&](int axis) {
        const double vec::*part = axis == 0 ? &vec::x : axis == 1 ? &vec::y : &vec::z;
        return direction.x * rotation[0].*part + direction.y * rotation[1].*part +
               direction.z * rotation[2].*part;
    };
    const vec own = {along(0), along(1), along(2)};
    const double sin_theta = std::hypot(own.x, own.y), cos_theta = std::clamp(own.z, -1.0, 1.0);
    const bool is_aside = sin_theta > TINY;
    const double cos_phi = is_aside ? own.x / sin_theta : 1,
                 sin_phi = is_aside ? own.y / sin_theta : 0;
    const double strength = amplitude(shape, cos_theta, sin_theta, std::atan2(sin_phi, cos_phi));
    const vec theta = {strength * cos_theta * cos_phi, strength * cos_theta * sin_phi,
                       -strength * sin_theta};
    return {dot(theta, rotation[0]), dot(theta, rotation[1]), dot(theta, rotation[2])};
}

void gains(const way& paths, const vec* normal, const int64_t* owner, const surface& made_of,
           double wavelength_m, complex* out)
{
    size_t crossing = 0;
    for (size_t path = 0; path < paths.count; path++) {
        const vec* direction = paths.direction + path * (paths.depth + 1);
        const int64_t* met = paths.faces + path * paths.depth;
        const vec& start = paths.start[path];
        vec3<complex> field = {start.x, start.y, start.z};
        for (unsigned leg = 0; leg <= paths.depth; leg++) {
            const vec& incoming = direction[leg];
            for (; crossing < paths.crossings && paths.crossing_path[crossing] == int64_t(path) &&
                   paths.crossing_leg[crossing] == leg;
                 crossing++) {
                const int64_t face = paths.crossing_face[crossing], object = owner[face];
                if (!made_of.present[object])
                    continue;
                const slab through(made_of.permittivity[object], made_of.thickness_m[object],
                                   cosine(incoming, normal[face]), wavelength_m);
                const vec across = across_of(incoming, normal[face]),
                          along = cross(across, incoming);
                field = (through.t_te * dot(field, across)) * across +
                        (through.t_tm * dot(field, along)) * along;
            }
            if (leg == paths.depth || met[leg] < 0)
                continue;
            const int64_t face = met[leg], object = owner[face];
            const double cos_in = cosine(incoming, normal[face]);
            const slab back(made_of.permittivity[object], made_of.thickness_m[object], cos_in,
                            wavelength_m);
            const double wave =
                PI * made_of.height_rms_m[object] * cos_in / wavelength_m; // Ament 1953
            const double scattered = made_of.scattering[object];
            const double left = std::exp(-8 * wave * wave) * std::sqrt(1 - scattered * scattered);
            const vec across = across_of(incoming, normal[face]);
            const vec before = cross(across, incoming), after = cross(across, direction[leg + 1]);
            field = (left * back.r_te * dot(field, across)) * across +
                    (left * back.r_tm * dot(field, before)) * after;
        }
        out[path] = wavelength_m / (4 * PI * paths.length_m[path]) * dot(field, paths.end[path]);
    }
}

void summed(size_t count, const int64_t* instant, const complex* gain, const double* length_m,
            double begin_hz, double step_hz, size_t steps, complex* out)
{
    for (size_t path = 0; path < count; path++) {
        if (gain[path] == 0.0)
            continue;
        const double delay_s = length_m[path] / SPEED_OF_LIGHT_M_PER_S;
        const complex once = turn(std::fmod(step_hz * delay_s, 1.0));
        double re[LANES], im[LANES];
        complex now = gain[path] * turn(std::fmod(begin_hz * delay_s, 1.0)), ahead = 1;
        for (size_t lane = 0; lane < LANES; lane++) {
            re[lane] = now.real();
            im[lane] = now.imag();
            now *= once;
            ahead *= once;
        }
        const double c = ahead.real(), s = ahead.imag();
        double* row = reinterpret_cast<double*>(out + instant[path] * steps);
        for (size_t k = 0; k < steps; k += LANES) {
            const size_t lanes = std::min(LANES, steps - k);
            for (size_t lane = 0; lane < lanes; lane++) {
                row[2 * (k + lane)] += re[lane];
                row[2 * (k + lane) + 1] += im[lane];
            }
            for (size_t lane = 0; lane < LANES; lane++) {
                const double turned = re[lane] * c - im[lane] * s;
                im[lane] = re[lane] * s + im[lane] * c;
                re[lane] = turned;
            }
        }
    }
}

} // namespace tracing
} // namespace cast
} // namespace gr
