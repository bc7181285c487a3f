// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "vec.h"
#include <cstdint>
#include <vector>

namespace gr
{
namespace cast
{
namespace tracing
{

// n paths of image law, as images.Paths in Python holds them: `faces` is n x depth, unused places
// -1; crossings are sorted by path, leg and share of the way.
struct path_list {
    std::vector<int64_t> pair, faces, crossing_path, crossing_leg, crossing_face;
};

// Where legs go through faces: leg after leg, then path after path, faces in their order.
struct crossing_list {
    std::vector<int64_t> path, leg, face;
    std::vector<double> share; // of the leg's way
};

// Which faces a search is about; nullptr is all.
using mask = const uint8_t*;

// Plane faces of objects, as images.Faces in Python holds them. Immutable: a moved object is
// another mesh.
class mesh
{
public:
    mesh(std::vector<vec> normal, std::vector<double> level_m, std::vector<uint8_t> sided,
         std::vector<int64_t> start, std::vector<vec> corners_m);

    size_t size() const { return d_normal.size(); }

    // All paths from tx_m[i] to rx_m[i] over up to `depth` faces, with what their legs go through.
    // With `among`, those over at least one of these faces alone.
    path_list search(const vec* tx_m, const vec* rx_m, size_t pairs, unsigned depth,
                     mask among) const;

    // What `search` finds, where all but the faces `changed` are as they were when `known` was
    // found.
    path_list search_again(const path_list& known, const vec* tx_m, const vec* rx_m, size_t pairs,
                           unsigned depth, mask changed) const;

    // Points (depth + 2) of a path over the endless planes of `met`; unused places repeat the end.
    void unfold(const int64_t* met, unsigned depth, const vec& tx_m, const vec& rx_m,
                vec* points) const;

    // Wherever a used leg of `points` (n x depth + 2) goes through a face.
    crossing_list crossings(const vec* points_m, const int64_t* met, size_t paths, unsigned depth,
                            mask among) const;

private:
    struct crossing {
        double share;
        int64_t face;
    };
    struct walk;

    double height_m(const vec& point_m, int64_t face) const
    {
        return dot(point_m, d_normal[face]) - d_level_m[face];
    }
    bool is_on_face(int64_t face, const vec& point_m) const;
    void add_crossings(const vec& begin, const vec& end, mask among,
                       std::vector<crossing>& found) const;
    path_list kept_of(const path_list& known, const vec* tx_m, const vec* rx_m, unsigned depth,
                      mask changed) const;

    std::vector<vec> d_normal;
    std::vector<double> d_level_m;
    std::vector<uint8_t> d_sided;
    std::vector<int64_t> d_start;
    std::vector<vec> d_corners_m;   // three of each triangle
    std::vector<vec> d_shares;      // two of each triangle
    std::vector<uint8_t> d_follows; // faces x faces
};

} // namespace tracing
} // namespace cast
} // namespace gr
