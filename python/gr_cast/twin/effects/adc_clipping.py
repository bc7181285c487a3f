# SPDX-License-Identifier: GPL-3.0-or-later
"""The converter clips: I and Q each limited to ±level of full scale. The prediction is the mean output under the noise in front
of the rails. Internal: level, rms σ of that noise in I and in Q (both fixed)."""

import numpy as np
from scipy.special import ndtr

from .base import RAILS, Family, Role, start
from .values import NEEDED_POSITIVE

FAR = 5.0  # σ from a rail, beyond which the noise does not reach it


def mean_of_limiter(value, level, sigma):
    """Mean output of a limiter at ±level for a real input (n,) under Gaussian noise of rms `sigma`."""
    y = np.clip(value, -level, level)
    if sigma > 0:
        near = np.flatnonzero(np.abs(np.abs(value) - level) < FAR * sigma)
        x = value[near]
        y[near] = x - sigma * (_mean_above((x - level) / sigma) - _mean_above((-x - level) / sigma))
    return y


def _mean_above(z):
    """Mean of what a normal deviate shifted by z has above 0."""
    return np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi) + z * ndtr(z)


class AdcClipping(Family):
    name = "adc_clipping"
    parameters = {"level": NEEDED_POSITIVE}
    role = Role.RAILS
    lasting = False
    stage = RAILS

    def apply(self, chain, effect):
        chain.y = mean_of_limiter(chain.y.real, *effect.p) + 1j * mean_of_limiter(chain.y.imag, *effect.p)

    def values(self, scene, effect, p):
        return {"level": p[0]}

    def parse(self, scene, parameters, model):
        return start(self, [parameters["level"], 0.0], free=[False] * 2)

    def played(self, scene, effect, rng):
        return effect.moved(np.array([effect.p[0], 0.0]))  # the noise is in the signal

    def describe(self, number):
        return f"The converter clips: I and Q never pass ±{number('level')} of full scale."
