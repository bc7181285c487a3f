# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths by the points at which they meet the place: delays where no mirror image says them, rough walls, names of edges."""

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S
from . import fields

SPECULAR, DIFFUSE, REFRACTION, DIFFRACTION = 1, 2, 4, 8  # the tracer's interaction types; 0 is none


def points(tx_m: np.ndarray, met_m: np.ndarray, kinds: np.ndarray, rx_m: np.ndarray) -> np.ndarray:
    """Where paths go (n, depth + 2, 3): from tx (n, 3) by what they meet (n, depth, 3) to rx, where unused places lie."""
    met_m = np.where((kinds != 0)[:, :, None], met_m, rx_m[:, None, :])
    return np.concatenate([tx_m[:, None], met_m, rx_m[:, None]], axis=1)


def directions(points_m: np.ndarray) -> np.ndarray:
    """Unit directions (n, depth + 1, 3) of all legs; a leg of no length has none, 0."""
    legs_m = np.diff(points_m, axis=1)
    length_m = np.linalg.norm(legs_m, axis=2, keepdims=True)
    return legs_m / np.where(length_m > 0, length_m, 1.0)


def delays(points_m: np.ndarray, legs: int, tx_speeds, rx_speeds) -> tuple[np.ndarray, list[np.ndarray]]:
    """Delays (n,) and their rates for each of the given pairs of velocities (n, 3).

    A point of reflection or diffraction makes the way stationary (Fermat), and a patch stands still: only the ends count.
    """
    along = directions(points_m)
    length_m = np.linalg.norm(np.diff(points_m, axis=1), axis=2).sum(axis=1)
    first, last = along[:, 0], along[np.arange(len(along)), legs]
    pairs = zip(tx_speeds, rx_speeds, strict=True)
    rates = [((rx * last).sum(axis=1) - (tx * first).sum(axis=1)) / SPEED_OF_LIGHT_M_PER_S for tx, rx in pairs]
    return length_m / SPEED_OF_LIGHT_M_PER_S, rates


def rough_loss(points_m, normal, height_rms_m, kinds, wavelength_m: float) -> np.ndarray:
    """What roughness leaves of the amplitude of each path (n,), by all its reflections;
    `normal` (n, depth, 3) and `height_rms_m` (n, depth) are those of the faces."""
    cosine = np.einsum("nkd,nkd->nk", directions(points_m)[:, :-1], normal)
    left = fields.rough_loss(height_rms_m, cosine, wavelength_m)
    return np.where(kinds == SPECULAR, left, 1.0).prod(axis=1)


def nearest_edge(point_m: np.ndarray, corners_m: np.ndarray) -> np.ndarray:
    """Which edge (0 to 2, from corner to corner) of its triangle (n, 3, 3) each point (n, 3) is nearest to."""
    start_m, along_m = corners_m, np.roll(corners_m, -1, axis=1) - corners_m
    back_m = point_m[:, None, :] - start_m
    share = np.clip((back_m * along_m).sum(axis=2) / (along_m**2).sum(axis=2), 0, 1)
    return np.argmin(np.linalg.norm(back_m - share[:, :, None] * along_m, axis=2), axis=1)


def patch_numbers(names: np.ndarray, kinds: np.ndarray, met_m: np.ndarray) -> np.ndarray:
    """Running number of each path with a patch among those of its name (n, k), in the order of their places; -1 for others."""
    patch = kinds == DIFFUSE
    place_m = np.where(patch[:, :, None], met_m, 0.0).sum(axis=1)
    order = np.lexsort((*place_m.T, *names.T))
    new = np.ones(len(names), bool)
    new[1:] = (names[order][1:] != names[order][:-1]).any(axis=1)
    number = np.empty(len(names), np.int64)
    number[order] = np.arange(len(names)) - np.maximum.accumulate(np.where(new, np.arange(len(names)), 0))
    return np.where(patch.any(axis=1), number, -1)


_TURNS = np.random.default_rng(2040).uniform(size=4096)  # a fixed table: the same patch has the same phase wherever it is traced


def patch_phase(number: np.ndarray) -> np.ndarray:
    """A phase of its own for each patch by its number (n,), 1 for what is none."""
    return np.where(number < 0, 1.0, np.exp(2j * np.pi * _TURNS[number % len(_TURNS)]))
