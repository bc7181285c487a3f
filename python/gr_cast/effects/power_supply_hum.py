# SPDX-License-Identifier: GPL-3.0-or-later
"""Hum of the power supply on the gain: y·(1 + m·cos(2πft + φ)). Internal: m·cos φ, −m·sin φ, cycles over
the recording."""

import numpy as np

from .base import RX_GAIN, Family, start


class PowerSupplyHum(Family):
    name = "power_supply_hum"
    stage = RX_GAIN

    def apply(self, chain, effect):
        a, b, cycles = effect.p
        angle = 2 * np.pi * cycles * (chain.scene.u - 0.5)
        factor = 1 + a * np.cos(angle) + b * np.sin(angle)
        chain.y = chain.y * factor
        chain.wanted = chain.wanted * factor

    def starts(self, view):
        for cycles in view.amplitude_lines(count=2):
            yield start(self, [0.0, 0.0, cycles], trials=view.hum_bins)

    def values(self, scene, effect, p):
        return {"frequency_hz": abs(p[2]) / scene.duration_s, "depth": float(np.hypot(p[0], p[1]))}

    def parse(self, scene, parameters, model):
        phase = model.get("phase_rad", 0.0)
        m = parameters["depth"]
        return start(self, [m * np.cos(phase), m * np.sin(phase), parameters["frequency_hz"] * scene.duration_s])

    def model(self, effect):
        return {"phase_rad": float(np.arctan2(effect.p[1], effect.p[0]))}

    def describe(self, number):
        return f"The gain hums at {number('frequency_hz')} with a depth of {number('depth')}."
