# SPDX-License-Identifier: GPL-3.0-or-later
"""Diffuse scattering: every face as patches that scatter by Lambert's law, each with a phase of its own (Degli-Esposti 2007)."""

from dataclasses import dataclass

import numpy as np

from . import fields, images
from .media import with_losses

PATCH_M = 0.5  # side of a patch
MOST_PATCHES = 1500  # of a place: beyond, patches are larger
_LARGEST_M = 500.0  # of a face: grounds without an end are not cut up


def patches_of(faces: images.Faces) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middles (n, 3), areas in m² (n,) and faces (n,) of the patches of all faces."""
    sides = np.linalg.norm(np.ptp(faces.triangles_m, axis=1), axis=1)
    area = faces.triangle_areas_m2
    small = sides < _LARGEST_M
    step_m = max(PATCH_M, float(np.sqrt(area[small].sum() / MOST_PATCHES)))
    middle, size, owner = [np.zeros((0, 3))], [np.zeros(0)], [np.zeros(0, int)]
    face_of = np.repeat(np.arange(len(faces.level_m)), np.diff(faces.start))
    for triangle in np.flatnonzero(small):
        a, b, c = faces.triangles_m[triangle]
        cuts = max(1, int(np.ceil(np.sqrt(2 * area[triangle]) / step_m)))
        i, j = (grid.ravel() for grid in np.meshgrid(np.arange(cuts), np.arange(cuts), indexing="ij"))
        up, down = i + j < cuts, i + j < cuts - 1
        u = np.concatenate([(i[up] + 1 / 3) / cuts, (i[down] + 2 / 3) / cuts])
        v = np.concatenate([(j[up] + 1 / 3) / cuts, (j[down] + 2 / 3) / cuts])
        middle.append(a + u[:, None] * (b - a) + v[:, None] * (c - a))
        size.append(np.full(len(u), area[triangle] / cuts**2))
        owner.append(np.full(len(u), face_of[triangle]))
    return np.concatenate(middle), np.concatenate(size), np.concatenate(owner)


@dataclass(frozen=True, kw_only=True)
class Seen:
    """Patches (n) that both ends see: power gain over S²·(λ/4π)² of perfect mirrors between isotropic antennas, cosine of
    incidence, length in m of the way over it, object, and unit directions (n, 3) to it and on from it."""

    power: np.ndarray
    cos_in: np.ndarray
    length_m: np.ndarray
    owner: np.ndarray
    first: np.ndarray
    second: np.ndarray


def seen(patches, faces, surface, tx_m: np.ndarray, rx_m: np.ndarray) -> Seen:
    """What `patches` of the faces may scatter from one point to another (Degli-Esposti 2007, Lambert's law)."""
    middle_m, area, face = patches
    keep = surface.present[faces.owner[face]]
    middle_m, area, face = middle_m[keep], area[keep], face[keep]
    first, second = middle_m - tx_m, rx_m - middle_m
    d_in, d_out = np.linalg.norm(first, axis=1), np.linalg.norm(second, axis=1)
    first, second = first / d_in[:, None], second / d_out[:, None]
    normal = faces.normal[face]
    cos_in, cos_out = -np.einsum("ij,ij->i", first, normal), np.einsum("ij,ij->i", second, normal)
    lit = (cos_in * cos_out > 0) & (~faces.sided[face] | (cos_in > 0))
    at = np.flatnonzero(lit)
    points = np.stack([np.broadcast_to(tx_m, (len(at), 3)), middle_m[at], np.broadcast_to(rx_m, (len(at), 3))], axis=1)
    shut = (surface.present & ~surface.clear)[faces.owner]
    path, *_ = images.crossings(faces, points, np.zeros((len(at), 1), np.int64), shut)
    lit[at[path]] = False
    area, face, d_in, d_out, cos_in, cos_out = (v[lit] for v in (area, face, d_in, d_out, np.abs(cos_in), np.abs(cos_out)))
    power = cos_in * cos_out * area / np.pi / (d_in * d_out) ** 2
    return Seen(
        power=power, cos_in=cos_in, length_m=d_in + d_out, owner=faces.owner[face], first=first[lit], second=second[lit]
    )  # fmt: skip


def reflected(surface, carrier_hz: float, owner: np.ndarray, cos_in: np.ndarray) -> np.ndarray:
    """Share of the power (n,) that objects reflect, both polarisations alike."""
    wavelength_m = fields.SPEED_OF_LIGHT_M_PER_S / carrier_hz
    eta = with_losses(surface.permittivity, surface.conductivity, carrier_hz)
    te, tm, _, _ = fields.slab(eta[owner], surface.thickness_m[owner], np.maximum(cos_in, 1e-6), wavelength_m)
    return (np.abs(te) ** 2 + np.abs(tm) ** 2) / 2
