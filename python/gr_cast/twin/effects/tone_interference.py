# SPDX-License-Identifier: GPL-3.0-or-later
"""A tone in the band: c·exp(j2πft). Internal: Re c, Im c over the wanted rms, cycles over the recording."""

import numpy as np

from ..interpolate import turning
from .base import AIR, Family, Multiplicity, amid, complex_pair, db, rms_of, said_rms, start, turned
from .values import NEEDED, NUMBER, POSITIVE

CYCLES_APART = 4.0  # over the recording, by which tones of two recordings may differ and be one


class ToneInterference(Family):
    name = "tone_interference"
    sizes = (0, 1)
    parameters = {"frequency_hz": NEEDED, "power_dbc": NEEDED}
    remembered = {"phase_rad": NUMBER, "wanted_rms": POSITIVE}
    owners = ("environment",)
    multiplicity = Multiplicity.MANY
    relative = True
    place = 2
    stage = AIR

    def apply(self, chain, effect):
        re, im, cycles = effect.p
        begun = rms_of(chain.scene, effect) * complex(re, im) * np.exp(-1j * np.pi * cycles)
        chain.y = chain.y + begun * turning(cycles, chain.u)  # in the air it goes on while a recorder loses samples

    def starts(self, view):
        for cycles in view.lines(count=2):
            if abs(cycles) < 1:  # that is the receiver's DC
                continue
            yield start(self, [0.0, 0.0, cycles], trials=2 * view.scene.span)

    def in_time(self, scene, effect, later, longer):
        return effect.moved(turned(effect.p, effect.p[2] * amid(later, longer)) * [1.0, 1.0, longer])

    def values(self, scene, effect, p):
        power_dbc = db(complex_pair(p) * rms_of(scene, effect) / scene.wanted_rms)
        return {"frequency_hz": p[2] / scene.duration_s, "power_dbc": power_dbc}

    def parse(self, scene, parameters, model):
        cycles = parameters["frequency_hz"] * scene.duration_s
        c = 10 ** (parameters["power_dbc"] / 20) * np.exp(1j * (model.get("phase_rad", 0.0) + np.pi * cycles))
        return start(self, [c.real, c.imag, cycles], aux=said_rms(model))

    def model(self, scene, effect):
        phase_rad = np.angle(complex_pair(effect.p) * np.exp(-1j * np.pi * effect.p[2]))  # at t = 0
        return {"phase_rad": float(phase_rad), "wanted_rms": scene.wanted_rms}

    def placed(self, scene, told):
        return told["frequency_hz"]["value"] * scene.duration_s / CYCLES_APART, 0.0

    def where(self, scene, effect, values):
        f, width = values["frequency_hz"], 1 / scene.duration_s
        return {"frequency_hz": [f - width, f + width]}

    def describe(self, number):
        return f"A tone at {number('frequency_hz')} from the carrier, {number('power_dbc')} relative to the wanted signal."
