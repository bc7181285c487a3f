# SPDX-License-Identifier: GPL-3.0-or-later
"""LO leakage at the transmitter's carrier: a constant sent along with the waveform. Internal: Re c, Im c
over the rms of x."""

import numpy as np

from .base import TX_LEAK, Family, complex_pair, db, start
from .values import NEEDED, NUMBER, POSITIVE


class LoLeakage(Family):
    name = "lo_leakage"
    sizes = (0, 1)
    parameters = {"level_dbc": NEEDED}
    remembered = {"phase_rad": NUMBER, "sent_power": POSITIVE}
    owners = ("tx",)
    stage = TX_LEAK

    def apply(self, chain, effect):
        i = effect.aux["source"]
        level = complex_pair(effect.p) * np.sqrt(chain.scene.sources[i].power)
        chain.leaks[i] = chain.leaks.get(i, 0.0) + level

    def starts(self, view):
        for i in range(len(view.scene.sources)):
            yield start(self, [0.0, 0.0], aux={"source": i})

    def values(self, scene, effect, p):
        return {"level_dbc": db(complex_pair(p))}

    def parse(self, scene, parameters, model):
        level = 10 ** (parameters.get("level_dbc", -200.0) / 20) * np.exp(1j * model.get("phase_rad", 0.0))
        i = model.get("source", 0)
        if "sent_power" in model:  # the leak stays what it was, whatever is sent
            level *= np.sqrt(model["sent_power"] / scene.sources[i].power)
        return start(self, [level.real, level.imag], aux={"source": i})

    def model(self, scene, effect):
        sent_power = scene.sources[effect.aux["source"]].power
        return {"phase_rad": float(np.angle(complex_pair(effect.p))), "sent_power": sent_power}

    def describe(self, number):
        return f"The transmitter's oscillator leaks, {number('level_dbc')} relative to its signal."
