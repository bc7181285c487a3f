# SPDX-License-Identifier: GPL-3.0-or-later
"""Specular paths by mirror images, in double precision: which faces a path meets, where, and what stands in its way.

Every path of the image law is found, also those that meet two faces millimetres from a corner (Borish 1984). What blocks a leg is
kept as a crossing and not thrown away: an object that is taken away, or let through, needs no new search.

Where the compiled kernels (lib/tracing) were built they do the same, some ten times as fast.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .geometry import Solid, areas_m2, inside, is_closed, planes

try:
    from . import tracing
except ImportError:
    tracing = None

NO_POINTS = np.zeros((0, 3))
_ON_PLANE_M = 1e-6  # nearer to a plane than this is on it: legs begin and end on faces
_EDGE = 1e-9  # of a triangle, in barycentric coordinates: a point on an edge is inside
_AT_ONCE = 2_000_000  # candidates in memory at the same time


@dataclass(frozen=True, kw_only=True)
class Faces:
    """Plane faces of objects: `normal` (F, 3) unit, `level_m` (F,) normal·x = level on the plane, `owner` (F,) object.

    `sided` (F,): met from the side of its normal alone (the hull of a closed object without a node in it).
    Triangles (M, 3, 3) of face f are `triangles_m[start[f]:start[f + 1]]`.
    """

    normal: np.ndarray
    level_m: np.ndarray
    owner: np.ndarray
    sided: np.ndarray
    start: np.ndarray
    triangles_m: np.ndarray

    @cached_property
    def follows(self) -> np.ndarray:
        """(F, F) whether a path may go from one face to another: each has some part in front of the other."""
        height_m = self.triangles_m @ self.normal.T - self.level_m  # (M, 3, F) of corners above faces
        height_m = np.where(self.sided, height_m, np.abs(height_m)).max(axis=1)
        front = np.maximum.reduceat(height_m, self.start[:-1]).T > _ON_PLANE_M  # (a, b): some of face b is in front of face a
        return front & front.T

    @cached_property
    def shares(self) -> np.ndarray:
        """(M, 2, 3) by which a place from a triangle's first corner, on its plane, is made of the two sides from there."""
        first, *others = np.moveaxis(self.triangles_m, 1, 0)
        ab, ac = (other - first for other in others)
        bb, bc, cc = _dot(ab, ab), _dot(ab, ac), _dot(ac, ac)
        sides = np.stack([cc[:, None] * ab - bc[:, None] * ac, bb[:, None] * ac - bc[:, None] * ab], axis=1)
        return sides / (bb * cc - bc * bc)[:, None, None]

    @cached_property
    def compiled(self):
        """The same faces as compiled kernels have them."""
        return tracing.Mesh(self.normal, self.level_m, self.sided, self.start, self.triangles_m)

    def __getstate__(self):
        return {key: value for key, value in vars(self).items() if key != "compiled"}

    @property
    def triangle_areas_m2(self) -> np.ndarray:
        """(M,)."""
        return areas_m2(self.triangles_m.reshape(-1, 3), np.arange(3 * len(self.triangles_m)).reshape(-1, 3))


@dataclass(frozen=True, kw_only=True)
class Paths:
    """n paths of image law; `pair` (n,) says between which of the pairs of points. Unused places of `faces` (n, D) are −1.

    Crossings: `path`, `leg` and `face` (c,) of every face that a leg goes through, in the order in which it meets them.
    """

    pair: np.ndarray
    faces: np.ndarray
    crossing_path: np.ndarray
    crossing_leg: np.ndarray
    crossing_face: np.ndarray


def _named(columns: tuple[np.ndarray, ...]) -> Paths:
    """Paths as compiled kernels give them."""
    return Paths(**dict(zip(Paths.__dataclass_fields__, columns, strict=True)))


def faces_of(solids: Sequence[Solid], points_m: np.ndarray = NO_POINTS, *, thick: bool = False) -> Faces:
    """The plane faces of objects. A closed object with none of `points_m` (n, 3) inside shows its outside alone, unless `thick`:
    legs that go through its hull meet it from within as well."""
    normal, level_m, owner, sided, start, triangles = [], [], [], [], [0], []
    for index, solid in enumerate(solids):
        normals, anchors_m = planes(solid)
        corners_m = solid.vertices_m[solid.faces]
        closed = is_closed(solid)
        if closed:
            normals = _outward(solid, normals, corners_m)
        hollow = not thick and closed and not inside(solid, points_m).any()
        if not closed:  # a sheet is one face, however its triangles are wound
            normals = normals * np.where(_first_sign(normals) < 0, -1.0, 1.0)[:, None]
        keys = np.round(np.column_stack([normals * 1e6, (normals * anchors_m).sum(axis=1) * 1e5])).astype(np.int64)
        for group in _groups(keys):
            normal.append(normals[group[0]])
            level_m.append(float(normals[group[0]] @ anchors_m[group[0]]))
            owner.append(index)
            sided.append(hollow)
            triangles.append(corners_m[group])
            start.append(start[-1] + len(group))
    return Faces(
        normal=np.array(normal).reshape(-1, 3),
        level_m=np.array(level_m),
        owner=np.array(owner, np.int64),
        sided=np.array(sided, bool),
        start=np.array(start),
        triangles_m=np.concatenate(triangles) if triangles else np.zeros((0, 3, 3)),
    )


def shifted(faces: Faces, owner: int, offset_m: np.ndarray) -> Faces:
    """The faces with those of one object moved."""
    own = faces.owner == owner
    level_m = np.where(own, faces.level_m + faces.normal @ offset_m, faces.level_m)
    moved = np.repeat(own, np.diff(faces.start))
    return replace(faces, level_m=level_m, triangles_m=faces.triangles_m + moved[:, None, None] * offset_m)


def joined(first: Faces, second: Faces, owners: int) -> Faces:
    """The faces of `second` behind those of `first`, whose objects are `owners` in number."""
    return Faces(
        normal=np.concatenate([first.normal, second.normal]),
        level_m=np.concatenate([first.level_m, second.level_m]),
        owner=np.concatenate([first.owner, second.owner + owners]),
        sided=np.concatenate([first.sided, second.sided]),
        start=np.concatenate([first.start, first.start[-1] + second.start[1:]]),
        triangles_m=np.concatenate([first.triangles_m, second.triangles_m]),
    )


def chosen(paths: Paths, keep: np.ndarray) -> Paths:
    """The paths of `keep` (n,) bool with their crossings."""
    number = np.cumsum(keep) - 1
    crossing = keep[paths.crossing_path]
    return Paths(
        pair=paths.pair[keep],
        faces=paths.faces[keep],
        crossing_path=number[paths.crossing_path[crossing]],
        crossing_leg=paths.crossing_leg[crossing],
        crossing_face=paths.crossing_face[crossing],
    )


def begins(counts: Sequence[int]) -> list[int]:
    """Where each of several lists, one after the other, begins, and where the last one ends."""
    return [0, *itertools.accumulate(counts)]


def joined_paths(parts: Sequence[Paths], counts: Sequence[int]) -> Paths:
    """Paths between several lists of pairs of points, `counts` long, as those of one list."""
    if len(parts) == 1:
        return parts[0]
    pairs, paths = (begins(lengths) for lengths in (counts, [len(part.pair) for part in parts]))
    return Paths(
        pair=np.concatenate([part.pair + first for part, first in zip(parts, pairs, strict=False)]),
        faces=np.concatenate([part.faces for part in parts]),
        crossing_path=np.concatenate([part.crossing_path + first for part, first in zip(parts, paths, strict=False)]),
        crossing_leg=np.concatenate([part.crossing_leg for part in parts]),
        crossing_face=np.concatenate([part.crossing_face for part in parts]),
    )


def parted_paths(paths: Paths, counts: Sequence[int]) -> list[Paths]:
    """What `joined_paths` joined."""
    pairs = begins(counts)
    first = np.searchsorted(paths.pair, pairs).tolist()
    crossing = np.searchsorted(paths.crossing_path, first).tolist()
    return [
        Paths(
            pair=paths.pair[a:b] - pair,
            faces=paths.faces[a:b],
            crossing_path=paths.crossing_path[c:d] - a,
            crossing_leg=paths.crossing_leg[c:d],
            crossing_face=paths.crossing_face[c:d],
        )
        for pair, a, b, c, d in zip(pairs, first, first[1:], crossing, crossing[1:], strict=False)
    ]


def _first_sign(normals: np.ndarray) -> np.ndarray:
    """Sign of the first component that is not nil."""
    first = np.argmax(np.abs(normals) > 1e-6, axis=1)
    return np.sign(normals[np.arange(len(normals)), first])


def _groups(keys: np.ndarray) -> list[np.ndarray]:
    """Rows that are alike to the last but one digit: two triangles of one plane may round to neighbouring numbers."""
    groups: list[list[int]] = []
    for row, key in enumerate(keys):
        for group in groups:
            if np.abs(keys[group[0]] - key).max() <= 2:
                group.append(row)
                break
        else:
            groups.append([row])
    return [np.array(group) for group in groups]


def _outward(solid: Solid, normals: np.ndarray, corners_m: np.ndarray) -> np.ndarray:
    height_m = np.einsum("fi,fvi->fv", normals, solid.vertices_m - corners_m[:, :1])  # of all corners over each face
    is_out, is_in = height_m.max(axis=1) < _ON_PLANE_M, height_m.min(axis=1) > -_ON_PLANE_M
    if (is_out | is_in).all():  # convex
        return np.where(is_out[:, None], normals, -normals)
    turned = inside(solid, corners_m.mean(axis=1) + 1e-4 * normals)
    return np.where(turned[:, None], -normals, normals)


def on_face(faces: Faces, face: np.ndarray, point_m: np.ndarray) -> np.ndarray:
    """Whether point i (n, 3), which lies on the plane of face i (n,), lies on the face, edges included."""
    first = faces.start[face]
    count = faces.start[face + 1] - first
    inside = np.zeros(len(face), bool)
    for number in range(int(count.max(initial=0))):
        rows = np.flatnonzero((count > number) & ~inside)
        which = first[rows] + number
        u, v = np.einsum("nki,ni->kn", faces.shares[which], point_m[rows] - faces.triangles_m[which, 0])
        inside[rows] = (u >= -_EDGE) & (v >= -_EDGE) & (u + v <= 1 + _EDGE)
    return inside


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", a, b)


def sequences(faces: Faces, order: int, among: np.ndarray | None = None) -> np.ndarray:
    """Which faces a path may meet in turn, (S, order): each has some part in front of the one before, and the other way round.

    With `among` (F,) bool, those with at least one of these faces alone.
    """
    count = len(faces.level_m)
    if order == 0:
        return np.zeros((1, 0), np.int64)
    chains = np.arange(count)[:, None]
    for _ in range(order - 1):
        before, after = np.nonzero(faces.follows[chains[:, -1]])
        chains = np.column_stack([chains[before], after])
    return chains if among is None else chains[among[chains].any(axis=1)]


def search(faces: Faces, tx_m: np.ndarray, rx_m: np.ndarray, max_depth: int, among: np.ndarray | None = None) -> Paths:
    """All paths from point i of `tx_m` (P, 3) to point i of `rx_m` (P, 3) over up to `max_depth` faces, with what they cross.

    With `among` (F,) bool, those over at least one of these faces alone.
    """
    if tracing:
        step = max(1, _AT_ONCE // max(len(faces.level_m) ** max_depth, 1))  # between which an interrupt is heard
        counts = [min(step, len(tx_m) - first) for first in range(0, len(tx_m), step)] or [0]
        ends = [slice(first, first + count) for first, count in zip(range(0, len(tx_m) + 1, step), counts, strict=False)]
        parts = [_named(faces.compiled.search(tx_m[own], rx_m[own], max_depth, among)) for own in ends]
        return parts[0] if len(parts) == 1 else joined_paths(parts, counts)
    pair, met = [], []
    for order in range(max_depth + 1):
        chains = sequences(faces, order, among) if order or among is None else np.zeros((0, 0), np.int64)
        step = max(1, _AT_ONCE // max(len(chains), 1))
        for first in range(0, len(tx_m) if len(chains) else 0, step):
            rows, which = _valid(faces, chains, tx_m[first : first + step], rx_m[first : first + step])
            padded = np.full((len(rows), max_depth), -1)
            padded[:, :order] = chains[which]
            pair.append(rows + first)
            met.append(padded)
    pair = np.concatenate(pair) if pair else np.zeros(0, np.int64)
    met = np.concatenate(met) if met else np.zeros((0, max_depth), np.int64)
    order = np.lexsort((*met.T[::-1], pair))
    none = np.zeros(0, np.int64)
    bare = Paths(pair=pair[order], faces=met[order], crossing_path=none, crossing_leg=none, crossing_face=none)
    return crossed(faces, bare, tx_m, rx_m)


def search_again(faces: Faces, known: Paths, tx_m: np.ndarray, rx_m: np.ndarray, max_depth: int, changed: np.ndarray) -> Paths:
    """What `search` finds, where all but the faces `changed` (F,) bool are as they were when `known` was found."""
    if tracing:
        return _named(faces.compiled.search_again(*vars(known).values(), tx_m, rx_m, max_depth, changed))
    kept = chosen(known, ~((known.faces >= 0) & changed[known.faces]).any(axis=1))
    kept = crossed(faces, kept, tx_m, rx_m, changed)
    new = search(faces, tx_m, rx_m, max_depth, changed)
    pair, met = np.concatenate([kept.pair, new.pair]), np.concatenate([kept.faces, new.faces])
    order = np.lexsort((*met.T[::-1], pair))
    rank = np.argsort(order)
    path = rank[np.concatenate([kept.crossing_path, new.crossing_path + len(kept.pair)])]
    crossing = np.argsort(path, kind="stable")
    leg, face = (
        np.concatenate(two)[crossing] for two in ((kept.crossing_leg, new.crossing_leg), (kept.crossing_face, new.crossing_face))
    )
    return Paths(pair=pair[order], faces=met[order], crossing_path=path[crossing], crossing_leg=leg, crossing_face=face)


def _valid(faces: Faces, chains: np.ndarray, tx_m: np.ndarray, rx_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs and chains whose reflection points all lie on their faces."""
    order = chains.shape[1]
    if order == 0:
        return np.arange(len(tx_m)), np.zeros(len(tx_m), np.int64)
    # Images of a chain begin with those of its first faces: each is made once per pair and distinct beginning.
    row, chain = np.divmod(np.arange(len(tx_m) * len(chains)), len(chains))
    images = [tx_m[row]]
    for bounce in range(order):
        face = chains[chain, bounce]
        height_m = _dot(images[-1], faces.normal[face]) - faces.level_m[face]
        keep = np.where(faces.sided[face], height_m, np.abs(height_m)) > _ON_PLANE_M
        row, chain, face, height_m = row[keep], chain[keep], face[keep], height_m[keep]
        images = [image[keep] for image in images]
        images.append(images[-1] - 2 * height_m[:, None] * faces.normal[face])
    end_m = rx_m[row]
    for bounce in reversed(range(order)):
        face = chains[chain, bounce]
        here, there = (_dot(point, faces.normal[face]) - faces.level_m[face] for point in (end_m, images[bounce + 1]))
        keep = (here * there < 0) & (np.abs(here) > _ON_PLANE_M)
        row, chain, face, here, there = row[keep], chain[keep], face[keep], here[keep], there[keep]
        images, end_m = [image[keep] for image in images], end_m[keep]
        end_m = end_m + (here / (here - there))[:, None] * (images[bounce + 1] - end_m)
        keep = on_face(faces, face, end_m)
        row, chain, end_m = row[keep], chain[keep], end_m[keep]
        images = [image[keep] for image in images]
    return row, chain


def unfold(faces: Faces, met: np.ndarray, tx_m: np.ndarray, rx_m: np.ndarray) -> np.ndarray:
    """Points (n, D + 2, 3) of paths over the planes of `met` (n, D) from `tx_m` to `rx_m` (n, 3); unused places repeat the end.

    The planes are taken as endless: which faces a path meets stays as it was.
    """
    depth = met.shape[1]
    images = [tx_m]
    for bounce in range(depth):
        face, here = met[:, bounce], met[:, bounce] >= 0
        height_m = _dot(images[-1], faces.normal[face]) - faces.level_m[face]
        images.append(images[-1] - 2 * np.where(here, height_m, 0.0)[:, None] * faces.normal[face])
    points = np.repeat(rx_m[:, None], depth + 2, axis=1)
    points[:, 0] = tx_m
    for bounce in reversed(range(depth)):
        face, here = met[:, bounce], met[:, bounce] >= 0
        end_m, image_m = points[:, bounce + 2], images[bounce + 1]
        above, below = (_dot(point, faces.normal[face]) - faces.level_m[face] for point in (end_m, image_m))
        share = above / np.where(above == below, 1.0, above - below)
        points[:, bounce + 1] = np.where(here[:, None], end_m + share[:, None] * (image_m - end_m), end_m)
    return points


def crossed(faces: Faces, paths: Paths, tx_m: np.ndarray, rx_m: np.ndarray, among: np.ndarray | None = None) -> Paths:
    """The same paths with what their legs go through: all faces, or those of `among` (F,) bool anew and the rest as before."""
    points = unfold(faces, paths.faces, tx_m[paths.pair], rx_m[paths.pair])
    path, leg, face, share = crossings(faces, points, paths.faces, among)
    if among is not None:
        old = ~among[paths.crossing_face]
        path, leg = np.concatenate([paths.crossing_path[old], path]), np.concatenate([paths.crossing_leg[old], leg])
        face = np.concatenate([paths.crossing_face[old], face])
        begin, end = points[path, leg], points[path, leg + 1]
        above, below = (_dot(point, faces.normal[face]) - faces.level_m[face] for point in (begin, end))
        share = above / (above - below)
    order = np.lexsort((share, leg, path))
    return replace(paths, crossing_path=path[order], crossing_leg=leg[order], crossing_face=face[order])


def crossings(faces: Faces, points: np.ndarray, met: np.ndarray, among: np.ndarray | None = None):
    """Path, leg, face and share of the way (c,) wherever a leg of `points` (n, D + 2, 3) goes through a face."""
    if tracing:
        return faces.compiled.crossings(points, met, among)
    wanted = np.arange(len(faces.level_m)) if among is None else np.flatnonzero(among)
    found = []
    used = np.concatenate([np.ones((len(met), 1), bool), met >= 0], axis=1)  # leg i ends at bounce i or at the receiver
    for leg in range(met.shape[1] + 1):
        rows = np.flatnonzero(used[:, leg])
        step = max(1, _AT_ONCE // max(len(wanted), 1))
        for first in range(0, len(rows), step):
            part = rows[first : first + step]
            begin, end = points[part, leg], points[part, leg + 1]
            above = begin @ faces.normal[wanted].T - faces.level_m[wanted]
            below = end @ faces.normal[wanted].T - faces.level_m[wanted]
            through = (above * below < 0) & (np.minimum(np.abs(above), np.abs(below)) > _ON_PLANE_M)
            i, j = np.nonzero(through)
            share = above[i, j] / (above[i, j] - below[i, j])
            keep = on_face(faces, wanted[j], begin[i] + share[:, None] * (end[i] - begin[i]))
            found.append((part[i[keep]], np.full(keep.sum(), leg), wanted[j[keep]], share[keep]))
    if not found:
        none = np.zeros(0, np.int64)
        return none, none, none, np.zeros(0)
    return tuple(np.concatenate(column) for column in zip(*found, strict=True))
