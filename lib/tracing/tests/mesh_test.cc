// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/tests/check.h"
#include "tracing/body.h"
#include "tracing/fields.h"
#include "tracing/mesh.h"
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

using namespace gr::cast::tracing;

namespace
{

const vec SIZE_M = {7, 5, 3}, TX_M = {1.3, 2.1, 1.7}, RX_M = {5.2, 3.9, 0.6};

// An empty room: six faces of two triangles each, seen from both sides.
mesh room()
{
    std::vector<vec> normal, corners;
    std::vector<double> level;
    std::vector<int64_t> start{0};
    const auto at = [](int axis, double along, double u, double v) {
        std::array<double, 3> p{};
        p[axis] = along;
        p[(axis + 1) % 3] = u;
        p[(axis + 2) % 3] = v;
        return vec{p[0], p[1], p[2]};
    };
    const std::array<double, 3> size{SIZE_M.x, SIZE_M.y, SIZE_M.z};
    for (int axis = 0; axis < 3; axis++)
        for (double side : {0.0, size[axis]}) {
            const double u = size[(axis + 1) % 3], v = size[(axis + 2) % 3];
            normal.push_back(at(axis, 1, 0, 0));
            level.push_back(side);
            for (const auto& corner :
                 {at(axis, side, 0, 0), at(axis, side, u, 0), at(axis, side, u, v)})
                corners.push_back(corner);
            for (const auto& corner :
                 {at(axis, side, 0, 0), at(axis, side, u, v), at(axis, side, 0, v)})
                corners.push_back(corner);
            start.push_back(start.back() + 2);
        }
    return mesh(normal, level, std::vector<uint8_t>(6, 0), start, corners);
}

double length_m(const mesh& faces, const int64_t* met, unsigned depth)
{
    std::vector<vec> points(depth + 2);
    faces.unfold(met, depth, TX_M, RX_M, points.data());
    double sum = 0;
    for (unsigned leg = 0; leg <= depth; leg++)
        sum += norm(points[leg + 1] - points[leg]);
    return sum;
}

} // namespace

// Images of a point in a room are a lattice (Allen and Berkley 1979): 4n² + 2 of order n, each as
// far as its path is long.
static void paths_of_an_empty_room_are_its_lattice_of_images()
{
    const mesh faces = room();
    const unsigned depth = 3;
    const path_list found = faces.search(&TX_M, &RX_M, 1, depth, nullptr);
    CHECK(found.pair.size() == 1 + 6 + 18 + 38);
    CHECK(found.crossing_path.empty());
    std::vector<double> told, lattice;
    for (size_t path = 0; path < found.pair.size(); path++)
        told.push_back(length_m(faces, &found.faces[path * depth], depth));
    const auto image = [](int number, double size, double at) {
        return number * size + (number % 2 ? size - at : at);
    };
    for (int l = -3; l <= 3; l++)
        for (int m = -3; m <= 3; m++)
            for (int n = -3; n <= 3; n++)
                if (std::abs(l) + std::abs(m) + std::abs(n) <= 3)
                    lattice.push_back(
                        norm(vec{image(l, SIZE_M.x, TX_M.x), image(m, SIZE_M.y, TX_M.y),
                                 image(n, SIZE_M.z, TX_M.z)} -
                             RX_M));
    std::sort(told.begin(), told.end());
    std::sort(lattice.begin(), lattice.end());
    for (size_t i = 0; i < told.size(); i++)
        CHECK(std::abs(told[i] - lattice[i]) < 1e-9);
}

static void a_search_among_some_faces_finds_the_paths_that_meet_one_of_them()
{
    const mesh faces = room();
    const unsigned depth = 2;
    const std::array<uint8_t, 6> among{0, 1, 0, 0, 1, 0};
    const path_list all = faces.search(&TX_M, &RX_M, 1, depth, nullptr);
    const path_list some = faces.search(&TX_M, &RX_M, 1, depth, among.data());
    std::vector<int64_t> expected;
    for (size_t path = 0; path < all.pair.size(); path++) {
        const auto met = all.faces.begin() + path * depth;
        if (std::any_of(met, met + depth, [&](int64_t face) { return face >= 0 && among[face]; }))
            expected.insert(expected.end(), met, met + depth);
    }
    CHECK(some.faces == expected);
}

static void no_faces_leave_the_line_of_sight()
{
    const mesh nothing({}, {}, {}, {0}, {});
    CHECK(nothing.search(&TX_M, &RX_M, 1, 2, nullptr).pair.size() == 1);
    CHECK(nothing.search(nullptr, nullptr, 0, 2, nullptr).pair.empty());
}

// Friis: two isotropic antennas that see each other.
static void free_space_takes_what_friis_says()
{
    const vec along = {0, 1, 0}, field = {0, 0, 1};
    const double length_m = 42.0, wavelength_m = 0.125;
    complex gain;
    const surface bare{nullptr, nullptr, nullptr, nullptr, nullptr};
    gains({1, 0, nullptr, 0, nullptr, nullptr, nullptr, &along, &length_m, &field, &field}, nullptr,
          nullptr, bare, wavelength_m, &gain);
    CHECK(std::abs(gain - wavelength_m / (4 * 3.14159265358979323846 * length_m)) < 1e-15);
}

// A body shades what goes through it and nothing that goes over it, beside it or straight up.
static void a_body_shades_what_goes_through_it()
{
    const std::array<vec, 2> feet{vec{0, 0, 0}, vec{0, 5, 0}};
    const std::array<vec, 12> paths{vec{-3, 0.2, 1}, vec{3, 0.2, 1}, vec{3, 9, 1},
                                    vec{-3, 0.2, 2}, vec{3, 0.2, 2}, vec{3, 9, 2},
                                    vec{-3, 0.6, 1}, vec{3, 0.6, 1}, vec{3, 0.6, 1},
                                    vec{0, 0, -1},   vec{0, 0, 3},   vec{0, 0, 3}};
    std::array<uint8_t, 8> out{};
    shaded({0.5, 1.8}, feet.data(), 2, 1, paths.data(), 4, 3, out.data());
    CHECK((out == std::array<uint8_t, 8>{1, 0, 0, 0, 0, 0, 0, 0}));
}

int main()
{
    paths_of_an_empty_room_are_its_lattice_of_images();
    a_search_among_some_faces_finds_the_paths_that_meet_one_of_them();
    no_faces_leave_the_line_of_sight();
    free_space_takes_what_friis_says();
    a_body_shades_what_goes_through_it();
}
