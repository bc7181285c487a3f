# SPDX-License-Identifier: GPL-3.0-or-later
"""Smooth random courses in time on a cosine basis √2·cos(πkn/L), k = 1 …, n the sample, L the next length with a fast
FFT: every sum over the basis is one FFT, and no matrix of cosines is ever made.
"""

import numpy as np
from scipy import fft as sp_fft
from scipy.interpolate import CubicSpline
from scipy.linalg import hankel, toeplitz

SAMPLES_EACH = 24  # of a recording for each cosine that a search tries, at least
GRAIN = 64  # L is a multiple of it, so that a signal can be summed over short blocks before its slow cosines are taken
FINE = 16  # blocks for each cosine: a block then holds a 32nd of a turn, and its moments up to the second the rest


def course_length(count: int) -> int:
    """L: half the period of the slowest cosine, in samples."""
    return GRAIN * sp_fft.next_fast_len(-(-count // GRAIN))


def course(p: np.ndarray, count: int) -> np.ndarray:
    """(count,) Σ p_k·√2·cos(πkn/L) of real or complex coefficients."""
    if not p.any():  # as it is where a search begins
        return np.zeros(count, p.dtype)
    if np.iscomplexobj(p):
        return course(p.real, count) + 1j * course(p.imag, count)
    length = course_length(count)
    spectrum = np.zeros(length + 1)
    spectrum[1 : len(p) + 1] = p * (np.sqrt(2) * length)
    return sp_fft.irfft(spectrum, 2 * length)[:count]


def grid_of(coefficients: np.ndarray) -> np.ndarray:
    """(size + 1,) `course` from n = 0 to L, on a grid 16 times finer than its fastest cosine."""
    orders = len(coefficients)
    grid = np.zeros(sp_fft.next_fast_len(16 * orders) + 1, complex)
    grid[1 : orders + 1] = np.sqrt(2) * coefficients
    if not np.iscomplexobj(coefficients):
        return sp_fft.dct(grid.real, 1) / 2
    return (sp_fft.dct(grid.real, 1) + 1j * sp_fft.dct(grid.imag, 1)) / 2


def course_on(grid: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The course of a grid at any `u` = n/L (m,), by splines."""
    size = len(grid) - 1
    at = np.arange(int(np.floor(u.min() * size)) - 16, int(np.ceil(u.max() * size)) + 17)
    fold = np.abs((at + size) % (2 * size) - size)  # the cosines are even about 0 and about 1
    return CubicSpline(at / size, grid[fold])(u)


def _cosine_sums(signals: np.ndarray, orders: int) -> np.ndarray:
    """(…, orders + 1) Σ_n signal·cos(πkn/L) for k = 0 … orders of real signals (…, n)."""
    count = signals.shape[-1]
    length = course_length(count)
    block = 1
    while block < GRAIN and length // (2 * block) >= FINE * orders:
        block *= 2
    whole = np.zeros((*signals.shape[:-1], length))
    whole[..., :count] = signals
    beside = np.arange(block) - (block - 1) / 2  # samples from a block's middle: its moments hold what is not smooth
    moments = whole.reshape(*whole.shape[:-1], -1, block) @ beside[:, None] ** np.arange(3 if block > 1 else 1)
    k = np.arange(orders + 1)
    turn = np.exp(-0.5j * np.pi * k * (block - 1) / length)
    sums = sp_fft.rfft(np.moveaxis(moments, -1, 0), 2 * length // block)[..., : orders + 1] * turn
    if block == 1:
        return sums[0].real
    step = np.pi * k / length  # cos(a + d) = cos a·(1 − d²/2) − sin a·d, but for d³/6
    return sums[0].real + step * sums[1].imag - step**2 / 2 * sums[2].real


def weights(signals: np.ndarray, orders: int) -> np.ndarray:
    """(…, orders) Σ_n signal·√2·cos(πkn/L) of real signals (…, n)."""
    return np.sqrt(2) * _cosine_sums(signals, orders)[..., 1:]


def products(energy: np.ndarray, first: int, second: int) -> np.ndarray:
    """(first, second) Σ_n energy·2·cos(πkn/L)·cos(πln/L): from 2·cos a·cos b = cos(a − b) + cos(a + b)."""
    e = _cosine_sums(energy, first + second)
    return toeplitz(e[:first], e[:second]) + hankel(e[2 : first + 2], e[first + 1 : first + second + 1])


def spread(covariance: np.ndarray) -> tuple[float, np.ndarray]:
    """Constant and coefficients (2K,) of the course that the variance of a course is, of a covariance (K, K) of its coefficients:
    2·cos a·cos b = cos(a − b) + cos(a + b)."""
    k = np.arange(1, len(covariance) + 1)
    sums = [np.bincount(np.abs(at).ravel(), covariance.ravel(), 2 * len(k) + 1) for at in (k[:, None] - k, k[:, None] + k)]
    return float(sums[0][0]), (sums[0] + sums[1])[1:] / np.sqrt(2)


def course_orders(scene, most: int = 96) -> tuple[int, ...]:
    """Numbers of cosines worth trying on a recording."""
    return tuple(size for size in (6, 24, 96, 480) if size <= most and size < scene.count / SAMPLES_EACH) or (3,)
