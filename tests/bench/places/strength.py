# SPDX-License-Identifier: GPL-3.0-or-later
"""Complex amplitudes of paths: antennas, spreading, slabs that reflect and slabs that are crossed."""

import numpy as np
from mirror import crossings
from slabs import C_M_PER_S, slab


def cross(a, b):
    """As numpy's, of rows of three, in a fraction of its time."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], 1)


def unit(x):
    return x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-300)


def _frame(direction, normal):
    """Transverse electric direction and cosine of incidence."""
    te = cross(direction, normal)
    head_on = np.abs(te).max(1, initial=0) < 1e-9
    if head_on.any():
        k = direction[head_on]
        te[head_on] = cross(k, np.where(np.abs(k[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    return unit(te), np.abs((direction * normal).sum(1))


def reflected(e, k_in, k_out, normal, media, face, carrier_hz):
    """Field after a reflection, roughness and what scattering takes included."""
    te, cosine = _frame(k_in, normal)
    r_te, r_tm, _, _ = slab(
        media["permittivity"][face], media["conductivity"][face], media["thickness_m"][face], carrier_hz, cosine
    )
    rough = np.exp(-8 * (np.pi * media["height_rms_m"][face] * cosine * carrier_hz / C_M_PER_S) ** 2)
    left = rough * np.sqrt(1 - media["scattering_coefficient"][face] ** 2)
    tm_in, tm_out = cross(te, k_in), cross(te, k_out)
    along_te, along_tm = (e * te).sum(1) * r_te, (e * tm_in).sum(1) * r_tm
    return left[:, None] * (along_te[:, None] * te + along_tm[:, None] * tm_out)


def crossed(e, start, end, skip_start, skip_end, faces, media, carrier_hz):
    """Field after every slab that a leg crosses, in their order."""
    share = crossings(faces, start, end, skip_start, skip_end)
    order = np.argsort(share, axis=1)
    k = unit(end - start)
    for c in range(share.shape[1]):
        face = order[:, c]
        row = np.nonzero(np.isfinite(share[np.arange(len(face)), face]))[0]
        if not len(row):
            break
        face = face[row]
        te, cosine = _frame(k[row], faces.normal[face])
        _, _, t_te, t_tm = slab(
            media["permittivity"][face], media["conductivity"][face], media["thickness_m"][face], carrier_hz, cosine
        )
        tm = cross(te, k[row])
        e[row] = ((e[row] * te).sum(1) * t_te)[:, None] * te + ((e[row] * tm).sum(1) * t_tm)[:, None] * tm
    return e


def amplitudes(paths, faces, media, carrier_hz, sent, received, through):
    """(amplitude, length in m) of paths of one order; `sent`, `received`: fields (M, 3) of the antennas along them."""
    points, order = paths.points, paths.faces.shape[1]
    legs = np.diff(points, axis=1)
    length = np.linalg.norm(legs, axis=2).sum(1)
    k, e, normal = unit(legs), sent.astype(complex), faces.normal
    none = np.full(len(length), -1)
    for leg in range(order + 1):
        if through and len(faces.owner):
            before = paths.faces[:, leg - 1] if leg else none
            after = paths.faces[:, leg] if leg < order else none
            e = crossed(e, points[:, leg], points[:, leg + 1], before, after, faces, media, carrier_hz)
        if leg < order:
            f = paths.faces[:, leg]
            e = reflected(e, k[:, leg], k[:, leg + 1], normal[f], media, f, carrier_hz)
    return C_M_PER_S / carrier_hz / (4 * np.pi * length) * (e * received).sum(1), length
