# SPDX-License-Identifier: GPL-3.0-or-later
"""A converter with few bits: I and Q lie on a grid of `step`. The prediction is the mean output of the
quantiser under
noise of rms σ: s + Δ/π·Σ (−1)^k/k·exp(−2π²k²σ²/Δ²)·sin(2πk(s − s0)/Δ) (Widrow and Kollár, Quantization
Noise, ch. 4).
Internal: step, level of one grid point in steps, σ in steps (all fixed once found).
"""

from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from ..interpolate import within_turn
from .base import QUANTISER, Family, Role, start
from .values import NEEDED_POSITIVE, NUMBER, Value

TABLE = 8192  # entries over one step
COARSE = 0.7  # steps of noise below which a quantiser's error is no noise of its own, but bound to the signal


def mean_of_quantizer(value, step, origin, sigma):
    """Mean output for a real input `value` under Gaussian noise of `sigma` steps; grid points at (k +
    origin)·step."""
    x = value / step - origin
    table, slope = _deviation(sigma)
    place = within_turn(x) * TABLE
    cell = place.astype(np.int32)
    return (x + table[cell] + slope[cell] * (place - cell) + origin) * step


@lru_cache(maxsize=32)
def _deviation(sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """(TABLE + 1,) mean output less input over one step, in steps, and its change to the next entry."""
    x = np.arange(TABLE + 1) / TABLE
    size = {k: np.exp(-2 * (np.pi * k * sigma) ** 2) for k in range(1, 9)}
    table = sum((-1) ** k / (np.pi * k) * size[k] * np.sin(2 * np.pi * k * x) for k in size)
    return table, np.diff(table, append=table[1])


def variance_of_quantizer(value, step, origin, sigma):
    """Variance of the output for a real input under Gaussian noise of `sigma` steps, in units of step²."""
    x = value / step - origin
    nearest = np.round(x)
    miss = x - nearest
    first = second = 0.0
    for k in range(-4, 5):
        share = ndtr((k + 0.5 - miss) / sigma) - ndtr((k - 0.5 - miss) / sigma)
        first, second = first + k * share, second + k * k * share
    return second - first**2


class Quantization(Family):
    name = "quantization"
    parameters = {"step": NEEDED_POSITIVE}
    remembered = {"origin": NUMBER, "sigma": Value(low=0.0)}
    role = Role.QUANTISER
    lasting = False
    stage = QUANTISER

    def coarse(self, effect):
        return bool(effect.p[2] < COARSE)

    def apply(self, chain, effect):
        step, origin, sigma = effect.p
        chain.scene.notes["before the quantiser"] = chain.y
        if sigma == 0:  # the noise is in the signal
            rounded = lambda x: (np.round(x / step - origin) + origin) * step  # noqa: E731
            chain.y = rounded(chain.y.real) + 1j * rounded(chain.y.imag)
        elif self.coarse(effect):
            chain.y = mean_of_quantizer(chain.y.real, step, origin, sigma) + 1j * mean_of_quantizer(
                chain.y.imag, step, origin, sigma
            )

    def rounding(self, effect):
        return effect.p[0] ** 2 / 6

    def variance(self, scene, effect, wanted):
        """(n,) power of the noise behind the quantiser over its mean, at the latest prediction; None for a
        fine one."""
        step, origin, sigma = effect.p
        if not self.coarse(effect):
            return None
        y = scene.notes["before the quantiser"]
        v = variance_of_quantizer(y.real, step, origin, sigma) + variance_of_quantizer(y.imag, step, origin, sigma)
        v = np.maximum(v, 0.02 * v.mean())
        return v / v.mean()

    def values(self, scene, effect, p):
        return {"step": p[0]}

    def parse(self, scene, parameters, model):
        return start(self, [parameters["step"], model.get("origin", 0.0), model.get("sigma", 1.0)], free=[False] * 3)

    def model(self, scene, effect):
        return {"origin": float(effect.p[1]), "sigma": float(effect.p[2])}

    def played(self, scene, effect, rng):
        return effect.moved(np.array([*effect.p[:2], 0.0]))

    def describe(self, number):
        return f"The converter is coarse: I and Q lie on a grid of {number('step')} of full scale."
