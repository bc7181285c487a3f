# SPDX-License-Identifier: GPL-3.0-or-later
"""First-order diffraction at edges: the uniform theory (Kouyoumjian & Pathak 1974), with slab coefficients on both faces
(Luebbers 1984; ITU-R P.526 and P.2040-3), shadow and lit side."""

import functools
from dataclasses import dataclass

import numpy as np
from scipy.special import fresnel

from . import fields, images
from .geometry import Solid
from .media import with_losses

_SAME_PLACE, _SAME_SHAPE = 5, 9  # decimals of a metre
_ON_FACE_M = 1e-4  # nearer to a face than this is on it: where two walls meet no edge is free
_TINY = 1e-12
_KEPT, _SMALL = 2048, 200  # objects whose edges are remembered, if they have fewer faces
_AT_ONCE = 2_000_000  # edges times faces in memory at the same time


@dataclass(frozen=True, kw_only=True)
class Edges:
    """Edges (E): from `begin_m` along unit `along` for `length_m`; `face` (E, 3) unit vectors in the 0-face away from the edge,
    `normal` (E, 3) out of it into the air; `n` (E,): the air's angle is n·π; `owner` (E,) index of the object. `lies_on` (C, 2):
    numbers of an edge and of another object on whose face it lies: where that is there, no edge is."""

    begin_m: np.ndarray
    along: np.ndarray
    length_m: np.ndarray
    face: np.ndarray
    normal: np.ndarray
    n: np.ndarray
    owner: np.ndarray
    lies_on: np.ndarray

    def there(self, present: np.ndarray) -> np.ndarray:
        """Numbers of the edges that are free where objects are `present`."""
        free = present[self.owner]
        free[self.lies_on[present[self.lies_on[:, 1]], 0]] = False
        return np.flatnonzero(free)


def edges_of(solids: tuple[Solid, ...], faces: images.Faces) -> Edges:
    """Edges of sheets (n = 2) and outward edges between two faces of hulls."""
    rows = [(*row, index) for index, solid in enumerate(solids) for row in _edges(solid)]
    if not rows:
        none = np.zeros((0, 3))
        return Edges(
            begin_m=none, along=none, length_m=np.zeros(0), face=none, normal=none, n=np.zeros(0), owner=np.zeros(0, int),
            lies_on=np.zeros((0, 2), int),
        )  # fmt: skip
    begin_m, along, length_m, face, normal, n, owner = (np.array(column) for column in zip(*rows, strict=True))
    return Edges(
        begin_m=begin_m, along=along, length_m=length_m, face=face, normal=normal, n=n, owner=owner,
        lies_on=_on_others(begin_m + along * length_m[:, None] / 2, owner, faces),
    )  # fmt: skip


def _edges(solid: Solid) -> list[tuple]:
    """Columns of `Edges` but the last two. A thing that stands elsewhere has the same edges there."""
    if len(solid.faces) >= _SMALL:
        return _found(solid.vertices_m, solid.faces)
    origin_m = solid.vertices_m[0]
    shape = np.round(solid.vertices_m - origin_m, _SAME_SHAPE)
    return [
        (origin_m + begin_m, *rest) for begin_m, *rest in _remembered(shape.tobytes(), np.asarray(solid.faces, int).tobytes())
    ]


@functools.lru_cache(maxsize=_KEPT)
def _remembered(vertices: bytes, faces: bytes) -> list[tuple]:
    return _found(np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(faces, int).reshape(-1, 3))


def _found(vertices_m: np.ndarray, faces: np.ndarray) -> list[tuple]:
    places, same = np.unique(np.round(vertices_m, _SAME_PLACE), axis=0, return_inverse=True)
    corners = same.reshape(-1)[faces]
    shared: dict[tuple[int, int], list[int]] = {}
    for triangle, (a, b, c) in enumerate(corners):
        for edge in ((a, b), (b, c), (c, a)):
            shared.setdefault((min(edge), max(edge)), []).append(triangle)
    out = []
    for (a, b), triangles in shared.items():
        begin, end = places[a], places[b]
        length = float(np.linalg.norm(end - begin))
        if length < 1e-6 or len(triangles) > 2:
            continue
        along = (end - begin) / length
        inward = [_inward(places[corners[t]], begin, along) for t in triangles]
        if len(triangles) == 1:
            out.append((begin, along, length, inward[0], np.cross(along, inward[0]), 2.0))
            continue
        cos = float(np.clip(inward[0] @ inward[1], -1, 1))
        if cos < -1 + 1e-6:  # one plane
            continue
        inner = np.arccos(cos)
        outward = -(inward[0] + inward[1])  # a convex edge: the solid is between the faces
        normal = np.cross(along, inward[0])
        normal = normal if normal @ outward > 0 else -normal
        out.append((begin, along, length, inward[0], normal, 2 - inner / np.pi))
    return out


def _on_others(middle_m: np.ndarray, owner: np.ndarray, faces: images.Faces) -> np.ndarray:
    """(C, 2) edges of `owner` (E,), known by their middles (E, 3), and each other object on whose face they lie."""
    found, step = [], max(1, _AT_ONCE // max(len(faces.level_m), 1))
    for first in range(0, len(owner), step):
        own = slice(first, first + step)
        near = np.abs(middle_m[own] @ faces.normal.T - faces.level_m) < _ON_FACE_M
        edge, face = np.nonzero(near & (faces.owner != owner[own, None]))
        on = images.on_face(faces, face, middle_m[own][edge])
        found.append(np.column_stack([first + edge[on], faces.owner[face[on]]]))
    return np.unique(np.concatenate(found), axis=0)


def _inward(triangle_m: np.ndarray, begin: np.ndarray, along: np.ndarray) -> np.ndarray:
    away = triangle_m - begin
    away = away - (away @ along)[:, None] * along
    farthest = away[np.argmax((away**2).sum(axis=1))]
    return farthest / np.linalg.norm(farthest)


def transition(x: np.ndarray) -> np.ndarray:
    """F(x) = 2j√x·exp(jx)·∫_{√x}^∞ exp(−jτ²)dτ (Kouyoumjian & Pathak, equation 25)."""
    root = np.sqrt(x)
    s, c = fresnel(np.sqrt(2 / np.pi) * root)
    tail = np.sqrt(np.pi / 2) * ((0.5 - c) - 1j * (0.5 - s))
    return 2j * root * np.exp(1j * x) * tail


def coefficient(n, k, distance, sin_beta, phi_in, phi_out, r0, rn) -> np.ndarray:
    """D (…, n) of polarisations; `r0`, `rn` (…, n): reflection of both faces; `distance` (n,): s·s'/(s + s')·sin²β."""
    sign, apart, both = np.array([1, -1, -1, 1])[:, None], phi_out - phi_in, phi_out + phi_in
    beta = np.stack([apart, apart, both, both])
    turns = np.round((beta + sign * np.pi) / (2 * np.pi * n))
    a = 2 * np.cos((2 * np.pi * n * turns - beta) / 2) ** 2
    angle = (np.pi + sign * beta) / (2 * n)
    sine = np.sin(angle)
    near = np.abs(sine) < 1e-7
    limit = n * np.exp(1j * np.pi / 4) * np.sqrt(2 * np.pi * k * distance)  # on a shadow boundary
    term = np.where(near, limit, np.cos(angle) / np.where(near, 1.0, sine) * transition(k * distance * a))
    out = term[0] + term[1] + r0 * term[2] + rn * term[3]
    return -np.exp(-1j * np.pi / 4) / (2 * n * np.sqrt(2 * np.pi * k) * sin_beta) * out


def paths(edges: Edges, faces, surface, carrier_hz: float, tx_m: np.ndarray, rx_m: np.ndarray, send, take):
    """Number i, gain, length and edge of every diffracted path (n,) from point i of `tx_m` to point i of `rx_m` (P, 3).

    `send(i, direction)` and `take(i, direction)` give the antennas' fields (n, 3) along directions (n, 3) away from them.
    """
    wavelength_m = fields.SPEED_OF_LIGHT_M_PER_S / carrier_hz
    keep = edges.there(surface.present)
    a, b = (ends_m[:, None] - edges.begin_m[keep] for ends_m in (tx_m, rx_m))
    unit = edges.along[keep]
    za, zb = (np.einsum("pej,ej->pe", v, unit) for v in (a, b))
    ra, rb = (np.sqrt(np.einsum("pej,pej->pe", away, away)) for away in (v - z[:, :, None] * unit for v, z in ((a, za), (b, zb))))
    z = za + (zb - za) * ra / np.maximum(ra + rb, _TINY)  # Fermat: both angles with the edge are the same
    row, edge = np.nonzero((z > 0) & (z < edges.length_m[keep]) & (ra > 1e-4) & (rb > 1e-4))
    z, edge = z[row, edge], keep[edge]
    along = edges.along[edge]
    point_m = edges.begin_m[edge] + z[:, None] * along
    first, second = point_m - tx_m[row], rx_m[row] - point_m
    s_in, s_out = np.linalg.norm(first, axis=1), np.linalg.norm(second, axis=1)
    first, second = first / s_in[:, None], second / s_out[:, None]
    phi_in, phi_out = (_angle(edges, edge, v) for v in (-first, second))
    limit = edges.n[edge] * np.pi
    free = (phi_in > 1e-6) & (phi_in < limit - 1e-6) & (phi_out > 1e-6) & (phi_out < limit - 1e-6)
    at = np.flatnonzero(free)
    points = np.stack([tx_m[row[at]], point_m[at], rx_m[row[at]]], axis=1)
    solid = (surface.present & ~surface.clear)[faces.owner]
    path, leg, _, share = images.crossings(faces, points, np.zeros((len(at), 1), np.int64), solid)
    beyond_m = np.where(leg == 0, (1 - share) * s_in[at[path]], share * s_out[at[path]])
    free[at[path[beyond_m > _ON_FACE_M]]] = False  # nearer are the faces that meet in the edge
    row, edge, along, first, second, s_in, s_out, phi_in, phi_out = (
        v[free] for v in (row, edge, along, first, second, s_in, s_out, phi_in, phi_out)
    )
    sin_beta = np.maximum(np.linalg.norm(fields.cross(first, along), axis=1), 1e-6)
    k, n = 2 * np.pi / wavelength_m, edges.n[edge]
    eta = with_losses(surface.permittivity, surface.conductivity, fields.SPEED_OF_LIGHT_M_PER_S / wavelength_m)
    owner = edges.owner[edge]
    # Angles of incidence on both faces (Luebbers): from the nearer of both rays.
    graze0, grazen = np.minimum(phi_in, phi_out), np.minimum(n * np.pi - phi_in, n * np.pi - phi_out)
    coefficients = []
    for graze in (graze0, grazen):
        cos_in = np.clip(np.abs(np.sin(graze)) * sin_beta, 1e-9, 1)
        coefficients.append(np.stack(fields.slab(eta[owner], surface.thickness_m[owner], cos_in, wavelength_m)[:2]))
    distance = s_in * s_out / (s_in + s_out) * sin_beta**2
    soft, hard = coefficient(n, k, distance, sin_beta, phi_in, phi_out, *coefficients)
    # Edge-fixed axes: φ across edge and ray, β completes them; soft: the field along β.
    phi_a = -fields.cross(along, first) / sin_beta[:, None]
    phi_b = fields.cross(along, second) / sin_beta[:, None]
    beta_a, beta_b = fields.cross(phi_a, first), fields.cross(phi_b, second)
    sent, taken = send(row, first), take(row, -second)
    dot = lambda u, v: np.einsum("ij,ij->i", u, v)  # noqa: E731
    field = -soft * dot(sent, beta_a) * dot(taken, beta_b) - hard * dot(sent, phi_a) * dot(taken, phi_b)
    spread = np.sqrt(1 / (s_in * s_out * (s_in + s_out)))
    return row, wavelength_m / (4 * np.pi) * spread * field, s_in + s_out, edge


def _angle(edges: Edges, edge: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Angle round the edge from the 0-face through the air, 0 to 2π."""
    x = np.einsum("ij,ij->i", direction, edges.face[edge])
    y = np.einsum("ij,ij->i", direction, edges.normal[edge])
    return np.mod(np.arctan2(y, x), 2 * np.pi)
