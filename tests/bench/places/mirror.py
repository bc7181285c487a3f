# SPDX-License-Identifier: GPL-3.0-or-later
"""The image method: every specular path between pairs of points over flat patches, and what stands in the way.

A patch is a parallelogram (corner + s·u + t·v, 0 ≤ s, t ≤ 1) or a triangle (s + t ≤ 1 as well).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

NEAR = 1e-9  # of a leg: where a crossing is the leg's own end


@dataclass(frozen=True, kw_only=True, eq=False)
class Patches:
    corner: np.ndarray  # (F, 3)
    u: np.ndarray
    v: np.ndarray
    triangle: np.ndarray  # (F,) bool
    owner: np.ndarray  # (F,) index of the object
    closed: np.ndarray  # (F,) bool: a side of a closed box, whose inside lies behind it

    @cached_property
    def normal(self):
        n = np.cross(self.u, self.v)
        return n / np.linalg.norm(n, axis=1, keepdims=True)

    def inside(self, index, points):
        """Whether points, known to lie in the planes of patches `index`, lie in the patches."""
        u, v, w = self.u[index], self.v[index], points - self.corner[index]
        uu, uv, vv = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
        wu, wv = (w * u).sum(-1), (w * v).sum(-1)
        area = uu * vv - uv**2
        s, t = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
        return (s >= 0) & (t >= 0) & np.where(self.triangle[index], s + t <= 1, (s <= 1) & (t <= 1))


def patches(objects):
    """Patches of {name: triangles (N, 3, 3)}: two triangles of one parallelogram become one patch."""
    rows = []
    for owner, tris in enumerate(objects.values()):
        tris, closed = np.asarray(tris, float), _closed(np.asarray(tris, float))
        left = list(range(len(tris)))
        while left:
            first = tris[left.pop(0)]
            for k in left:
                merged = _parallelogram(first, tris[k])
                if merged is not None:
                    left.remove(k)
                    break
            else:
                merged = (first[0], first[1] - first[0], first[2] - first[0], True)
            corner, u, v, triangle = merged
            if closed and np.cross(u, v) @ (corner + (u + v) / 2 - tris.reshape(-1, 3).mean(0)) < 0:
                u, v = v, u  # normals of closed boxes point out of them
            rows.append((corner, u, v, triangle, owner, closed))
    if not rows:
        none = np.zeros((0, 3))
        return Patches(corner=none, u=none, v=none, triangle=np.zeros(0, bool), owner=np.zeros(0, int), closed=np.zeros(0, bool))
    corner, u, v, triangle, owner, closed = (np.array(x) for x in zip(*rows, strict=True))
    return Patches(corner=corner, u=u, v=v, triangle=triangle, owner=owner, closed=closed)


def _closed(tris):
    """A convex body without holes: every edge in two triangles, all corners behind every face."""
    keys = np.round(tris, 6)
    edges = {}
    for t in keys:
        for a, b in ((0, 1), (1, 2), (2, 0)):
            edge = tuple(sorted((tuple(t[a]), tuple(t[b]))))
            edges[edge] = edges.get(edge, 0) + 1
    if len(tris) < 4 or set(edges.values()) != {2}:
        return False
    normal = np.cross(tris[:, 1] - tris[:, 0], tris[:, 2] - tris[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = np.einsum("fi,fpi->fp", normal, tris.reshape(1, -1, 3) - tris[:, :1])
    return bool(((height < 1e-6).all(1) | (height > -1e-6).all(1)).all())


def _parallelogram(a, b):
    """(corner, u, v, False) of two triangles that halve a parallelogram, else None."""
    shared = [i for i in range(3) if np.abs(b - a[i]).sum(1).min() < 1e-7]
    if len(shared) != 2:
        return None
    apex = ({0, 1, 2} - set(shared)).pop()
    other = max(range(3), key=lambda k: min(np.abs(b[k] - a[i]).sum() for i in shared))
    p, q = a[shared[0]], a[shared[1]]
    if np.abs(a[apex] + b[other] - p - q).max() > 1e-6 * (1 + np.abs(p).max()):
        return None
    return a[apex], p - a[apex], q - a[apex], False


def crossings(faces, start, end, skip_start=None, skip_end=None):
    """(M, F): at which share of each leg it pierces each patch, inf where it does not.

    `skip_start`, `skip_end`: per leg the patch that its end lies on, -1 for none.
    """
    n = faces.normal
    offset = (n * faces.corner).sum(1)
    a, b = start @ n.T - offset, end @ n.T - offset
    candidate = (a * b < 0) & np.isfinite(a * b)
    rows = np.arange(len(start))
    for skip in (skip_start, skip_end):
        if skip is not None and faces.normal.size:
            candidate[rows[skip >= 0], skip[skip >= 0]] = False
    share = np.full(candidate.shape, np.inf)
    leg, face = np.nonzero(candidate)
    at = a[leg, face] / (a[leg, face] - b[leg, face])
    ok = (at > NEAR) & (at < 1 - NEAR)
    leg, face, at = leg[ok], face[ok], at[ok]
    ok = faces.inside(face, start[leg] + at[:, None] * (end[leg] - start[leg]))
    share[leg[ok], face[ok]] = at[ok]
    return share


@dataclass(frozen=True, kw_only=True)
class Paths:
    """Paths of one order between many pairs: of which pair, over which patches, through which points."""

    pair: np.ndarray  # (M,)
    faces: np.ndarray  # (M, order)
    points: np.ndarray  # (M, order + 2, 3)


def specular(faces, start, end, depth, through=False, budget=300_000):
    """Paths of each order 0 … depth between pairs start (N, 3) and end (N, 3); legs blocked by any patch unless `through`."""
    n = faces.normal
    offset = (n * faces.corner).sum(1)
    sees = _sees(faces, n, offset)
    blind = faces.closed & (not through)  # nothing is reflected inside a closed box
    sees[0, blind] = False
    found = []
    for order in range(depth + 1 if len(n) else 1):
        sequences = max(1, len(n) ** order)
        step = max(1, budget // sequences)
        parts = [
            _of_order(faces, n, offset, sees, blind, start[k : k + step], end[k : k + step], order, k)
            for k in range(0, len(start), step)
        ]
        paths = Paths(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in ("pair", "faces", "points")})
        found.append(paths if through else _free(faces, paths))
    return found


def _sees(faces, n, offset):
    """(2, F, F): whether face j has a corner on the back (0) or front (1) of face i."""
    corners = np.stack([faces.corner, faces.corner + faces.u, faces.corner + faces.v, faces.corner + faces.u + faces.v], 1)
    corners[faces.triangle, 3] = corners[faces.triangle, 0]
    height = np.einsum("id,jcd->ijc", n, corners) - offset[:, None, None]
    return np.stack([(height < -1e-7).any(2), (height > 1e-7).any(2)])


def _of_order(faces, n, offset, sees, blind, start, end, order, first):
    rows = np.arange(len(start))
    if order == 0:
        return Paths(pair=rows + first, faces=np.zeros((len(rows), 0), int), points=np.stack([start, end], 1))
    front_start, front_end = ((x @ n.T > offset).astype(int) for x in (start, end))
    index = np.arange(len(n))
    if order == 1:
        hidden = blind[None] & (front_start == 0)
        chosen = np.nonzero((front_start == front_end) & ~hidden)
    else:
        lead = sees[front_start, index]  # (N, i, j): j before i, on the start's side of it
        tail = sees[front_end, index].transpose(0, 2, 1)  # (N, before, last)
        if order == 2:
            chosen = np.nonzero(lead & tail)
        else:
            chosen = np.nonzero(lead[:, :, :, None] & tail[:, None] & _same_side(sees)[None])
    return _through_images(faces, n, offset, start, end, chosen[0], np.stack(chosen[1:], 1), first)


def _same_side(sees):
    """(i, j, k): i and k have corners on one side of j."""
    back, front = sees
    return (back.T[:, :, None] & back[None]) | (front.T[:, :, None] & front[None])


def _through_images(faces, n, offset, start, end, pair, sequence, first):
    """Of candidate sequences those whose points all lie in their patches."""
    order = sequence.shape[1]
    images = [start[pair]]
    for k in range(order):
        f = sequence[:, k]
        images.append(images[-1] - 2 * ((images[-1] * n[f]).sum(1) - offset[f])[:, None] * n[f])
    to, keep, points = end[pair], np.arange(len(pair)), [end[pair]]
    for k in range(order - 1, -1, -1):
        f, image = sequence[keep, k], images[k + 1][keep]
        a, b = (image * n[f]).sum(1) - offset[f], (to * n[f]).sum(1) - offset[f]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = a / (a - b)
        ok = (a * b < 0) & np.isfinite(at)
        hit = image + np.where(ok, at, 0)[:, None] * (to - image)
        ok &= faces.inside(f, hit)
        keep, to = keep[ok], hit[ok]
        points = [p[ok] for p in points] + [hit[ok]]
    points = np.stack([*points, start[pair[keep]]][::-1], 1)
    return Paths(pair=pair[keep] + first, faces=sequence[keep], points=points)


def _free(faces, paths):
    """Paths without those of which a leg is blocked."""
    ok = np.ones(len(paths.pair), bool)
    order = paths.faces.shape[1]
    none = np.full(len(ok), -1)
    for leg in range(order + 1):
        left = np.nonzero(ok)[0]
        if not len(left):
            break
        on_start = paths.faces[:, leg - 1] if leg else none
        on_end = paths.faces[:, leg] if leg < order else none
        share = crossings(faces, paths.points[left, leg], paths.points[left, leg + 1], on_start[left], on_end[left])
        ok[left] = ~np.isfinite(share).any(1)
    return Paths(pair=paths.pair[ok], faces=paths.faces[ok], points=paths.points[ok])
