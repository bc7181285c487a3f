# SPDX-License-Identifier: GPL-3.0-or-later
"""What the families of the noise share: they change its variance over time or frequency, never the prediction.

`variance(scene, effect, wanted)` is the noise power of each sample relative to the floor (n,), `spectrum(…)` that of
each FFT bin. Strengths are found by maximum likelihood: with e = |r|²/σ² of circular Gaussian noise every family
compares −Σ ln v − Σ e/v for its shape v against v = 1.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft as sp_fft

from .base import NOISE, Family, said_rms, start
from .values import POSITIVE


@dataclass(frozen=True, kw_only=True)
class NoiseView:
    """The residual of a fit as noise. All of n samples: `use` bool, `energy` |residual|² over what the receiver's gain
    and quantiser make of even noise, `wanted_power`, and `weighted`, the complex residual with its weight."""

    use: np.ndarray
    energy: np.ndarray
    wanted_power: np.ndarray
    weighted: np.ndarray


LOUD = 10.0  # times the median density, from which gaps of a recording spread more of a band than the noise outside it
FILL_STEPS, LEAST_HELD = 20, 0.1  # of a filling, to 60 dB, and the least share of what is in a gap that a loud band does not tell

REMEMBERED = {"floor": POSITIVE, "wanted_rms": POSITIVE}  # in the model of every family of the noise


class NoiseFamily(Family):
    stage = NOISE
    remembered = REMEMBERED
    noise_like = True
    relative = True
    _strengths = 0  # numbers that `find` chooses

    def hidden(self, effect):
        return self._strengths

    def apply(self, chain, effect):
        pass

    def added(self, scene, effect, wanted, draw):
        shape, spectrum = self.variance(scene, effect, wanted), self.spectrum(scene, effect)
        noise = np.sqrt(effect.aux["_floor"]) * draw()
        if spectrum is not None:
            noise = sp_fft.ifft(sp_fft.fft(noise) * np.sqrt(spectrum - 1))
        return noise if shape is None else noise * np.sqrt(shape - 1)

    def _levels(self, scene, parameters, model, floor: float, rms: float) -> list[float]:
        """Internal numbers of the contract's parameters, over a noise power `floor` and a wanted signal of `rms`."""
        raise NotImplementedError

    def parse(self, scene, parameters, model):
        aux = {"_floor": model.get("floor", scene.floor), **said_rms(model)}
        p = self._levels(scene, parameters, model, aux["_floor"], aux.get("rms", scene.rms))
        return start(self, p, free=[False] * len(p), aux=aux)

    def model(self, scene, effect):
        return {"floor": effect.aux.get("_floor", scene.floor), "wanted_rms": effect.aux.get("rms", scene.wanted_rms)}


def filled(signals: np.ndarray, inside: np.ndarray, spectrum: np.ndarray) -> np.ndarray:
    """Signals (…, n) with the samples that are not `inside` (n,) bool as noise of this spectrum (n,) most likely goes on there:
    a gap would spread what is loud in one band over all others (Papoulis 1975; by Chebyshev's iteration)."""
    quiet, middle, half = spectrum.min() / spectrum, (1 + LEAST_HELD) / 2, (1 - LEAST_HELD) / 2
    whole, gap, step, weight = np.where(inside, signals, 0.0 + 0.0j), np.flatnonzero(~inside), 0.0, 0.0
    x, quiet = whole.astype(np.complex64), quiet.astype(np.float32)  # far finer than the filling is
    for k in range(FILL_STEPS if len(gap) else 0):
        level = sp_fft.fft(x, axis=-1)
        level *= quiet
        wrong = np.take(sp_fft.ifft(level, axis=-1, overwrite_x=True), gap, axis=-1)
        weight = 1 / (middle - (half / 2) ** 2 * weight * (1 + (k == 1)))
        step = -weight * wrong + (middle * weight - 1) * step
        x[..., gap] += step
    whole[..., gap] = x[..., gap]
    return whole


def profile(energy: np.ndarray, shape: np.ndarray) -> float:
    """ln L of a variance shape with the level at its best."""
    return float(-np.log(shape).sum() - len(energy) * (np.log(np.mean(energy / shape)) + 1))


def two_levels(n_on, e_on, n, e):
    """Gain in ln L of two levels over one, for `n_on` samples of energy `e_on` out of all; arrays."""
    n_off, e_off = n - n_on, e - e_on
    ok = (n_on > 0) & (n_off > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = n * np.log(e / n) - n_on * np.log(e_on / n_on) - n_off * np.log(e_off / n_off)
    return np.where(ok & (e_on * n_off > e_off * n_on), gain, 0.0)
