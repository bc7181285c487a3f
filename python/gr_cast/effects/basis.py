# SPDX-License-Identifier: GPL-3.0-or-later
"""Smooth random courses in time: a cosine basis on the recording, with the variance of each cosine as
prior."""

import numpy as np
from scipy import fft as sp_fft
from scipy.interpolate import CubicSpline


def course_of(coefficients: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Σ c_k·√2·cos(πku) at `u` (n,), real or complex, by splines over a grid 16 times finer than its fastest cosine."""
    orders = len(coefficients)
    size = sp_fft.next_fast_len(16 * orders)
    low, high = int(np.floor(u.min() * size)) - 16, int(np.ceil(u.max() * size)) + 16
    grid = np.zeros(size + 1, complex)
    grid[1 : orders + 1] = np.sqrt(2) * coefficients
    grid = (sp_fft.dct(grid.real, 1) + 1j * sp_fft.dct(grid.imag, 1)) / 2
    at = np.arange(low, high + 1)
    fold = np.abs((at + size) % (2 * size) - size)  # the cosines are even about 0 and about 1
    course = CubicSpline(at / size, grid[fold])(u)
    return course if np.iscomplexobj(coefficients) else course.real


def cosines(u: np.ndarray, orders: int) -> np.ndarray:
    """(orders, n) the cosines √2·cos(πku) for k = 1 … orders, of mean power 1."""
    k = np.arange(1, orders + 1)[:, None]
    return np.sqrt(2) * np.cos(np.pi * k * u[None, :])


def course_orders(scene) -> tuple[int, ...]:
    """Numbers of cosines worth trying on a recording."""
    return tuple(size for size in (6, 24, 80) if size < scene.count / 100) or (3,)
