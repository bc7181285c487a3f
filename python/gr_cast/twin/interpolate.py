# SPDX-License-Identifier: GPL-3.0-or-later
"""Band-limited signals between their samples."""

from collections.abc import Callable

import numpy as np
from scipy import fft as sp_fft

TAU = 2 * np.pi
BLOCK = 256  # steps that are turned together
EVEN = 1e-15  # of all times together, by which steps may differ: rounding


def within_turn(turns: np.ndarray) -> np.ndarray:
    """What is over whole turns, 0 to 1: the remainder, which itself takes many times as long."""
    return turns - np.floor(turns)


def phasor(angle: np.ndarray) -> np.ndarray:
    """exp(j·angle): its real and imaginary parts apart are many times as fast as a complex exponential."""
    out = np.empty(angle.shape, complex)
    np.cos(angle, out=out.real)
    np.sin(angle, out=out.imag)
    return out


def turning(cycles: float, u: np.ndarray) -> np.ndarray:
    """exp(2πj·cycles·u) of times u (n,): of equal steps block by block, each turned from the first, to the last digits."""
    if not _is_even(u):
        return phasor(TAU * cycles * u)
    step = (u[-1] - u[0]) / (len(u) - 1)
    blocks, within = phasor(TAU * cycles * u[::BLOCK]), phasor(TAU * cycles * step * np.arange(BLOCK))
    return (blocks[:, None] * within).ravel()[: len(u)]


def _is_even(u: np.ndarray) -> bool:
    """Whether these are many times of equal steps."""
    if np.ndim(u) != 1 or len(u) < 4 * BLOCK:
        return False
    return bool(np.ptp(np.diff(u)) < EVEN * abs(u[-1] - u[0]))


def frequencies(length: int) -> np.ndarray:
    """Cycles per sample of each bin of an FFT of `length`; the bin at half the rate counts as 0 (it has no
    sign)."""
    f = sp_fft.fftfreq(length)
    if length % 2 == 0:
        f[length // 2] = 0.0
    return f


def cubic(table: np.ndarray, position: np.ndarray, periodic: bool) -> np.ndarray:
    """Four-point Lagrange interpolation of `table` at `position` (in table samples)."""
    base = np.floor(position)
    x = position - base
    i = base.astype(np.int64)
    size = len(table)
    if periodic:
        i, table = i % size + 1, np.concatenate([table[-1:], table, table[:2]])
        at = lambda k: table[i + k]  # noqa: E731
    elif i.min() >= 1 and i.max() <= size - 3:
        at = lambda k: table[i + k]  # noqa: E731
    else:
        at = lambda k: table[np.clip(i + k, 0, size - 1)]  # noqa: E731
    below, above = x * (x - 1), (x + 1) * (x - 2)
    return (
        at(-1) * (below * (2 - x) / 6) + at(0) * (above * (x - 1) / 2) + at(1) * (above * x / -2) + at(2) * (below * (x + 1) / 6)
    )


def oversampled(spectrum: np.ndarray, factor: int) -> np.ndarray:
    """The band-limited signal of `spectrum` on a grid `factor` times finer."""
    p = len(spectrum)
    half = (p + 1) // 2
    wide = np.zeros(p * factor, complex)
    wide[:half] = spectrum[:half]
    wide[-(p - half) :] = spectrum[half:]
    return sp_fft.ifft(wide) * factor


def moved(spectrum: np.ndarray, shift: np.ndarray, orders: int, taken: Callable = lambda table: table) -> np.ndarray:
    """The signal of `spectrum` at times `shift` samples later, by a Taylor series; `taken`: which of its samples those are."""
    f = TAU * 1j * frequencies(len(spectrum))
    out, factor = np.zeros(1), np.ones(1)
    for order in range(orders + 1):
        out = out + factor * taken(sp_fft.ifft(spectrum))
        spectrum, factor = spectrum * f, factor * shift / (order + 1)
    return out
