# SPDX-License-Identifier: GPL-3.0-or-later
"""Hum of the power supply on the gain: y·(1 + m·cos(2πft + φ)). Internal: m·cos φ, −m·sin φ, cycles over
the recording."""

import numpy as np

from .base import Multiplicity, amid, side_of, start, turned
from .gain_family import GainFamily


class PowerSupplyHum(GainFamily):
    name = "power_supply_hum"
    owners = ("rx", "tx")
    multiplicity = Multiplicity.ONE

    def factor(self, effect, u):
        a, b, cycles = effect.p
        angle = 2 * np.pi * cycles * (u - 0.5)
        return 1 + a * np.cos(angle) + b * np.sin(angle)

    def starts(self, view):
        for cycles in view.amplitude_lines(count=2):
            yield start(self, [0.0, 0.0, cycles], trials=view.hum_bins)

    def in_time(self, scene, effect, later, longer):
        return effect.moved(turned(effect.p, -effect.p[2] * amid(later, longer)) * [1.0, 1.0, longer])

    def values(self, scene, effect, p):
        return {"frequency_hz": abs(p[2]) / scene.duration_s, "depth": float(np.hypot(p[0], p[1]))}

    def parse(self, scene, parameters, model):
        m, cycles = parameters["depth"], parameters["frequency_hz"] * scene.duration_s
        phase = model.get("phase_rad", 0.0) + np.pi * cycles
        return start(self, [m * np.cos(phase), -m * np.sin(phase), cycles], aux=side_of(model))

    def model(self, scene, effect):
        cycles = abs(effect.p[2])
        phase = np.arctan2(-np.sign(effect.p[2]) * effect.p[1], effect.p[0]) - np.pi * cycles  # at t = 0
        return {**super().model(scene, effect), "phase_rad": float((phase + np.pi) % (2 * np.pi) - np.pi)}

    def describe(self, number):
        return f"The gain hums at {number('frequency_hz')} with a depth of {number('depth')}."
