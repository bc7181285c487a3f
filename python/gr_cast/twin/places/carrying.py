# SPDX-License-Identifier: GPL-3.0-or-later
"""Whoever or whatever carries a node stands in the way of some of its directions, and turns as it goes."""

from dataclasses import dataclass

import numpy as np

_STANDS_M = 1e-3  # from one instant to the next: less is no way that says where it looks


@dataclass(frozen=True, kw_only=True)
class Body:
    """It takes `loss_db` at `azimuth_rad` left of where the node is heading, 1/e of that `width_rad` beside."""

    loss_db: float
    azimuth_rad: float
    width_rad: float


def headings(points_m: np.ndarray) -> np.ndarray:
    """Level unit vectors (T, 3) along the way over points (T, 3); where it stands, as before; zero of what never moves."""
    if len(points_m) < 2:
        return np.zeros((len(points_m), 3))
    step = np.gradient(points_m, axis=0) * [1.0, 1.0, 0.0]
    far = np.linalg.norm(step, axis=1)
    moves = np.flatnonzero(far > _STANDS_M)
    if not len(moves):
        return np.zeros_like(step)
    last = moves[np.clip(np.searchsorted(moves, np.arange(len(step)), side="right") - 1, 0, None)]
    return step[last] / far[last, None]


def loss_db(body: Body, heading: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """What the body takes (n,) of directions (n, 3) when it heads along (n, 3)."""
    left = np.stack([-heading[:, 1], heading[:, 0], 0 * heading[:, 2]], axis=1)
    axis = np.cos(body.azimuth_rad) * heading + np.sin(body.azimuth_rad) * left
    beside = (1 - (axis * direction).sum(axis=1)) / (1 - np.cos(body.width_rad))
    return np.where(heading.any(axis=1), body.loss_db * np.exp(-beside), 0.0)
