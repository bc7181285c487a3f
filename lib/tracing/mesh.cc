// SPDX-License-Identifier: GPL-3.0-or-later
#include "mesh.h"
#include <algorithm>
#include <utility>

namespace gr
{
namespace cast
{
namespace tracing
{

namespace
{

constexpr double ON_PLANE_M =
    1e-6;                     // nearer to a plane than this is on it: legs begin and end on faces
constexpr double EDGE = 1e-9; // of a triangle, in barycentric coordinates

void append(path_list& to, const path_list& from, unsigned depth, size_t path, size_t& crossing)
{
    const auto number = int64_t(to.pair.size());
    to.pair.push_back(from.pair[path]);
    const auto met = from.faces.begin() + path * depth;
    to.faces.insert(to.faces.end(), met, met + depth);
    for (; crossing < from.crossing_path.size() && from.crossing_path[crossing] == int64_t(path);
         crossing++) {
        to.crossing_path.push_back(number);
        to.crossing_leg.push_back(from.crossing_leg[crossing]);
        to.crossing_face.push_back(from.crossing_face[crossing]);
    }
}

} // namespace

mesh::mesh(std::vector<vec> normal, std::vector<double> level_m, std::vector<uint8_t> sided,
           std::vector<int64_t> start, std::vector<vec> corners_m)
    : d_normal(std::move(normal)), d_level_m(std::move(level_m)), d_sided(std::move(sided)),
      d_start(std::move(start)), d_corners_m(std::move(corners_m)), d_follows(size() * size())
{
    // A place from a triangle's first corner, on its plane, is made of the two sides from there by
    // these shares.
    for (size_t first = 0; first < d_corners_m.size(); first += 3) {
        const vec ab = d_corners_m[first + 1] - d_corners_m[first];
        const vec ac = d_corners_m[first + 2] - d_corners_m[first];
        const double bb = dot(ab, ab), bc = dot(ab, ac), cc = dot(ac, ac),
                     area = 1 / (bb * cc - bc * bc);
        d_shares.push_back(area * (cc * ab - bc * ac));
        d_shares.push_back(area * (bb * ac - bc * ab));
    }
    // A path goes from one face to another only where each has some part in front of the other.
    std::vector<uint8_t> front(size() * size());
    for (size_t a = 0; a < size(); a++)
        for (size_t b = 0; b < size(); b++) {
            double highest = -1;
            for (int64_t corner = 3 * d_start[b]; corner < 3 * d_start[b + 1]; corner++) {
                const double h = height_m(d_corners_m[corner], a);
                highest = std::max(highest, d_sided[a] ? h : std::abs(h));
            }
            front[a * size() + b] = highest > ON_PLANE_M;
        }
    for (size_t a = 0; a < size(); a++)
        for (size_t b = 0; b < size(); b++)
            d_follows[a * size() + b] = front[a * size() + b] && front[b * size() + a];
}

bool mesh::is_on_face(int64_t face, const vec& point_m) const
{
    for (int64_t triangle = d_start[face]; triangle < d_start[face + 1]; triangle++) {
        const vec from_corner = point_m - d_corners_m[3 * triangle];
        const double u = dot(d_shares[2 * triangle], from_corner),
                     v = dot(d_shares[2 * triangle + 1], from_corner);
        if (u >= -EDGE && v >= -EDGE && u + v <= 1 + EDGE)
            return true;
    }
    return false;
}

void mesh::add_crossings(const vec& begin, const vec& end, mask among,
                         std::vector<crossing>& found) const
{
    for (size_t face = 0; face < size(); face++) {
        if (among && !among[face])
            continue;
        const double above = height_m(begin, face), below = height_m(end, face);
        if (above * below < 0 && std::min(std::abs(above), std::abs(below)) > ON_PLANE_M) {
            const double share = above / (above - below);
            if (is_on_face(face, begin + share * (end - begin)))
                found.push_back({share, int64_t(face)});
        }
    }
}

void mesh::unfold(const int64_t* met, unsigned depth, const vec& tx_m, const vec& rx_m,
                  vec* points) const
{
    std::vector<vec> images{tx_m};
    for (unsigned bounce = 0; bounce < depth; bounce++) {
        const vec& here = images.back();
        images.push_back(met[bounce] < 0
                             ? here
                             : here - 2 * height_m(here, met[bounce]) * d_normal[met[bounce]]);
    }
    points[0] = tx_m;
    points[depth + 1] = rx_m;
    for (unsigned bounce = depth; bounce-- > 0;) {
        const vec end = points[bounce + 2], image = images[bounce + 1];
        points[bounce + 1] = end;
        if (met[bounce] < 0)
            continue;
        const double above = height_m(end, met[bounce]), below = height_m(image, met[bounce]);
        points[bounce + 1] = end + above / (above == below ? 1.0 : above - below) * (image - end);
    }
}

crossing_list mesh::crossings(const vec* points_m, const int64_t* met, size_t paths, unsigned depth,
                              mask among) const
{
    crossing_list out;
    std::vector<crossing> found;
    for (unsigned leg = 0; leg <= depth; leg++)
        for (size_t path = 0; path < paths; path++) {
            if (leg && met[path * depth + leg - 1] < 0)
                continue;
            const vec* begin = points_m + path * (depth + 2) + leg;
            found.clear();
            add_crossings(begin[0], begin[1], among, found);
            for (const auto& one : found) {
                out.path.push_back(int64_t(path));
                out.leg.push_back(leg);
                out.face.push_back(one.face);
                out.share.push_back(one.share);
            }
        }
    return out;
}

// All paths of one pair of points: chains of faces in their order, images of a chain's beginning
// made once.
struct mesh::walk {
    const mesh& faces;
    const unsigned depth;
    const mask among;
    path_list& out;
    std::vector<vec> images, points;
    std::vector<int64_t> chain;
    std::vector<crossing> crossings;

    walk(const mesh& faces_, unsigned depth_, mask among_, path_list& out_)
        : faces(faces_), depth(depth_), among(among_), out(out_), images(depth + 1),
          points(depth + 2), chain(depth, -1)
    {
    }

    void add(int64_t pair, unsigned order, const vec& rx_m)
    {
        vec end = rx_m;
        points[order + 1] = rx_m;
        for (unsigned bounce = order; bounce-- > 0;) {
            const vec& image = images[bounce + 1];
            const double here = faces.height_m(end, chain[bounce]),
                         there = faces.height_m(image, chain[bounce]);
            if (here * there >= 0 || std::abs(here) <= ON_PLANE_M)
                return;
            end = end + here / (here - there) * (image - end);
            if (!faces.is_on_face(chain[bounce], end))
                return;
            points[bounce + 1] = end;
        }
        points[0] = images[0];
        const auto number = int64_t(out.pair.size());
        out.pair.push_back(pair);
        out.faces.insert(out.faces.end(), chain.begin(), chain.end());
        for (unsigned leg = 0; leg <= order; leg++) {
            crossings.clear();
            faces.add_crossings(points[leg], points[leg + 1], nullptr, crossings);
            add_leg(out, number, leg, crossings);
        }
    }

    static void add_leg(path_list& out, int64_t path, unsigned leg,
                        std::vector<crossing>& crossings)
    {
        std::stable_sort(crossings.begin(), crossings.end(),
                         [](const crossing& a, const crossing& b) { return a.share < b.share; });
        for (const auto& one : crossings) {
            out.crossing_path.push_back(path);
            out.crossing_leg.push_back(leg);
            out.crossing_face.push_back(one.face);
        }
    }

    void from(int64_t pair, unsigned order, bool is_among, const vec& rx_m)
    {
        if (is_among)
            add(pair, order, rx_m);
        if (order == depth)
            return;
        const vec here = images[order];
        for (size_t face = 0; face < faces.size(); face++) {
            const bool still = is_among || among[face];
            if (!still && order + 1 == depth)
                continue;
            if (order && !faces.d_follows[chain[order - 1] * faces.size() + face])
                continue;
            const double height = faces.height_m(here, face);
            if ((faces.d_sided[face] ? height : std::abs(height)) <= ON_PLANE_M)
                continue;
            images[order + 1] = here - 2 * height * faces.d_normal[face];
            chain[order] = int64_t(face);
            from(pair, order + 1, still, rx_m);
            chain[order] = -1;
        }
    }
};

path_list mesh::search(const vec* tx_m, const vec* rx_m, size_t pairs, unsigned depth,
                       mask among) const
{
    path_list out;
    walk one(*this, depth, among, out);
    for (size_t pair = 0; pair < pairs; pair++) {
        one.images[0] = tx_m[pair];
        one.from(int64_t(pair), 0, !among, rx_m[pair]);
    }
    return out;
}

path_list mesh::kept_of(const path_list& known, const vec* tx_m, const vec* rx_m, unsigned depth,
                        mask changed) const
{
    path_list out;
    std::vector<vec> points(depth + 2);
    std::vector<crossing> crossings;
    size_t at = 0;
    for (size_t path = 0; path < known.pair.size(); path++) {
        const int64_t* met = known.faces.data() + path * depth;
        const auto first = at;
        while (at < known.crossing_path.size() && known.crossing_path[at] == int64_t(path))
            at++;
        if (std::any_of(met, met + depth, [&](int64_t face) { return face >= 0 && changed[face]; }))
            continue;
        const auto number = int64_t(out.pair.size());
        out.pair.push_back(known.pair[path]);
        out.faces.insert(out.faces.end(), met, met + depth);
        unfold(met, depth, tx_m[known.pair[path]], rx_m[known.pair[path]], points.data());
        for (unsigned leg = 0; leg <= depth && (leg == 0 || met[leg - 1] >= 0); leg++) {
            const vec &begin = points[leg], &end = points[leg + 1];
            crossings.clear();
            for (size_t i = first; i < at; i++) {
                const int64_t face = known.crossing_face[i];
                if (known.crossing_leg[i] != leg || changed[face])
                    continue;
                const double above = height_m(begin, face), below = height_m(end, face);
                crossings.push_back({above / (above - below), face});
            }
            add_crossings(begin, end, changed, crossings);
            walk::add_leg(out, number, leg, crossings);
        }
    }
    return out;
}

path_list mesh::search_again(const path_list& known, const vec* tx_m, const vec* rx_m, size_t pairs,
                             unsigned depth, mask changed) const
{
    const path_list kept = kept_of(known, tx_m, rx_m, depth, changed);
    const path_list fresh = search(tx_m, rx_m, pairs, depth, changed);
    path_list out;
    size_t i = 0, j = 0, crossing_i = 0, crossing_j = 0;
    const auto comes_first = [&] { // of kept, in the order of pairs and of what paths meet
        if (kept.pair[i] != fresh.pair[j])
            return kept.pair[i] < fresh.pair[j];
        const auto a = kept.faces.begin() + i * depth, b = fresh.faces.begin() + j * depth;
        return std::lexicographical_compare(a, a + depth, b, b + depth);
    };
    while (i < kept.pair.size() || j < fresh.pair.size()) {
        if (j == fresh.pair.size() || (i < kept.pair.size() && comes_first()))
            append(out, kept, depth, i++, crossing_i);
        else
            append(out, fresh, depth, j++, crossing_j);
    }
    return out;
}

} // namespace tracing
} // namespace cast
} // namespace gr
