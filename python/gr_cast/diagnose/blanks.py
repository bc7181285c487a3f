# SPDX-License-Identifier: GPL-3.0-or-later
"""Zeros that were written in the place of samples: receivers and recorders do so where they lose some. They tell nothing of the
twin, and noise has none."""

import numpy as np

from .fit import Fit
from .policy import BLANK_NATS, MOST_BLANK
from .residual import Leftover


def runs(y: np.ndarray) -> np.ndarray:
    """(k, 2) first and last + 1 of zeros in samples (n,) that follow each other more often than as many zeros would by chance;
    none where they are a good part of the recording, which is silent then."""
    zero = y == 0
    edges = np.flatnonzero(np.diff(zero, prepend=False, append=False)).reshape(-1, 2)
    length = np.diff(edges, axis=1)[:, 0]
    share = np.maximum(zero.sum() - length, 1) / len(zero)  # of zeros elsewhere
    edges = edges[length * np.log(share) < -BLANK_NATS]
    return edges if np.diff(edges).sum() <= MOST_BLANK * len(y) else edges[:0]


def inside(y: np.ndarray) -> np.ndarray:
    """(n,) bool: samples in such runs."""
    out = np.zeros(len(y), bool)
    for first, end in runs(y):
        out[first:end] = True
    return out


def left(fit: Fit) -> list[Leftover]:
    """Runs that no effect of the fit writes, where more than noise is predicted."""
    scene, written, out = fit.data.scene, fit.chain.silent, []
    for first, end in runs(fit.data.y):
        nats = float(np.sum(np.abs(fit.chain.y[first:end]) ** 2) / fit.sigma2)
        if nats > BLANK_NATS and not (written is not None and written[first:end].any()):
            where = {"time_s": [float(scene.index[k]) / scene.sample_rate_hz for k in (first, end - 1)]}
            out.append(Leftover(test="zeros in the place of samples", p_value=float(np.exp(-nats)), nats=nats, where=where))
    return out
