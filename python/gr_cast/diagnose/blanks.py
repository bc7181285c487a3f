# SPDX-License-Identifier: GPL-3.0-or-later
"""Zeros that were written in the place of samples: receivers and recorders do so where they lose some. They tell nothing of the
twin, and noise has none."""

import numpy as np

from ..twin.effects import is_coarse
from .fit import Fit
from .policy import BLANK_NATS, LEAST_BLANK, MOST_BLANK, MOST_BLANKS, MUCH_SHORTER, UNEXPLAINED_NATS
from .residual import Leftover


def runs(y: np.ndarray) -> np.ndarray:
    """(k, 2) first and last + 1 of zeros in samples (n,) that follow each other more often than they would by chance, by how
    often they do in all much shorter runs; none where such are many, or a good part of a recording, which is silent then."""
    zero = y == 0
    edges = np.flatnonzero(np.diff(zero, prepend=False, append=False)).reshape(-1, 2)
    length = np.diff(edges, axis=1)[:, 0]
    order = np.sort(length)
    many = np.searchsorted(order, length / MUCH_SHORTER)  # runs that are so much shorter
    zeros = np.append(0, np.cumsum(order))[many]
    first = np.maximum(zeros, 1) / len(zero)
    again = np.where(many > MOST_BLANKS, np.maximum((zeros - many) / np.maximum(zeros, 1), first), first)
    edges = edges[(length >= LEAST_BLANK) & (np.log(first) + (length - 1) * np.log(again) < -BLANK_NATS)]
    return edges if len(edges) <= MOST_BLANKS and np.diff(edges).sum() <= MOST_BLANK * len(y) else edges[:0]


def inside(y: np.ndarray) -> np.ndarray:
    """(n,) bool: samples in such runs."""
    out = np.zeros(len(y), bool)
    for first, end in runs(y):
        out[first:end] = True
    return out


def left(fit: Fit) -> list[Leftover]:
    """Runs that no effect of the fit writes, where more is predicted than noise and than the file's steps make nothing of."""
    if any(is_coarse(e) for e in fit.model.effects):
        return []
    scene, written, out, half = fit.data.scene, fit.chain.silent, [], np.sqrt(6 * fit.data.rounding) / 2
    for first, end in runs(fit.data.y):
        y = fit.chain.y[first:end]
        heard = np.maximum(np.abs(y.real) - half, 0.0) ** 2 + np.maximum(np.abs(y.imag) - half, 0.0) ** 2
        nats = float(np.sum(heard) / fit.sigma2)
        if nats > UNEXPLAINED_NATS and not (written is not None and written[first:end].any()):
            where = {"time_s": [float(scene.index[k]) / scene.sample_rate_hz for k in (first, end - 1)]}
            out.append(Leftover(test="zeros in the place of samples", p_value=float(np.exp(-nats)), nats=nats, where=where))
    return out
