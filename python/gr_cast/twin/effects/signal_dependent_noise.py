# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise that follows the wanted power, of each sample or (aux smooth: how many, and by how many the
noise is later than their middle) the mean of some.
Internal: ln of its power at mean wanted power over the floor."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import brentq, minimize_scalar

from .base import Role, start
from .noise_family import REMEMBERED, NoiseFamily, profile
from .values import NEEDED, Value

STRONGEST = 7.0  # ln of the noise that follows over the floor, either way: beyond, one of the two is not heard
# Samples whose mean power it follows, and how much later than their middle it is: of those after, about and before each. From
# the likeliest of them it goes on in steps of a quarter of the samples, and of single ones, as far as there are samples.
SMOOTH = ((1, 0), *((size, late) for size in (4, 16) for late in (-(size // 2), 0, (size - 1) // 2)))
COVERS = 1.96  # standard deviations of an interval of 95 %


class SignalDependentNoise(NoiseFamily):
    name = "signal_dependent_noise"
    parameters = {"slope_db": NEEDED}
    remembered = REMEMBERED | {
        "smooth_samples": Value(low=1, high=4096, whole=True),
        "smooth_late_samples": Value(low=-4096, high=4096, whole=True),
    }
    role = Role.FOLLOWING
    _strengths = 1

    def variance(self, scene, effect, wanted):
        power = _smoothed(np.abs(wanted) ** 2, *effect.aux.get("smooth", SMOOTH[0])) + effect.aux.get("_blur", (0.0, 0.0))[0]
        return 1 + np.exp(effect.p[0]) * power / (effect.aux["rms"] ** 2 if "rms" in effect.aux else np.mean(power))

    def noise_gain_db(self, effect):
        return 10 / np.log(10) * COVERS * effect.aux.get("_std", [0.0])[0]  # what is not the floor's follows the signal

    def values(self, scene, effect, p):
        return {"slope_db": 10 / np.log(10) * p[0]}

    @staticmethod
    def _error(behind, at: float) -> float:
        """The wider side of the interval of likelihood, as a standard deviation: where little is heard of one of the two powers
        the likelihood falls off steeply on one side alone. `behind(k)` is ln L behind that at its best."""
        lack, sides = 0.5 * COVERS**2, []
        for end in (-STRONGEST, STRONGEST):
            inside = behind(end) < lack
            sides.append(abs(end - at) if inside else abs(brentq(lambda k: behind(k) - lack, at, end, xtol=1e-3) - at))
        return max(sides) / COVERS

    def _levels(self, scene, parameters, model, floor, rms):
        return [np.log(10) / 10 * parameters["slope_db"]]

    def describe(self, number):
        return f"Noise grows with the signal: at mean wanted power it is {number('slope_db')} relative to the floor."

    def parse(self, scene, parameters, model):
        effect = super().parse(scene, parameters, model)
        smooth = int(model.get("smooth_samples", 1)), int(model.get("smooth_late_samples", 0))
        return replace(effect, aux={**effect.aux, "smooth": smooth})

    def model(self, scene, effect):
        size, late = effect.aux.get("smooth", SMOOTH[0])
        return {**super().model(scene, effect), "smooth_samples": size, "smooth_late_samples": late}

    def find(self, view, near=None):
        energy, blur = view.energy[view.use], near.aux.get("_blur", (0.0, 0.0)) if near is not None else (0.0, 0.0)
        (smooth, strength, least), tried = self._form(view, energy, blur[0])
        power = self._power(view, smooth, blur[0])
        shape = _over_mean(power)
        # Of what follows, what of the floor may be the fit's own errors.
        followed = np.exp(strength) * blur[1] / max(float(power.mean()), 1e-300)
        error = self._error(lambda k: self._cost(energy, shape, k) - least, strength)
        aux = {"_std": [float(np.hypot(error, followed))], "_blur": blur, "smooth": smooth}
        gain = -least - profile(energy, np.ones_like(energy))
        return gain, start(self, [strength], free=[False], aux=aux, trials=tried)

    def _form(self, view, energy: np.ndarray, blur: float) -> tuple[tuple[tuple[int, int], float, float], int]:
        """((what it follows, strength, −ln L) at its likeliest, how many forms were tried)."""
        forms = {}

        def tried(smooth):
            forms[smooth] = smooth, *self._likeliest(energy, self._power(view, smooth, blur))
            return forms[smooth]

        best = min(map(tried, SMOOTH), key=lambda form: form[2])
        size = best[0][0]
        for step in sorted({size // 4, min(size // 4, 1)} - {0}, reverse=True):
            for way in (-step, step):
                while (other := tried((size, best[0][1] + way)))[2] < best[2] and abs(other[0][1]) <= size:
                    best = other
        return best, len(forms)

    @staticmethod
    def _power(view, smooth: tuple[int, int], blur: float) -> np.ndarray:
        return _smoothed(view.wanted_power, *smooth)[view.use] + blur

    @staticmethod
    def _cost(energy: np.ndarray, followed: np.ndarray, strength: float) -> float:
        return -profile(energy, 1 + np.exp(strength) * followed)

    def _likeliest(self, energy: np.ndarray, power: np.ndarray) -> tuple[float, float]:
        """(strength, −ln L) of noise that follows a power in one form."""
        followed = _over_mean(power)
        cost = lambda k: self._cost(energy, followed, k)  # noqa: E731
        best = minimize_scalar(cost, bounds=(-STRONGEST, STRONGEST), method="bounded", options={"xatol": 1e-3})
        return float(best.x), float(best.fun)


def _over_mean(power: np.ndarray) -> np.ndarray:
    return power / max(float(power.mean()), 1e-300)


def _smoothed(power: np.ndarray, samples: int, late: int) -> np.ndarray:
    if samples == 1 and not late:
        return power
    at = np.clip(np.arange(len(power)) - late, 0, len(power) - 1)
    return uniform_filter1d(power, samples, mode="nearest")[at]
