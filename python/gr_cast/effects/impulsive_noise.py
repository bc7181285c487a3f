# SPDX-License-Identifier: GPL-3.0-or-later
"""Single strong samples. Internal: ln of an impulse's power over the floor, ln of their share of samples."""

import numpy as np

from .base import start
from .noise_family import NoiseFamily


class ImpulsiveNoise(NoiseFamily):
    name = "impulsive_noise"
    level = "environment"
    strengths = 2

    def values(self, scene, effect, p):
        floor = effect.aux["_floor"]
        return {
            "rate_hz": float(np.exp(p[1])) * scene.sample_rate_hz,
            "power_db": 10 * np.log10(np.exp(p[0]) * floor),
        }

    def levels(self, scene, parameters, model, floor, rms):
        share = parameters["rate_hz"] / scene.sample_rate_hz
        return [np.log(10 ** (parameters["power_db"] / 10) / floor), np.log(share)]

    def added(self, scene, effect, wanted, draw):
        strength, share = effect.p
        hit = np.abs(draw()) ** 2 > -share  # an exponential number passes −ln p with probability p
        return np.where(hit, np.sqrt(effect.aux["_floor"] * np.exp(strength)) * draw(), 0.0)

    def describe(self, number):
        return f"Impulses: {number('rate_hz')} of them, each {number('power_db')} re full scale."

    def find(self, view, near=None):
        """(gain, effect) of a mixture: a share p of samples with 1 + k times the power."""
        e = view.energy[view.use]
        core = np.median(e) / np.log(2)
        e = e / core
        p, k = 0.01, 30.0
        if (e > 9).sum() < 3:
            return 0.0, None
        for _ in range(60):
            heavy = p / (1 + k) * np.exp(np.clip(-e / (1 + k), -700, 0))
            light = (1 - p) * np.exp(np.clip(-e, -700, 0))
            share = heavy / (heavy + light + 1e-300)
            p = float(np.clip(share.mean(), 1e-7, 0.5))
            level = (e * (1 - share)).sum() / (1 - share).sum()
            e, k = e / level, max(float((share * e / level).sum() / share.sum()) - 1, 0.5)
        mixture = np.log((1 - p) * np.exp(-e) + p / (1 + k) * np.exp(-e / (1 + k))).sum()
        gain = mixture + len(e) * (np.log(e.mean()) + 1)
        if p > 0.2:
            return 0.0, None
        return gain, start(self, [np.log(k), np.log(p)], free=[False] * 2)
