# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether what is left has amplitudes more even than noise has, or a power that beats as symbols of one rate do: a signal of
another kind is in it, wherever it is in time and frequency."""

import numpy as np
from scipy import fft as sp_fft
from scipy import stats

from ..twin.effects import FAMILIES, is_coarse
from . import copies
from .fit import Fit, rounding_of_grids
from .policy import EVEN_TOO, LEAST_HEARD, OF_DITHER, OF_ROUNDING
from .residual import Leftover, bonferroni, normal


def left(fit: Fit, inside: np.ndarray) -> list[Leftover]:
    """Of the samples `inside` (n,) bool; none where another law of the noise than Gauss's is known."""
    known = any(is_coarse(e) or FAMILIES[e.family].noise_like for e in fit.model.effects)
    if known or inside.sum() < LEAST_HEARD:
        return []
    lack, std = evenness(fit.data.scene.spread(normal(fit)), fit.data.scene.spread(inside))
    lack -= OF_ROUNDING * min(1.0, fit.data.rounding / fit.sigma2) ** 2
    lack -= OF_DITHER * min(1.0, rounding_of_grids(fit) / fit.sigma2) ** 2
    # Nothing is more even than one amplitude, so that so much of the power at least is no noise.
    over = 1 / (1 - min(np.sqrt(max(lack, 0.0)), 0.99))
    nats, p_value = float(inside.sum() * (over - 1 - np.log(over))), float(stats.norm.sf(lack / std))
    test = "amplitudes more even than noise"
    beat = beats(fit.data.scene.spread(fit.residual * fit.data.root), fit.data.scene.spread(inside))  # of any colour
    # Noise that beats is no other signal: that is more even, too.
    both = stats.combine_pvalues(np.maximum([p_value, beat], 1e-300))[1] if p_value < EVEN_TOO else 1.0
    return [
        Leftover(test=test, p_value=p_value, nats=nats, where={}),
        Leftover(test=f"{test}, and a power that beats", p_value=float(both), nats=nats, where={}),
    ]


def beats(r: np.ndarray, inside: np.ndarray) -> float:
    """The chance that the power of noise has so strong a line as that of the samples `inside` (n,) bool has at its strongest:
    at the rate of symbols, with which the power of all that is sent in such rises and falls (Gardner 1986)."""
    power = np.abs(r) ** 2
    power = np.where(inside, power - power[inside].mean(), 0.0)
    log_p, *_ = copies.line(power, np.ones(len(power)))
    return bonferroni(log_p, len(power) // 2)


def evenness(r: np.ndarray, inside: np.ndarray) -> tuple[float, float]:
    """(2 − E|r|⁴/(E|r|²)² of the samples `inside`: 0 of Gaussian noise, 1 of one amplitude; its standard deviation of noise of
    this colour, whose second Laguerre polynomials correlate as the fourth power of the noise)."""
    power = np.abs(r[inside]) ** 2
    spectrum = sp_fft.fft(np.where(inside, r, 0), sp_fft.next_fast_len(2 * len(r)))
    correlation = np.abs(sp_fft.ifft(np.abs(spectrum) ** 2)) / power.sum()
    return float(2 - np.mean(power**2) / np.mean(power) ** 2), float(np.sqrt(4 * np.sum(correlation**4) / len(power)))
