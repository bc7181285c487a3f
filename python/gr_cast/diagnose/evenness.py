# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether what is left has amplitudes more even than noise has: a signal of another kind is in it, wherever it is in time and
frequency."""

import numpy as np
from scipy import fft as sp_fft
from scipy import stats

from ..twin.effects import FAMILIES, is_coarse
from .fit import Fit, rounding_of_grids
from .policy import LEAST_HEARD, OF_DITHER, OF_ROUNDING
from .residual import Leftover, normal


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
    nats = float(inside.sum() * (over - 1 - np.log(over)))
    return [Leftover(test="amplitudes more even than noise", p_value=float(stats.norm.sf(lack / std)), nats=nats, where={})]


def evenness(r: np.ndarray, inside: np.ndarray) -> tuple[float, float]:
    """(2 − E|r|⁴/(E|r|²)² of the samples `inside`: 0 of Gaussian noise, 1 of one amplitude; its standard deviation of noise of
    this colour, whose second Laguerre polynomials correlate as the fourth power of the noise)."""
    power = np.abs(r[inside]) ** 2
    spectrum = sp_fft.fft(np.where(inside, r, 0), sp_fft.next_fast_len(2 * len(r)))
    correlation = np.abs(sp_fft.ifft(np.abs(spectrum) ** 2)) / power.sum()
    return float(2 - np.mean(power**2) / np.mean(power) ** 2), float(np.sqrt(4 * np.sum(correlation**4) / len(power)))
