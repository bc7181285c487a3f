# SPDX-License-Identifier: GPL-3.0-or-later
"""Named triangle meshes: what a place is made of. Metres, z up."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...core.errors import CastError
from .media import Medium

MAX_COORDINATE_M = 1e5


@dataclass(frozen=True, eq=False, kw_only=True)
class Solid:
    """One object: `vertices_m` (V, 3) float64, `faces` (F, 3) vertex indices, the surface name its file gives, and the
    medium it is assigned, if any. Raises CastError for geometry that no ray can meet."""

    name: str
    vertices_m: np.ndarray
    faces: np.ndarray
    surface: str = ""
    medium: Medium | None = None

    def __post_init__(self):
        vertices_m = np.array(self.vertices_m, np.float64).reshape(-1, 3)
        faces = np.array(self.faces, np.int64).reshape(-1, 3)
        if not len(faces):
            raise CastError(f"object {self.name}: has no faces")
        if not np.isfinite(vertices_m).all() or np.abs(vertices_m).max() > MAX_COORDINATE_M:
            raise CastError(f"object {self.name}: a coordinate is not finite or beyond {MAX_COORDINATE_M:g} m")
        if faces.min() < 0 or faces.max() >= len(vertices_m):
            raise CastError(f"object {self.name}: a face names a vertex that is not there")
        area_m2 = areas_m2(vertices_m, faces)
        if not area_m2.any():
            raise CastError(f"object {self.name}: all its faces are of zero area")
        object.__setattr__(self, "vertices_m", vertices_m)
        object.__setattr__(self, "faces", faces[area_m2 > 0])


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of rows (n, 3): NumPy's own spends most of its time on its axes."""
    if a.shape != b.shape:
        a, b = np.broadcast_arrays(a, b)
    out = np.empty(a.shape, np.result_type(a, b))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, i] = a[:, j] * b[:, k] - a[:, k] * b[:, j]
    return out


def areas_m2(vertices_m: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area of every face, (F,)."""
    a, b, c = (vertices_m[faces[:, corner]] for corner in range(3))
    return 0.5 * np.linalg.norm(cross(b - a, c - a), axis=1)


def planes(solid: Solid) -> tuple[np.ndarray, np.ndarray]:
    """Unit normal (F, 3) and a point (F, 3) of the plane of every face."""
    a, b, c = (solid.vertices_m[solid.faces[:, corner]] for corner in range(3))
    normal = cross(b - a, c - a)
    return normal / np.linalg.norm(normal, axis=1, keepdims=True), a


def open_edges_m(solid: Solid) -> np.ndarray:
    """Middles (E, 3) of the edges that do not have exactly two faces: none for a closed surface. Vertices at one place count
    as one."""
    places_m, same = np.unique(np.round(solid.vertices_m, 6), axis=0, return_inverse=True)
    corners = same.reshape(-1)[solid.faces]
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    return places_m[edges[count != 2]].mean(axis=1)


def is_closed(solid: Solid) -> bool:
    return len(solid.faces) > 3 and not len(open_edges_m(solid))  # fewer close nothing


def is_flat(solid: Solid) -> bool:
    """Whether an object is a sheet: all of it within 1 mm of one plane."""
    normals, points_m = planes(solid)
    largest = int(np.argmax(areas_m2(solid.vertices_m, solid.faces)))
    return bool(np.abs((solid.vertices_m - points_m[largest]) @ normals[largest]).max() < 1e-3)


_LOOK = np.array([[0.6112, 0.5437, 0.5752], [-0.7071, 0.6189, -0.3420], [0.1830, -0.7431, 0.6437]])  # along no usual wall
_AT_ONCE = 100_000  # points times faces in memory


def inside(solid: Solid, points_m: np.ndarray) -> np.ndarray:
    """(n,) whether points (n, 3) lie inside a closed object: rays from them meet an odd number of faces, however these are wound.

    Intersections after Möller & Trumbore 1997; two of three rays decide, for one may run through an edge.
    """
    points_m = np.asarray(points_m, np.float64).reshape(-1, 1, 3)
    parts = np.array_split(points_m, 1 + len(points_m) * len(solid.faces) // _AT_ONCE)
    return np.concatenate([_inside(solid, part) for part in parts])


def _inside(solid: Solid, points_m: np.ndarray) -> np.ndarray:
    a, b, c = (solid.vertices_m[solid.faces[:, corner]] for corner in range(3))
    ab, ac, back = b - a, c - a, points_m - a
    across = np.cross(back, ab)
    odd = np.zeros(len(back), int)
    for look in _LOOK:
        normal = np.cross(look, ac)
        dots = (back * normal).sum(axis=2), across @ look, (ac * across).sum(axis=2)
        with np.errstate(divide="ignore", invalid="ignore"):  # a ray along a face does not meet it
            u, v, way = (dot / (ab * normal).sum(axis=1) for dot in dots)
            odd += ((u >= 0) & (v >= 0) & (u + v <= 1) & (way > 0)).sum(axis=1) % 2
    return odd >= 2


def bounds_m(solids: list[Solid]) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner (3,) of all objects."""
    corners = np.concatenate([solid.vertices_m for solid in solids])
    return corners.min(axis=0), corners.max(axis=0)


def prism(name: str, outline_m: np.ndarray, holes_m: list[np.ndarray], low_m: float, high_m: float, surface: str) -> Solid:
    """A closed prism over a plane outline (n, 2) with holes, from z = low_m to high_m."""
    # Outline anticlockwise, holes clockwise: then all faces are wound alike.
    loops = [
        loop if (signed_area_m2(loop) > 0) == (index == 0) else loop[::-1] for index, loop in enumerate([outline_m, *holes_m])
    ]
    base, triangles = triangulate(loops[0], loops[1:])
    count = len(base)
    bottom, top = np.column_stack([base, np.full(count, low_m)]), np.column_stack([base, np.full(count, high_m)])
    faces = [triangles[:, ::-1], triangles + count]
    start = 0
    for loop in loops:
        here = start + np.arange(len(loop))
        following = start + (np.arange(len(loop)) + 1) % len(loop)
        faces += [
            np.column_stack([here, following, following + count]),
            np.column_stack([here, following + count, here + count]),
        ]
        start += len(loop)
    return Solid(name=name, vertices_m=np.concatenate([bottom, top]), faces=np.concatenate(faces), surface=surface)


def signed_area_m2(loop: np.ndarray) -> float:
    """Area of a plane polygon (n, 2), positive when it runs anticlockwise."""
    x, y = loop[:, 0], loop[:, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def triangulate(outline: np.ndarray, holes: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Cut a plane polygon with holes into triangles by ears: points (outline, then holes) and triangles (n, 3).

    A hole is joined to the outline by a bridge to a corner that it sees (Eberly, "Triangulation by Ear Clipping").
    Raises CastError for an outline that crosses itself.
    """
    loops = [outline, *holes]
    points = np.concatenate(loops)
    starts = np.cumsum([0] + [len(loop) for loop in loops])
    rings = [list(range(a, b)) for a, b in zip(starts, starts[1:], strict=False)]
    for index, ring in enumerate(rings):
        if (signed_area_m2(points[ring]) > 0) != (index == 0):
            ring.reverse()
        if _crosses_itself(points[ring]):
            raise CastError("the outline crosses itself")
    ring = rings[0]
    for hole in sorted(rings[1:], key=lambda hole: -points[hole, 0].max()):
        ring = _bridged(points, ring, hole, rings)
    triangles = []
    while len(ring) > 3:
        ear = next((place for place in range(len(ring)) if _is_ear(points, ring, place)), None)
        if ear is None:
            raise CastError("the outline crosses itself")
        triangles.append([ring[ear - 1], ring[ear], ring[(ear + 1) % len(ring)]])
        ring = ring[:ear] + ring[ear + 1 :]
    triangles.append(ring)
    return points, np.array(triangles)


def _cross(o: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])


def _is_ear(points: np.ndarray, ring: list[int], place: int) -> bool:
    corner = ring[place - 1], ring[place], ring[(place + 1) % len(ring)]
    a, b, c = points[list(corner)]
    if _cross(a, b, c) <= 0:
        return False
    others = [index for index in ring if not (points[index] == points[list(corner)]).all(axis=1).any()]
    return not any(_cross(a, b, p) >= 0 and _cross(b, c, p) >= 0 and _cross(c, a, p) >= 0 for p in points[others])


def _bridged(points: np.ndarray, ring: list[int], hole: list[int], rings: list[list[int]]) -> list[int]:
    start = int(np.argmax(points[hole, 0]))
    hole = hole[start:] + hole[:start]
    segments = [(points[a], points[b]) for loop in rings for a, b in zip(loop, loop[1:] + loop[:1], strict=True)]
    order = np.argsort(np.linalg.norm(points[ring] - points[hole[0]], axis=1))
    for place in order:
        ends = points[hole[0]], points[ring[place]]
        if not any(_crosses(*ends, *segment) for segment in segments):
            return ring[: place + 1] + hole + [hole[0]] + ring[place:]
    raise CastError("a hole is not inside its outline")


def _crosses_itself(loop: np.ndarray) -> bool:
    edges = list(zip(loop, np.roll(loop, -1, axis=0), strict=True))
    return any(_crosses(*edges[i], *edges[j]) for i in range(len(edges)) for j in range(i + 2, len(edges)))


def _crosses(a, b, c, d) -> bool:
    """Whether the open segments a-b and c-d cross in their interiors."""
    return _cross(a, b, c) * _cross(a, b, d) < 0 and _cross(c, d, a) * _cross(c, d, b) < 0


def assigned(solid: Solid, medium: Medium) -> Solid:
    return replace(solid, medium=medium)


def outlines(solids: Sequence[Solid]) -> list[dict]:
    """The objects from above, for a plan: `name`, `faces` ([[x, y], …] in metres, to the centimetre) and `floor`, true of level
    sheets at the bottom or the top of all, which would hide the others."""
    bottom_m, top_m = (corner[2] for corner in bounds_m(solids))
    found = []
    for solid in solids:
        height_m = solid.vertices_m[:, 2]
        floor = np.ptp(height_m) < 0.01 and not bottom_m + 0.01 < height_m[0] < top_m - 0.01
        faces = np.round(solid.vertices_m[solid.faces][:, :, :2], 2)
        turns_right = np.linalg.det(np.diff(faces, axis=1)) < 0
        faces[turns_right] = faces[turns_right, ::-1]  # all one way round, or top and bottom would cancel
        faces = np.unique(faces, axis=0)
        found.append({"name": solid.name, "faces": faces.tolist(), "floor": bool(floor)})
    return found
