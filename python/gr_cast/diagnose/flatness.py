# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a residual is as strong everywhere: over time and frequency, time, frequency, and the level of what is received. Each
cell may stay under its bar while all of them together do not."""

from dataclasses import dataclass

import numpy as np
from scipy import special, stats

from ..twin.effects import is_coarse
from . import residual
from .fit import within

TIMES = 48  # cells of time
LEVELS = 16  # of what is received, as many samples in each
LEAST_IN_CELL = 2.0  # samples: of fewer ln of the mean tells next to nothing


@dataclass(frozen=True, kw_only=True)
class Unevenness:
    """What the cells of one map say together against one level: `p_value` under noise of one level, `nats` beyond chance."""

    test: str
    p_value: float
    nats: float


def uneven(test: str, energy: np.ndarray, count: np.ndarray) -> Unevenness:
    """Cells with the `energy` of `count` circular Gaussian samples each against one level for all: Bartlett's statistic (1937),
    with its mean and variance in cells of any size and the tail of a gamma law."""
    inside = count > LEAST_IN_CELL
    k = count[inside]
    if k.size < 2:
        return Unevenness(test=test, p_value=1.0, nats=0.0)
    ratio = np.maximum(energy[inside] / k, 1e-300) / (energy[inside].sum() / k.sum())
    deviance = float(np.sum(2 * k * (ratio - 1 - np.log(ratio))))
    share = 1 - 1 / k.size  # one level is fitted
    mean = share * float(np.sum(2 * k * (np.log(k) - special.digamma(k))))
    variance = share * float(np.sum(4 * k**2 * (special.polygamma(1, k) - 1 / k)))
    p_value = float(stats.gamma.sf(deviance, mean**2 / variance, scale=variance / mean))
    return Unevenness(test=test, p_value=p_value, nats=max(0.0, deviance - mean) / 2)


def over_all(fit, inside: np.ndarray) -> list[Unevenness]:
    """The residual's unevenness over every axis, on the samples `inside` (n,) bool."""
    fit = within(fit, inside)
    energy, count, _ = residual.told_cells(fit)
    held = _held(fit.data.use, energy.shape[1])
    return [
        uneven("time × frequency", held * energy, held * count),
        uneven("time", energy.sum(1), count.sum(1)),
        uneven("frequency", held * energy.sum(0), held * count.sum(0)),
        over_level(np.abs(residual.normal(fit)[inside]) ** 2, np.abs(fit.chain.wanted[inside])),
    ]


def left(fit, inside: np.ndarray) -> list[residual.Leftover]:
    """What the cells of time and frequency hold together, as what is left; it has no one place."""
    if any(is_coarse(e) for e in fit.model.effects) or not inside.any():
        return []  # behind a coarse lattice rare steps stand instead of noise
    both = over_all(fit, inside)[0]
    return [residual.Leftover(test=f"{both.test}, all cells together", p_value=both.p_value, nats=both.nats, where={})]


def along(energy: np.ndarray, level: np.ndarray) -> list[Unevenness]:
    """Of the `energy` of one direction alone (half a complex sample each), in the order of time, over time and `level`."""
    k = np.arange(len(energy)) * TIMES // len(energy)
    hits = np.bincount(k, minlength=TIMES)
    return [uneven("time", np.bincount(k, energy, TIMES) / 2, hits / 2), over_level(energy, level, share=0.5)]


def _held(use: np.ndarray, bins: int) -> float:
    """Independent samples in a cell of frequency over those counted: of a block of `bins` samples that lacks some, neighbouring
    cells share what is there."""
    share = (use[: len(use) // bins * bins] > 0).reshape(-1, bins).mean(1)
    return float(share.mean() / np.mean(share**2))


def over_level(energy: np.ndarray, level: np.ndarray, share: float = 1.0) -> Unevenness:
    """`energy` of every sample, of so much `share` of a complex one, over the `level` that is received."""
    edges = np.quantile(level, np.linspace(0, 1, LEVELS + 1)[1:-1])
    rank = np.searchsorted(edges, level)
    return uneven("amplitude", share * np.bincount(rank, energy, LEVELS), share * np.bincount(rank, minlength=LEVELS))
