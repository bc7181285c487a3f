# SPDX-License-Identifier: GPL-3.0-or-later
"""Strong samples, alone or a few together where a receive filter makes an impulse last. Internal: ln of their power over the
floor, ln of their share of samples; aux `length`: samples that an impulse lasts, whose power is the energy of them all."""

from dataclasses import replace

import numpy as np
from scipy.special import i0e

from .base import start
from .noise_family import REMEMBERED, NoiseFamily
from .values import NEEDED, NEEDED_POSITIVE, Value, one_of

LONGEST = 8.0  # samples that an impulse may last: longer ones are bursts
HUGE = 700.0  # nats, of which the exponential can still be held
EXPECTED = 6.0  # impulses, of which none came by chance once in 400 times
TOGETHER = 2  # samples apart, at most, that are of one impulse


class ImpulsiveNoise(NoiseFamily):
    name = "impulsive_noise"
    parameters = {"rate_hz": NEEDED_POSITIVE, "power_db": NEEDED}
    remembered = REMEMBERED | {"law": one_of("random", "steady"), "length_samples": Value(low=1.0, high=LONGEST)}
    owners = ("environment",)
    lasting = False
    scattered = True
    _strengths = 2

    def values(self, scene, effect, p):
        floor, length = effect.aux["_floor"], effect.aux.get("length", 1.0)
        return {
            "rate_hz": float(np.exp(p[1])) / length * scene.sample_rate_hz,
            "power_db": 10 * np.log10(np.exp(p[0]) * length * floor),
        }

    def _levels(self, scene, parameters, model, floor, rms):
        length = model.get("length_samples", 1.0)
        share = parameters["rate_hz"] * length / scene.sample_rate_hz
        return [np.log(10 ** (parameters["power_db"] / 10) / length / floor), np.log(share)]

    def parse(self, scene, parameters, model):
        effect = super().parse(scene, parameters, model)
        law = {"law": model.get("law", "random"), "_level": effect.aux["_floor"]}
        law |= {"length": model["length_samples"]} if "length_samples" in model else {}
        return replace(effect, aux=effect.aux | law)

    def model(self, scene, effect):
        lasting = {"length_samples": effect.aux["length"]} if "length" in effect.aux else {}
        return super().model(scene, effect) | {"law": effect.aux["law"]} | lasting

    def added(self, scene, effect, wanted, draw):
        strength, share = effect.p
        lasting = round(effect.aux.get("length", 1.0))
        begins = np.abs(draw()) ** 2 > np.log(lasting) - share  # an exponential number passes −ln p with probability p
        hit = np.convolve(begins, np.ones(lasting))[: len(begins)] > 0
        size = draw()
        if effect.aux["law"] == "steady":
            size = size / np.maximum(np.abs(size), 1e-30)
        return np.where(hit, np.sqrt(effect.aux["_floor"] * np.exp(strength)) * size, 0.0)

    def describe(self, number):
        return f"Impulses: {number('rate_hz')} of them, each {number('power_db')} re full scale."

    def find(self, view, near=None):
        """(gain, effect) of a mixture: a share of samples with impulses of random or of steady size, what is likelier."""
        e = view.energy[view.use]
        e = e[e > 0]  # on a rail nothing is left
        if (e > 9 * np.median(e) / np.log(2)).sum() < 3:
            return 0.0, None
        found = _mixed(e, "random")
        if found[0] > TELLING:
            found = max(found, _mixed(e, "steady", *found[2:]))
        gain, law, level, ratio, share = found
        if share > 0.2:
            return 0.0, None
        effect = start(self, [np.log(ratio), np.log(share)], free=[False] * 2, aux={"law": law, "_level": level})
        if (length := self._length(effect, np.where(view.use, view.energy, 0.0))) > 1.0:
            effect.aux["length"] = length
        effect.aux["_std"] = self._spread(effect, e / level)
        return gain, effect

    def _length(self, effect, energy) -> float:
        """Samples that an impulse lasts in the mean, as many as follow each other more often than by chance."""
        at = np.flatnonzero(self.shares(effect, energy) > 0.5)
        together = np.diff(at) <= TOGETHER
        apart = (1 + np.count_nonzero(~together)) / max(len(at), 1)
        by_chance = np.exp(-TOGETHER * np.exp(effect.p[1]))
        surely = together.sum() > 3 * np.sqrt(len(at) * (1 - by_chance)) + len(at) * (1 - by_chance)
        return float(np.clip(by_chance / apart, 1.0, LONGEST)) if surely else 1.0

    def _spread(self, effect, energy, step=0.05):
        """Standard deviations of both numbers, from the curvature of ln L."""

        def at(a, b):
            return float(self.likelihood(effect.moved(effect.p + step * np.array([a, b])), energy).sum())

        middle = at(0, 0)
        cross = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / 4
        curvature = np.array([[at(1, 0) - 2 * middle + at(-1, 0), cross], [cross, at(0, 1) - 2 * middle + at(0, -1)]]) / step**2
        return np.sqrt(np.clip(np.diag(np.linalg.pinv(-curvature)), 1e-6, 4.0)).tolist()

    def weight(self, effect, power):
        strong = self.shares(effect, power)
        return 1 - strong + strong / (1 + np.exp(effect.p[0]))

    def shares(self, effect, power):
        energy, share = power / effect.aux["_level"], np.exp(effect.p[1])
        with_impulse = np.log(share) + DENSITIES[effect.aux["law"]](energy, np.exp(effect.p[0]))
        return _share_of(with_impulse, np.log1p(-share) - energy)

    def spared_nats(self, effect, count):
        share = np.exp(effect.p[1])
        expected = count * share / effect.aux.get("length", 1.0)
        return -count * float(np.log1p(-share)) if expected < EXPECTED else 0.0

    @staticmethod
    def likelihood(effect, energy):
        """(n,) ln of the density of the energies of both kinds of samples together."""
        share = np.exp(effect.p[1])
        return np.logaddexp(np.log1p(-share) - energy, np.log(share) + DENSITIES[effect.aux["law"]](energy, np.exp(effect.p[0])))


def _share_of(log_density: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(n,) share of one of two densities, of which the logarithms are given, in both together."""
    return 1 / (1 + np.exp(np.minimum(other - log_density, HUGE)))


def _random(energy, power):
    """ln density of a sample's energy where an impulse of complex Gaussian size is in it."""
    return -np.log1p(power) - energy / (1 + power)


def _steady(energy, power):
    """The same for impulses of one size and any phase (Rice)."""
    return -((np.sqrt(energy) - np.sqrt(power)) ** 2) + np.log(i0e(2 * np.sqrt(energy * power)))


DENSITIES = {"random": _random, "steady": _steady}


TELLING = 20.0  # nats from which the size of the impulses may show


def _mixed(e, law, level=0.0, power=30.0, share=0.01):
    """(gain over one even level, law, level, power of an impulse over it, share) by the EM algorithm from a first
    guess."""
    flat, level = np.log(e.mean()), level or np.median(e) / np.log(2)
    for _ in range(60):
        before = power
        z = e / level
        with_impulse = np.log(share) + DENSITIES[law](z, power)
        strong = _share_of(with_impulse, np.log1p(-share) - z)
        share = float(np.clip(strong.mean(), 1e-7, 0.5))
        level = (e * (1 - strong)).sum() / (1 - strong).sum()
        power = max(float((strong * e / level).sum() / max(strong.sum(), 1e-9)) - 1, 0.5)
        if abs(power - before) < 1e-3 * power:
            break
    z = e / level
    total = np.logaddexp(np.log1p(-share) - z, np.log(share) + DENSITIES[law](z, power)).sum() - len(e) * np.log(level)
    return total + len(e) * (flat + 1), law, float(level), power, share
