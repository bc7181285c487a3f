# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a residual is as strong everywhere: over time and frequency, time, frequency, and the level of what is received. Each
cell may stay under its bar while all of them together do not."""

from dataclasses import dataclass

import numpy as np
from scipy import fft as sp_fft
from scipy import special, stats

from ..twin.effects import FAMILIES, is_coarse
from ..twin.effects.base import at_half_the_rate
from . import hopping, residual
from .fit import within
from .policy import FEWEST_TIMES, FLATNESS_LEVELS, FLATNESS_TIMES, LEAST_IN_CELL, LEAST_PAIRS, NEXT, RINGS_ON, WELL_FILLED


@dataclass(frozen=True, kw_only=True)
class Unevenness:
    """What the cells of one map say together against one level: `p_value` under noise of one level, `nats` beyond chance."""

    test: str
    p_value: float
    nats: float


def uneven(test: str, energy: np.ndarray, count: np.ndarray, fitted: int = 1) -> Unevenness:
    """Cells with the `energy` of `count` circular Gaussian samples each against one level for all: Bartlett's statistic (1937),
    with its mean and variance in cells of any size and the tail of a gamma law; `fitted` numbers were taken from the cells."""
    inside = count > LEAST_IN_CELL
    k = count[inside]
    if k.size <= fitted:
        return Unevenness(test=test, p_value=1.0, nats=0.0)
    ratio = np.maximum(energy[inside] / k, 1e-300) / (energy[inside].sum() / k.sum())
    deviance = float(np.sum(2 * k * (ratio - 1 - np.log(ratio))))
    share = 1 - fitted / k.size
    mean = share * float(np.sum(2 * k * (np.log(k) - special.digamma(k))))
    variance = share * float(np.sum(4 * k**2 * (special.polygamma(1, k) - 1 / k)))
    p_value = float(stats.gamma.sf(deviance, mean**2 / variance, scale=variance / mean))
    return Unevenness(test=test, p_value=p_value, nats=max(0.0, deviance - mean) / 2)


def together(energy: np.ndarray, count: np.ndarray) -> Unevenness:
    """What cells (times, frequencies) hold beyond a course over time and a colour that each stay as they are: a receiver colours
    its noise. Of few samples cells of time are taken together: levels over an axis that few samples tell leave too much."""
    while count.size and count.sum() < WELL_FILLED * count.size and len(count) > FEWEST_TIMES:
        energy, count = (np.add.reduceat(x, np.arange(0, len(x), 2), axis=0) for x in (energy, count))
    shape = _relative(energy, count, 0) * _relative(energy, count, 1)
    return uneven("time × frequency", energy / shape, count, fitted=sum(energy.shape) - 1)


def _relative(energy: np.ndarray, count: np.ndarray, axis: int) -> np.ndarray:
    """Levels over one axis of the cells, the sums over the other (`axis`), relative to that of all."""
    level = energy.sum() / max(count.sum(), 1e-300)
    levels = energy.sum(axis, keepdims=True) / np.maximum(count.sum(axis, keepdims=True), 1e-300)
    return np.maximum(levels / max(level, 1e-300), 1e-12)


def over_all(fit, inside: np.ndarray) -> list[Unevenness]:
    """The residual's unevenness over every axis, on the samples `inside` (n,) bool."""
    fit = within(fit, inside)
    energy, count, _ = residual.told_cells(fit)
    held = _held(fit.data.use, energy.shape[1])
    return [
        together(held * energy, held * count),
        uneven("time", energy.sum(1), count.sum(1)),
        uneven("frequency", held * energy.sum(0), held * count.sum(0)),
        over_level(np.abs(residual.normal(fit)[inside]) ** 2, np.abs(fit.chain.wanted[inside])),
    ]


def left(fit, inside: np.ndarray) -> list[residual.Leftover]:
    """What the cells of time and frequency hold together, which has no one place, the stretch of them that differs most from the
    rest, what hops from one to another, and what comes again in a waveform that is sent once."""
    if any(is_coarse(e) for e in fit.model.effects) or not inside.any():
        return []  # behind a coarse quantiser rare steps stand instead of noise
    both, fit = over_all(fit, inside)[0], within(fit, inside)
    told = [residual.Leftover(test=f"{both.test}, all cells together", p_value=both.p_value, nats=both.nats, where={})]
    once = not any(s.repeat for s in fit.data.scene.sources)
    return [*told, stretch(fit), hopping.left(fit), *([comes_again(fit)] if once else [])]


def stretch(fit) -> residual.Leftover:
    """The stretch of time × frequency, of any length and of a width of 1, 2, 4 … cells, that is likeliest to have a level of its
    own beside the colour that the noise has all the time: one that is too weak for any cell of it to tell."""
    scene = fit.data.scene
    energy, count, edges = residual.told_cells(fit)
    energy = energy / _relative(energy, count, 0)
    held = _held(fit.data.use, energy.shape[1])
    rows, bins = energy.shape
    e, n = (np.pad(np.cumsum(np.cumsum(np.fft.fftshift(held * x, 1), 0), 1), ((1, 0), (1, 0))) for x in (energy, count))
    widths = [2**k for k in range(int(np.log2(bins)) + 1)]
    best, places = (0.0, 0, rows, 0, bins), rows * (rows + 1) / 2 * sum(bins - w + 1 for w in widths)
    for width in widths:
        alike = min(1.0, bins / width / held)  # of few samples neighbouring cells of frequency say the same
        e_of, n_of = e[:, width:] - e[:, :-width], n[:, width:] - n[:, :-width]
        for long in range(1, rows + 1):
            nats = alike * _own_level(e_of[long:] - e_of[:-long], n_of[long:] - n_of[:-long], e[-1, -1], n[-1, -1])
            i, j = np.unravel_index(int(np.argmax(nats)), nats.shape)
            best = max(best, (float(nats[i, j]), int(i), int(i) + long, int(j), int(j) + width))
    nats, first, last, low, high = best
    t = np.append(scene.index, scene.index[-1] + 1)[edges[[first, last]]] / scene.sample_rate_hz
    f = (np.array([low, high]) - bins / 2 - 0.5) / bins * scene.sample_rate_hz
    where = {"time_s": t.tolist(), "frequency_hz": f.tolist()}
    p_value = float(np.exp(min(0.0, np.log(places) - nats)))  # of a χ² of one degree, at most
    return residual.Leftover(test="stretch of time × frequency", p_value=p_value, nats=nats, where=where)


def _own_level(e_on, n_on, e, n):
    """(…) nats by which cells of energy `e_on` of `n_on` samples have a level of their own, out of `e` of `n`."""
    n_on = np.clip(n_on, 1e-9, n - 1e-9)
    off = np.maximum((e - e_on) / (n - n_on), 1e-300)
    return n * np.log(e / n) - n_on * np.log(np.maximum(e_on / n_on, 1e-300)) - (n - n_on) * np.log(off)


def comes_again(fit) -> residual.Leftover:
    """What of the residual, without half the sample rate, is the same again after some time: an error in the period of a code
    or of a symbol. Not so soon that it may be what a band that was found rings on, whose shape is not known so well."""
    scene = fit.data.scene
    bands = [told for e in fit.model.found if (told := FAMILIES[e.family].band(e)) is not None]
    first = max([NEXT, *(int(RINGS_ON / width) for _, width in bands)])
    r, used = scene.spread(residual.normal(fit)), scene.spread((fit.data.use > 0).astype(float))
    size = sp_fft.next_fast_len(2 * len(r))
    power = np.where(at_half_the_rate(sp_fft.fftfreq(size)), 0.0, np.abs(sp_fft.fft(r, size)) ** 2)
    together = np.abs(sp_fft.ifft(power)[first : len(r)]) ** 2
    pairs = sp_fft.irfft(np.abs(sp_fft.rfft(used, size)) ** 2, size)[first : len(r)]
    nats = np.where(pairs > LEAST_PAIRS, together / np.maximum(pairs, 1.0), 0.0)
    k = int(np.argmax(nats)) if len(nats) else 0
    height = float(nats[k]) if len(nats) else 0.0
    test = f"the same again after {(k + first) / scene.sample_rate_hz:.4g} s"
    return residual.Leftover(test=test, p_value=float(min(1.0, len(nats) * np.exp(-height))), nats=height, where={})


def along(energy: np.ndarray, level: np.ndarray) -> list[Unevenness]:
    """Of the `energy` of one direction alone (half a complex sample each), in the order of time, over time and `level`."""
    k = np.arange(len(energy)) * FLATNESS_TIMES // len(energy)
    hits = np.bincount(k, minlength=FLATNESS_TIMES)
    return [uneven("time", np.bincount(k, energy, FLATNESS_TIMES) / 2, hits / 2), over_level(energy, level, share=0.5)]


def _held(use: np.ndarray, bins: int) -> float:
    """Independent samples in a cell of frequency over those counted: of a block of `bins` samples that lacks some, neighbouring
    cells share what is there."""
    share = (use[: len(use) // bins * bins] > 0).reshape(-1, bins).mean(1)
    return float(share.mean() / np.mean(share**2))


def over_level(energy: np.ndarray, level: np.ndarray, share: float = 1.0) -> Unevenness:
    """`energy` of every sample, of so much `share` of a complex one, over the `level` that is received."""
    edges = np.quantile(level, np.linspace(0, 1, FLATNESS_LEVELS + 1)[1:-1])
    rank = np.searchsorted(edges, level)
    return uneven(
        "amplitude", share * np.bincount(rank, energy, FLATNESS_LEVELS), share * np.bincount(rank, minlength=FLATNESS_LEVELS)
    )
