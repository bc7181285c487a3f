# SPDX-License-Identifier: GPL-3.0-or-later
"""Derivatives of a prediction, kept in the form in which their inner products are cheap.

`Dense` holds them row by row; `Lags` shifted copies of a few signals, each times 1 and j (−j behind an inversion); `Courses` a
few signals times the cosines of a slow course. The last two are written out only where many are to be compared with them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft as sp_fft
from scipy.linalg import blas

from .basis import products, spread, weights
from .interpolate import phasor
from .scene import Scene

FEW = 8  # derivatives against which a whole table is cheaper than its chunks
MANY_LAGS = 32  # from which the structure of their inner products pays
MOST_OF_ROWS = 2  # times the entries, that rows of all lags may have, to be cheaper than the entries one by one
OFTEN = 20  # samples, in the mean, between two changes of a window that are cheaper than all samples
TOGETHER = 1 << 13  # numbers of short signals whose sums with cosines are taken at once: of longer ones it saves nothing
CHUNK = 1 << 18  # complex numbers that are worked on at once: what a cache holds


@dataclass(frozen=True, kw_only=True)
class Dense:
    """Derivatives as they are: (k, n) complex."""

    signals: np.ndarray
    paired = 0
    kept = False

    def __len__(self):
        return len(self.signals)

    @property
    def height(self):
        return len(self.signals)

    def part(self, a: int, b: int) -> np.ndarray:
        return self.signals[:, a:b]

    @property
    def table(self) -> np.ndarray:
        return self.signals

    def full(self) -> np.ndarray:
        return self.signals


@dataclass(frozen=True, kw_only=True)
class Lags:
    """c and j·paired·c for every c = exp(j·turn·lag)·signals[i] `lag` samples later, in `entries` (i, lag); zeros where nothing
    is known."""

    signals: np.ndarray  # (u, n)
    entries: tuple
    window: np.ndarray | None = None  # (n,) factor after the shift
    kept: bool = False  # whether `table` is worth its memory: much is compared with it
    paired: int = 1  # −1 where the recording is the conjugate
    turn: float = 0.0  # radians per sample that oscillators turn which do not come later with the signal

    def __len__(self):
        return 2 * len(self.entries)

    @property
    def turned(self) -> np.ndarray | float:
        """(entries,) what those oscillators make of each lag; 1 where they stand still."""
        return phasor(self.turn * np.array([lag for _, lag in self.entries])) if self.turn else 1.0

    @property
    def height(self):
        return len(self.entries)

    def part(self, a: int, b: int) -> np.ndarray:
        """(entries, b − a) the shifted signals themselves."""
        n = self.signals.shape[1]
        out = np.zeros((len(self.entries), b - a), complex)
        turned = np.broadcast_to(self.turned, len(out))
        for row, (i, lag), factor in zip(out, self.entries, turned, strict=True):
            low, high = max(a - lag, 0), min(b - lag, n)
            if high > low:
                np.multiply(self.signals[i, low:high], factor, out=row[low + lag - a : high + lag - a])
        if self.window is not None:
            out *= self.window[a:b]
        return out

    @cached_property
    def table(self) -> np.ndarray:
        """All shifted signals."""
        return self.part(0, self.signals.shape[1])

    def full(self) -> np.ndarray:
        c = self.part(0, self.signals.shape[1])
        return np.stack([c, 1j * self.paired * c], 1).reshape(len(self), -1)


@dataclass(frozen=True, kw_only=True)
class Courses:
    """signals[i] · √2·cos(πkn/L), k-major: all units of the slowest cosine first."""

    signals: np.ndarray  # (u, n)
    orders: int
    scene: Scene  # whose time the course is one of

    def __len__(self):
        return len(self.signals) * self.orders

    def spread(self, covariance: np.ndarray) -> np.ndarray:
        """(n,) variance of the sum of all derivatives, each times a number, of numbers of a covariance (len, len); what different
        signals have in common is left out."""
        total, units = np.zeros(self.signals.shape[1]), len(self.signals)
        for i, signal in enumerate(self.signals):
            constant, course = spread(covariance[i::units, i::units])
            total += np.abs(signal) ** 2 * np.maximum(constant + self.scene.course(course), 0.0)
        return total

    def full(self) -> np.ndarray:
        basis = np.array([self.scene.course(row) for row in np.eye(self.orders)])
        return (basis[:, None] * self.signals[None]).reshape(len(self), -1)


def inner(a, b) -> np.ndarray:
    """(len(a), len(b)) real parts of the inner products of two sets of derivatives."""
    if isinstance(a, Courses):
        if isinstance(b, Courses):
            out = np.empty((a.orders, len(a.signals), b.orders, len(b.signals)))
            for i, u in enumerate(a.signals):
                for j, v in enumerate(b.signals):
                    out[:, i, :, j] = products(a.scene.spread((np.conj(u) * v).real), a.orders, b.orders)
        else:
            out, step = np.empty((a.orders, len(a.signals), len(b))), 2 if b.paired else 1
            for i, u in enumerate(a.signals):
                for rows in some_at_once(np.arange(b.height), len(u), TOGETHER):
                    product = a.scene.spread(np.conj(u) * b.table[rows])
                    out[:, i, step * rows] = weights(product.real, a.orders).T
                    if b.paired:
                        out[:, i, step * rows + 1] = -b.paired * weights(product.imag, a.orders).T
        return out.reshape(len(a), len(b))
    if isinstance(b, Courses):
        return inner(b, a).T
    if isinstance(a, Dense) and isinstance(b, Dense):
        return _reals(a) @ _reals(b).T
    if a is b:
        own = _own_lags(a)
        return _real(_own(a) if own is None else own, a.paired, b.paired)
    if _row_of_lags(b) and not _row_of_lags(a):
        return inner(b, a).T
    if _row_of_lags(a) and (isinstance(b, Dense) or b.height <= MANY_LAGS):
        return _real(_with_lags(a, b.table), a.paired, b.paired)
    if b.kept and a.height <= FEW:
        return _real(np.conj(a.table) @ b.table.T, a.paired, b.paired)
    if a.kept and b.height <= FEW:
        return inner(b, a).T
    return _real(_products(a, b), a.paired, b.paired)


def _reals(columns: Dense) -> np.ndarray:
    """(k, 2n) real and imaginary parts of each sample, side by side: real products are half of the complex ones."""
    return np.ascontiguousarray(columns.signals, complex).view(float)


def _chunks(n: int, height: int) -> Iterator[tuple[int, int]]:
    size = max(512, CHUNK // (height + 1))
    return ((first, min(first + size, n)) for first in range(0, n, size))


def some_at_once(items: np.ndarray, each: int, most: int) -> list[np.ndarray]:
    """Items (n,), of so many numbers `each`, in runs of no more than `most` numbers, and of one item at least."""
    run = max(1, most // max(each, 1))
    return [items[k : k + run] for k in range(0, len(items), run)]


def _products(a, b) -> np.ndarray:
    """(height of a, height of b) Σ conj(a)·b."""
    total = np.zeros((a.height, b.height), complex)
    for chunk in _chunks(a.signals.shape[1], a.height + b.height):
        p, q = a.part(*chunk), b.part(*chunk)
        total += np.conj(p) @ q.T if a.height < b.height else np.conj(p @ np.conj(q).T)
    return total


def _own(a) -> np.ndarray:
    """(height, height) Σ conj(a)·a, of which half is worked out."""
    total = np.zeros((a.height, a.height), complex, order="F")
    for chunk in _chunks(a.signals.shape[1], 2 * a.height):
        total = blas.zherk(1.0, a.part(*chunk).T, beta=1.0, c=total, trans=2, overwrite_c=True)
    return np.triu(total) + np.conj(np.triu(total, 1)).T


def _row_of_lags(columns) -> bool:
    """Whether derivatives are one signal at one lag after the other, so many that their structure pays."""
    if not isinstance(columns, Lags) or len(columns.entries) < MANY_LAGS or len(columns.signals) > 1:
        return False
    low = columns.entries[0][1]
    return columns.entries == tuple((0, low + k) for k in range(len(columns.entries)))


def _with_lags(a: Lags, rows: np.ndarray) -> np.ndarray:
    """(entries, rows) Σ conj(a)·row for a row of lags, by correlation."""
    size, n, low = len(a.entries), a.signals.shape[1], a.entries[0][1]
    span = sp_fft.next_fast_len(n + size + abs(low))
    spectrum = np.conj(sp_fft.fft(a.signals[0], span))
    at = (low + np.arange(size)) % span
    seen = rows if a.window is None else rows * a.window
    found = np.array([sp_fft.ifft(sp_fft.fft(row, span) * spectrum)[at] for row in seen]).reshape(-1, size)
    return (found * np.conj(a.turned)).T


def _own_lags(a: Lags) -> np.ndarray | None:
    """(entries, entries) Σ conj(a)·a of signals at all lags of a row, or nearly: from one lag to the next it changes only where
    the window does. None where that is too often, or lags too few."""
    lags, (kinds, n) = [lag for _, lag in a.entries], a.signals.shape
    low, size = min(lags), max(lags) - min(lags) + 1
    window = np.ones(n) if a.window is None else a.window**2
    change = np.diff(np.concatenate([[0.0], window, [0.0]]))  # of the window, at the sample after −1, 0, …
    at = np.flatnonzero(change)
    if size == 1 or kinds * size > MOST_OF_ROWS * len(a.entries) or len(at) * OFTEN > n:
        return None
    before, behind = max(size + low, 1), max(1 - low, 1)
    padded = np.pad(a.signals, ((0, 0), (before, behind)))
    # The signals as each lag has them at the sample before.
    lagged = padded[:, (before - 1 - low + at)[:, None] - np.arange(size)].swapaxes(0, 1).reshape(len(at), -1)
    steps = ((np.conj(lagged) * change[at, None]).T @ lagged).reshape(kinds, size, kinds, size)
    at_first = np.conj(padded[:, before - low : before - low + n] * window).T
    out = np.empty((kinds, size, kinds, size), complex)
    for k in range(size):
        out[:, k, :, 0] = np.conj(padded[:, before - low - k : before - low - k + n] @ at_first)
    out[:, 0] = np.conj(out[:, :, :, 0]).transpose(2, 0, 1)
    for k in range(1, size):
        out[:, k, :, 1:] = out[:, k - 1, :, :-1] + steps[:, k - 1, :, :-1]
    mine = [i * size + lag - low for i, lag in a.entries]
    return out.reshape(kinds * size, -1)[np.ix_(mine, mine)] * np.conj(np.reshape(a.turned, (-1, 1))) * a.turned


def _real(products_, paired_a: int, paired_b: int) -> np.ndarray:
    """Re⟨c, d⟩ for c, ±j·c against d, ±j·d where a side is paired."""
    g = products_
    left = np.stack([g.real, paired_a * g.imag], 1).reshape(-1, g.shape[1]) if paired_a else g.real
    if not paired_b:
        return left
    right = np.stack([-g.imag, paired_a * g.real], 1).reshape(-1, g.shape[1]) if paired_a else -g.imag
    return np.stack([left, paired_b * right], 2).reshape(len(left), -1)


def gram(blocks) -> np.ndarray:
    """All inner products of a list of derivative sets."""
    ends = np.cumsum([0, *(len(b) for b in blocks)])
    out = np.empty((ends[-1], ends[-1]))
    for i, a in enumerate(blocks):
        for j in range(i, len(blocks)):
            g = inner(a, blocks[j])
            out[ends[i] : ends[i + 1], ends[j] : ends[j + 1]] = g
            out[ends[j] : ends[j + 1], ends[i] : ends[i + 1]] = g.T
    return out


def against(blocks, other) -> np.ndarray:
    """(parameters, len(other)) inner products of all derivatives with another set."""
    return np.concatenate([inner(b, other) for b in blocks])
