# SPDX-License-Identifier: GPL-3.0-or-later
"""Smooth random courses in time: a cosine basis on the recording, with the variance of each cosine as
prior."""

import numpy as np


def cosines(u: np.ndarray, orders: int) -> np.ndarray:
    """(orders, n) the cosines √2·cos(πku) for k = 1 … orders, of mean power 1."""
    k = np.arange(1, orders + 1)[:, None]
    return np.sqrt(2) * np.cos(np.pi * k * u[None, :])


def course_orders(scene) -> tuple[int, ...]:
    """Numbers of cosines worth trying on a recording."""
    return tuple(size for size in (6, 24, 80) if size < scene.count / 100) or (3,)
