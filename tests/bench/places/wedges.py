# SPDX-License-Identifier: GPL-3.0-or-later
"""First-order diffraction at edges: the uniform theory of Kouyoumjian and Pathak, faces weighted by slab coefficients.

D = −e^{−jπ/4} / (2n √(2πk) sin β) · [D1 + D2 + R_0·D3 + R_n·D4], each a cotangent times a Fresnel transition function (Luebbers'
heuristic with the faces' coefficients one by one). Edges of sheets are wedges of no angle, n = 2;
edges of closed boxes have n = 3/2.
"""

import numpy as np
from mirror import crossings
from scipy.special import fresnel
from slabs import C_M_PER_S, slab
from strength import unit


def edges(faces):
    """(start, along, face 0, face n or −1) of every edge: one face of a sheet, two of a box; edges on another thing are none."""
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
        rows.append((a, b - a, mine[0], mine[1] if len(mine) == 2 else -1))
    return rows


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


def diffracted(faces, media, carrier_hz, start, end, send, receive, through):
    """[(pair, amplitude, length)] of every edge."""
    parts = []
    k = 2 * np.pi * carrier_hz / C_M_PER_S
    for origin, along, f0, fn in edges(faces):
        axis = along / np.linalg.norm(along)
        za, zb = (start - origin) @ axis, (end - origin) @ axis
        ra = np.linalg.norm(start - origin - za[:, None] * axis, axis=1)
        rb = np.linalg.norm(end - origin - zb[:, None] * axis, axis=1)
        z = (za * rb + zb * ra) / (ra + rb)  # Fermat: equal angles to the edge
        pair = np.nonzero((z > 0) & (z < np.linalg.norm(along)) & (ra > 1e-3) & (rb > 1e-3))[0]
        spot = origin + z[pair, None] * axis
        if not through:
            for ends in (start, end):
                share = crossings(faces, ends[pair], spot)
                share[:, [f for f in (f0, fn) if f >= 0]] = np.inf
                free = ~np.isfinite(share).any(1)
                pair, spot = pair[free], spot[free]
        if not len(pair):
            continue
        parts.append(_edge(faces, media, carrier_hz, k, axis, f0, fn, spot, pair, start, end, send, receive))
    return [p for p in parts if len(p[0])]


def _edge(faces, media, carrier_hz, k, axis, f0, fn, spot, pair, start, end, send, receive):
    inward, outward = spot - start[pair], end[pair] - spot
    s1, s2 = np.linalg.norm(inward, axis=1), np.linalg.norm(outward, axis=1)
    ki, ko = unit(inward), unit(outward)
    n0 = faces.normal[f0]
    centre = faces.corner[f0] + (faces.u[f0] + faces.v[f0]) / 2
    t0 = centre - spot[0]
    t0 = unit(t0 - (t0 @ axis) * axis)  # from the edge into face 0
    n = 2.0
    if fn >= 0:
        tn = faces.corner[fn] + (faces.u[fn] + faces.v[fn]) / 2 - spot[0]
        tn = unit(tn - (tn @ axis) * axis)
        inside = np.arccos(np.clip(t0 @ tn, -1, 1))
        n = (2 * np.pi - inside) / np.pi
        if n0 @ tn > 0:
            n0 = -n0  # points out of the wedge
    phi_i = np.arctan2(-(ki @ n0), -(ki @ t0)) % (2 * np.pi)
    phi_o = np.arctan2(ko @ n0, ko @ t0) % (2 * np.pi)
    ok = (phi_i <= n * np.pi) & (phi_o <= n * np.pi)
    sin_b = np.maximum(np.linalg.norm(np.cross(ki, axis), axis=1), 1e-6)
    k_length = k * s1 * s2 / (s1 + s2) * sin_b**2
    r0 = _face(media, f0, carrier_hz, np.abs(np.sin(phi_i)) * sin_b)
    rn = _face(media, fn if fn >= 0 else f0, carrier_hz, np.abs(np.sin(n * np.pi - phi_o)) * sin_b)
    less, more = phi_o - phi_i, phi_o + phi_i
    d1, d2 = _term(n, k_length, less, 1), _term(n, k_length, less, -1)
    d3, d4 = _term(n, k_length, more, -1), _term(n, k_length, more, 1)
    scale = -np.exp(-1j * np.pi / 4) / (2 * n * np.sqrt(2 * np.pi * k) * sin_b)
    soft, hard = (scale * (d1 + d2 + a * d3 + b * d4) for a, b in ((r0[0], rn[0]), (r0[1], rn[1])))
    spread = np.sqrt(s1 * s2 / (s1 + s2)) / (s1 * s2)
    across_i, across_o = unit(np.cross(axis, ki)), unit(np.cross(axis, ko))
    beta_i, beta_o = np.cross(across_i, ki), np.cross(across_o, ko)
    e = send(pair, ki)
    out = -((e * beta_i).sum(1) * soft)[:, None] * -beta_o + ((e * across_i).sum(1) * hard)[:, None] * across_o
    a = C_M_PER_S / carrier_hz / (4 * np.pi) * spread * (out * receive(pair, -ko)).sum(1)
    return pair[ok], a[ok], (s1 + s2)[ok]


def _face(media, face, carrier_hz, cosine):
    """(soft, hard) reflection of a slab for a wave at this angle to it."""
    numbers = [media[k][face] for k in ("permittivity", "conductivity", "thickness_m")]
    r_te, r_tm, _, _ = slab(*numbers, carrier_hz, np.clip(cosine, 1e-6, 1))
    return r_te, r_tm
