# SPDX-License-Identifier: GPL-3.0-or-later
"""First-order diffraction at edges: the uniform theory of Kouyoumjian and Pathak, faces weighted by slab coefficients.

D = −e^{−jπ/4} / (2n √(2πk) sin β) · [D1 + D2 + R_0·D3 + R_n·D4], each a cotangent times a Fresnel transition function (Luebbers'
heuristic with the faces' coefficients one by one). Edges of sheets are wedges of no angle, n = 2;
edges of closed boxes have n = 3/2.
"""

from dataclasses import dataclass

import numpy as np
from mirror import crossings
from scipy.special import fresnel
from slabs import C_M_PER_S, slab
from strength import cross, unit


@dataclass(frozen=True, kw_only=True)
class Edges:
    """Edges of one face (a sheet's) or two (a box's), as arrays of one length."""

    origin: np.ndarray  # (E, 3)
    along: np.ndarray  # (E, 3), its length too
    face0: np.ndarray  # (E,) patch
    face_n: np.ndarray  # (E,) patch, −1 for a sheet
    into0: np.ndarray  # (E, 3) unit, from the edge into face 0
    normal0: np.ndarray  # (E, 3) of face 0, out of the wedge
    n: np.ndarray  # (E,) outer angle over π


def edges(faces):
    """Every edge but those that lie on another thing."""
    found = {}
    for f in range(len(faces.owner)):
        c, u, v = faces.corner[f], faces.u[f], faces.v[f]
        ring = [c, c + u, c + v] if faces.triangle[f] else [c, c + u, c + u + v, c + v]
        for a, b in zip(ring, ring[1:] + ring[:1], strict=True):
            key = (int(faces.owner[f]), *sorted((tuple(np.round(a, 6)), tuple(np.round(b, 6)))))
            found.setdefault(key, (a, b, []))[2].append(f)
    rows = []
    for (owner, *_), (a, b, mine) in found.items():
        if len(mine) > 2 or not _free(faces, owner, (a + b) / 2):
            continue
        if len(mine) == 2 and np.linalg.norm(np.cross(faces.normal[mine[0]], faces.normal[mine[1]])) < 1e-6:
            continue  # halves of one flat face
        normal, n, axis = faces.normal[mine[0]], 2.0, (b - a) / np.linalg.norm(b - a)
        into = [_into(faces, f, a, axis) for f in mine]
        if len(mine) == 2:
            n = 2 - np.arccos(np.clip(into[0] @ into[1], -1, 1)) / np.pi
            normal = -normal if normal @ into[1] > 0 else normal
        rows.append((a, b - a, mine[0], mine[1] if len(mine) == 2 else -1, into[0], normal, n))
    names = ("origin", "along", "face0", "face_n", "into0", "normal0", "n")
    return Edges(**{k: np.array(x) for k, x in zip(names, zip(*rows, strict=True), strict=True)}) if rows else None


def _into(faces, face, point, axis):
    middle = faces.corner[face] + (faces.u[face] + faces.v[face]) / (3 if faces.triangle[face] else 2) - point
    return unit(middle - (middle @ axis) * axis)


def _free(faces, owner, point):
    """Whether no other object's patch holds a point of the edge."""
    height = np.abs(((point - faces.corner) * faces.normal).sum(1))
    others = np.nonzero((faces.owner != owner) & (height < 1e-4))[0]
    return not len(others) or not faces.inside(others, np.repeat(point[None], len(others), 0)).any()


def transition(x):
    """Fresnel transition function F(x) = 2j √x e^{jx} ∫_√x^∞ e^{−jτ²} dτ."""
    root = np.sqrt(np.maximum(x, 0))
    s, c = fresnel(root * np.sqrt(2 / np.pi))
    tail = np.sqrt(np.pi / 2) * ((0.5 - c) - 1j * (0.5 - s))
    return 2j * root * np.exp(1j * x) * tail


def _term(n, k_length, beta, sign):
    """cot((π ± β)/2n)·F(kL a±(β)), finite at the shadow boundaries."""
    whole = np.round((beta + sign * np.pi) / (2 * np.pi * n))
    gap = 2 * np.pi * n * whole - beta
    a = 2 * np.cos(gap / 2) ** 2
    angle = (np.pi + sign * beta) / (2 * n)
    sine = np.sin(angle)
    near = np.abs(sine) < 1e-6
    angle = np.where(near, 1e-6, angle)
    return np.cos(angle) / np.sin(angle) * transition(k_length * np.maximum(a, 1e-12))


def diffracted(faces, all_edges, media, carrier_hz, start, end, send, receive, through):
    """[(pair, amplitude, length)] of every pair by every edge that both its ends see."""
    if all_edges is None:
        return []
    length = np.linalg.norm(all_edges.along, axis=1)
    axis = all_edges.along / length[:, None]
    za, zb = ((x[:, None] - all_edges.origin) * axis for x in (start, end))
    za, zb = za.sum(2), zb.sum(2)
    ra, rb = (np.linalg.norm(x[:, None] - all_edges.origin - z[..., None] * axis, axis=2) for x, z in ((start, za), (end, zb)))
    z = (za * rb + zb * ra) / (ra + rb)  # Fermat: equal angles to the edge
    pair, edge = np.nonzero((z > 0) & (z < length) & (ra > 1e-3) & (rb > 1e-3))
    spot = all_edges.origin[edge] + z[pair, edge][:, None] * axis[edge]
    for ends in (start, end) if not through else ():
        share = crossings(faces, ends[pair], spot, all_edges.face0[edge], all_edges.face_n[edge])
        free = ~np.isfinite(share).any(1)
        pair, edge, spot = pair[free], edge[free], spot[free]
    if not len(pair):
        return []
    return [_bent(all_edges, media, carrier_hz, axis, edge, spot, pair, start, end, send, receive)]


def _bent(all_edges, media, carrier_hz, axes, edge, spot, pair, start, end, send, receive):
    inward, outward, axis = spot - start[pair], end[pair] - spot, axes[edge]
    s1, s2 = np.linalg.norm(inward, axis=1), np.linalg.norm(outward, axis=1)
    ki, ko = unit(inward), unit(outward)
    normal, into, n = all_edges.normal0[edge], all_edges.into0[edge], all_edges.n[edge]
    phi_i = np.arctan2(-(ki * normal).sum(1), -(ki * into).sum(1)) % (2 * np.pi)
    phi_o = np.arctan2((ko * normal).sum(1), (ko * into).sum(1)) % (2 * np.pi)
    ok = (phi_i <= n * np.pi) & (phi_o <= n * np.pi)
    k = 2 * np.pi * carrier_hz / C_M_PER_S
    sin_b = np.maximum(np.linalg.norm(cross(ki, axis), axis=1), 1e-6)
    k_length = k * s1 * s2 / (s1 + s2) * sin_b**2
    face_n = np.where(all_edges.face_n >= 0, all_edges.face_n, all_edges.face0)[edge]
    r0 = _face(media, all_edges.face0[edge], carrier_hz, np.abs(np.sin(phi_i)) * sin_b)
    rn = _face(media, face_n, carrier_hz, np.abs(np.sin(n * np.pi - phi_o)) * sin_b)
    less, more = phi_o - phi_i, phi_o + phi_i
    d1, d2 = _term(n, k_length, less, 1), _term(n, k_length, less, -1)
    d3, d4 = _term(n, k_length, more, -1), _term(n, k_length, more, 1)
    scale = -np.exp(-1j * np.pi / 4) / (2 * n * np.sqrt(2 * np.pi * k) * sin_b)
    soft, hard = (scale * (d1 + d2 + a * d3 + b * d4) for a, b in ((r0[0], rn[0]), (r0[1], rn[1])))
    spread = np.sqrt(s1 * s2 / (s1 + s2)) / (s1 * s2)
    across_i, across_o = unit(cross(axis, ki)), unit(cross(axis, ko))
    beta_i, beta_o = cross(across_i, ki), cross(across_o, ko)
    e = send(pair, ki)
    out = ((e * beta_i).sum(1) * soft)[:, None] * beta_o + ((e * across_i).sum(1) * hard)[:, None] * across_o
    a = C_M_PER_S / carrier_hz / (4 * np.pi) * spread * (out * receive(pair, -ko)).sum(1)
    return pair[ok], a[ok], (s1 + s2)[ok]


def _face(media, face, carrier_hz, cosine):
    """(soft, hard) reflection of a slab for a wave at this angle to it."""
    numbers = [media[k][face] for k in ("permittivity", "conductivity", "thickness_m")]
    r_te, r_tm, _, _ = slab(*numbers, carrier_hz, np.clip(cosine, 1e-6, 1))
    return r_te, r_tm
