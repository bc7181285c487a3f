# SPDX-License-Identifier: GPL-3.0-or-later
"""A tone in the band: c·exp(j2πft). Internal: Re c, Im c over the wanted rms, cycles over the recording."""

import numpy as np

from .base import AIR, Family, complex_pair, db, start


class ToneInterference(Family):
    name = "tone_interference"
    level = "environment"
    stage = AIR

    def apply(self, chain, effect):
        re, im, cycles = effect.p
        chain.y = chain.y + chain.scene.rms * complex(re, im) * np.exp(2j * np.pi * cycles * (chain.scene.u - 0.5))

    def starts(self, view):
        for cycles in view.lines(count=2):
            yield start(self, [0.0, 0.0, cycles], trials=2 * view.scene.count)

    def values(self, scene, effect, p):
        return {"frequency_hz": p[2] / scene.duration_s, "power_dbc": db(complex_pair(p))}

    def parse(self, scene, parameters, model):
        c = 10 ** (parameters["power_dbc"] / 20) * np.exp(1j * model.get("phase_rad", 0.0))
        return start(self, [c.real, c.imag, parameters["frequency_hz"] * scene.duration_s])

    def model(self, effect):
        return {"phase_rad": float(np.angle(complex_pair(effect.p)))}

    def where(self, scene, effect, values):
        f, width = values["frequency_hz"], 1 / scene.duration_s
        return {"frequency_hz": [f - width, f + width]}

    def describe(self, number):
        return f"A tone at {number('frequency_hz')} from the carrier, {number('power_dbc')} relative to the wanted signal."
