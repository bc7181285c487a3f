# SPDX-License-Identifier: GPL-3.0-or-later
"""Energy that hops: in one band for a while, then in another or in none. No cell of time × frequency need hold much of it, nor
all of them together, for most hold nothing.

A hidden Markov chain goes from band to band; over blocks of white noise the likelihood ratio of all its ways together has a mean
of 1, so that chance exceeds x with a probability of 1/x at most (Ville 1939), however many bands, levels and paces are tried.
"""

import numpy as np
from scipy import fft as sp_fft
from scipy.special import logsumexp

from ..twin.interpolate import phasor
from . import residual
from .policy import FLATNESS_TIMES, HOP_BINS, HOP_HEARD, HOP_LEVELS, HOP_PACES, HOP_SHORTEST, HOP_WARMER


def left(fit) -> residual.Leftover:
    """What hops, as what is left; its `nats` are those of the cells on its way."""
    tried = []
    for bins in HOP_BINS:
        energy = _cells(fit, bins)
        paces = np.array([p for p in HOP_PACES if HOP_SHORTEST * p < len(energy)])
        if energy.shape[1] and len(paces):
            likelihood = _likelihood(energy, HOP_LEVELS[:, None], paces / len(energy))
            tried += [(nats, energy, level, pace) for (level, pace), nats in _each(likelihood, paces / len(energy))]
    nats, p_value = 0.0, 1.0
    if tried:
        log = logsumexp([t[0] for t in tried]) - np.log(len(tried))
        p_value = float(np.exp(-max(log, 0.0)))
        best, energy, level, pace = max(tried, key=lambda t: t[0])
        warmer = _likelihood(energy, np.array([[level]]), np.array([pace]), HOP_WARMER)
        nats = max(0.0, float(warmer[0, 0] - best) / (HOP_WARMER - 1))  # the slope: what is expected on the way
    return residual.Leftover(test="energy that hops in frequency", p_value=p_value, nats=nats, where={})


def _each(likelihood: np.ndarray, paces: np.ndarray):
    return (((level, pace), likelihood[i, j]) for i, level in enumerate(HOP_LEVELS) for j, pace in enumerate(paces))


def _cells(fit, bins: int) -> np.ndarray:
    """(blocks, bands) energy over expectation of the residual in blocks of `bins` samples, mostly used ones: bands of 1/`bins`
    of the rate, half over each other, against the colour that each has all the time and the level of all at about that time."""
    n = fit.data.scene.count // bins * bins
    share = (fit.data.use[:n] > 0).reshape(-1, bins).mean(1)
    r, between = residual.normal(fit)[:n], phasor(np.pi * np.arange(n) / bins)
    power = [np.abs(sp_fft.fft(x.reshape(-1, bins), axis=1)) ** 2 for x in (r, r * between)]
    edges = np.arange(0, n + 1, bins)
    power = [one / residual.of_pulses(fit, one / bins, np.repeat(share[:, None], bins, 1), edges)[0] for one in power]
    told = ~residual.bands_not_told(fit, np.concatenate([f := sp_fft.fftfreq(bins), f - 0.5 / bins]), bins)
    power = np.concatenate(power, axis=1)[share > HOP_HEARD][:, told] / share[share > HOP_HEARD, None]
    if len(power) < FLATNESS_TIMES:
        return np.zeros((0, 0))
    power /= np.maximum(power.mean(0), 1e-300)
    first = np.arange(FLATNESS_TIMES) * len(power) // FLATNESS_TIMES
    hits = np.diff(np.append(first, len(power)))
    level = np.add.reduceat(power.mean(1), first) / hits
    return power / np.repeat(np.maximum(level, 1e-300), hits)[:, None]


def _likelihood(energy: np.ndarray, levels: np.ndarray, paces: np.ndarray, warmth: float = 1.0) -> np.ndarray:
    """(levels, paces) ln of the likelihood, over that of noise alone, of all ways from band to band together, by the forward
    recursion: at each of `energy` (blocks, bands) a share `paces` of them goes on to any other band or, as often, to none;
    where it is, there are `levels` (levels, 1) of the noise more. Every ratio to the power `warmth`."""
    bands = energy.shape[1]
    begun = np.append(np.full(bands, 0.5 / bands), 0.5)
    ways = np.broadcast_to(begun, (len(levels), len(paces), bands + 1)).copy()
    stay, go = 1 - paces[:, None], paces[:, None] * begun
    sums = np.empty((len(energy), len(levels), len(paces)))
    for k, ratio in enumerate(np.exp(warmth * (energy[:, None] * (levels / (1 + levels)) - np.log1p(levels)))):
        ways *= stay
        ways += go
        ways[..., :bands] *= ratio[:, None]
        ways.sum(-1, out=sums[k])
        ways /= sums[k, ..., None]
    return np.log(sums).sum(0)
