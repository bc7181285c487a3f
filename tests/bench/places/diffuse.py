# SPDX-License-Identifier: GPL-3.0-or-later
"""What is no mirror: Lambertian patches with phases of their own, and a body that walks, echoes and casts a shadow."""

import numpy as np
from mirror import crossings
from slabs import C_M_PER_S, slab
from strength import unit

PATCHES = 300  # at most, more or less, of all surfaces that scatter


def scattered(w, faces, media, start, end, send, receive, kept):
    """Echoes of surfaces, [(pair, amplitude, length)]: power S²·R²·cos·cos/π of what falls on each patch, single bounce.

    `kept(name, make)` remembers what a point sees.
    """
    rough = np.nonzero(media["scattering_coefficient"] > 0)[0]
    centre, area, face, phase = _spots(w, faces, rough)
    n = faces.normal[face]

    def sees(point):
        """Signed heights over the spots' planes of a point, 0 where something stands in between."""
        height = ((point - centre) * n).sum(1)
        if not w["refraction"]:
            height[np.isfinite(crossings(faces, np.repeat(point[None], len(centre), 0), centre, None, face)).any(1)] = 0
        return height

    heights = []
    for ends in (start, end):
        points, back = np.unique(ends, axis=0, return_inverse=True)
        each = [kept((rough.tobytes(), w["refraction"], p.tobytes()), lambda p=p: sees(p)) for p in points]
        heights.append(np.array(each)[back])
    pair, spot = np.nonzero(heights[0] * heights[1] > 0)  # both on one side
    go, back, face = centre[spot] - start[pair], end[pair] - centre[spot], face[spot]
    d1, d2 = np.linalg.norm(go, axis=1), np.linalg.norm(back, axis=1)
    c1, c2 = np.abs((go * n[spot]).sum(1)) / d1, np.abs((back * n[spot]).sum(1)) / d2
    numbers = [media[k][face] for k in ("permittivity", "conductivity", "thickness_m")]
    r_te, r_tm, _, _ = slab(*numbers, w["carrier_hz"], c1)
    power = (np.abs(r_te) ** 2 + np.abs(r_tm) ** 2) / 2 * media["scattering_coefficient"][face] ** 2
    size = np.linalg.norm(send(pair, unit(go)), axis=1) * np.linalg.norm(receive(pair, -unit(back)), axis=1)
    a = C_M_PER_S / w["carrier_hz"] / (4 * np.pi) * size * np.sqrt(power * c1 * c2 * area[spot] / np.pi) / (d1 * d2)
    return [(pair, a * phase[spot], d1 + d2)]


def _spots(w, faces, rough):
    """(centre, area, patch, phase factor) of the pieces of rough surfaces."""
    whole = np.linalg.norm(np.cross(faces.u[rough], faces.v[rough]), axis=1)
    side = max(w["patch_m"], float(np.sqrt(whole.sum() / PATCHES)))
    rows = []
    for face, size in zip(rough, whole, strict=True):
        u, v = faces.u[face], faces.v[face]
        nu, nv = (max(1, round(float(np.linalg.norm(x)) / side)) for x in (u, v))
        s, t = (x.ravel() for x in np.meshgrid((np.arange(nu) + 0.5) / nu, (np.arange(nv) + 0.5) / nv, indexing="ij"))
        keep = s + t <= 1 if faces.triangle[face] else np.ones(len(s), bool)
        centre = faces.corner[face] + s[keep, None] * u + t[keep, None] * v
        seed = [w["scatter_seed"], *np.round(np.abs(faces.corner[face]) * 1000).astype(int).tolist(), int(face)]
        phase = np.exp(2j * np.pi * np.random.default_rng(seed).random(len(centre)))
        rows.append((centre, np.full(len(centre), size / (nu * nv)), np.full(len(centre), face), phase))
    return (np.concatenate(x) for x in zip(*rows, strict=True))


def _body(w, time_s):
    body = w["person"]
    return np.asarray(body["position_m"]) + np.asarray(time_s)[:, None] * np.asarray(body["velocity_m_per_s"])


def shadow(w, paths, time_s):
    """Factor of each path: 0 where a leg passes through the walking body, a vertical cylinder."""
    body = w["person"]
    free = np.ones(len(paths.pair))
    if not body:
        return free
    axis = _body(w, time_s)
    for leg in range(paths.points.shape[1] - 1):
        a, step = paths.points[:, leg], paths.points[:, leg + 1] - paths.points[:, leg]
        flat = (step[:, :2] ** 2).sum(1)
        at = np.clip(((axis - a)[:, :2] * step[:, :2]).sum(1) / np.where(flat > 0, flat, 1), 0, 1)
        near = a + at[:, None] * step
        hit = np.linalg.norm((near - axis)[:, :2], axis=1) < body["radius_m"]
        z = near[:, 2] - axis[:, 2]
        free[hit & (z > 0) & (z < body["height_m"])] = 0
    return free


def echo(w, faces, start, end, time_s, send, receive):
    """The body's own echo by the radar equation, from its axis at 0.6 of its height, where nothing stands in between."""
    body = w["person"]
    centre = _body(w, time_s) + [0, 0, body["height_m"] * 0.6]
    free = np.ones(len(start), bool)
    if not w["refraction"]:
        for a, b in ((start, centre), (centre, end)):
            free &= ~np.isfinite(crossings(faces, a, b)).any(1)
    pair = np.nonzero(free)[0]
    go, back = centre[pair] - start[pair], end[pair] - centre[pair]
    d1, d2 = np.linalg.norm(go, axis=1), np.linalg.norm(back, axis=1)
    polar = (send(pair, unit(go)) * receive(pair, -unit(back))).sum(1)
    wave = C_M_PER_S / w["carrier_hz"]
    a = wave * np.sqrt(body["rcs_m2"]) / ((4 * np.pi) ** 1.5 * d1 * d2) * polar
    return [(pair, a.astype(complex), d1 + d2)]
