# SPDX-License-Identifier: GPL-3.0-or-later
"""DC after the receiver's mixer, constant or decaying: y + c·exp(−t/τ). Internal: Re c, Im c over the
wanted rms, ln(τ/T)."""

import numpy as np

from .base import RX_DC, Family, Multiplicity, complex_pair, db, rms_of, said_rms, start
from .values import NEEDED, NUMBER, POSITIVE

LONGEST_BACK = 3.0  # time constants: further back, where a decay began cannot be told


class DcOffset(Family):
    name = "dc_offset"
    sizes = (0, 1)
    parameters = {"level_dbc": NEEDED, "decay_s": POSITIVE}
    remembered = {"phase_rad": NUMBER, "wanted_rms": POSITIVE}
    multiplicity = Multiplicity.ONE
    relative = True
    stage = RX_DC

    def apply(self, chain, effect):
        level = complex_pair(effect.p) * rms_of(chain.scene, effect)
        shape = np.exp(-chain.scene.u / np.exp(effect.p[2])) if effect.aux.get("decays") else 1.0
        chain.y = chain.y + level * shape

    def starts(self, view):
        yield start(self, [0.0, 0.0, 0.0], free=[True, True, False])
        for tau in (0.03, 0.1, 0.3):
            yield start(self, [0.0, 0.0, np.log(tau)], aux={"decays": True}, trials=3)

    def in_time(self, scene, effect, later, longer):
        if not effect.aux.get("decays"):
            return effect
        left = np.exp(min(-later / np.exp(effect.p[2]), LONGEST_BACK))
        return effect.moved(effect.p * [left, left, 1.0] - [0.0, 0.0, np.log(longer)])

    def values(self, scene, effect, p):
        found = {"level_dbc": db(complex_pair(p) * rms_of(scene, effect) / scene.wanted_rms)}
        if effect.aux.get("decays"):
            found["decay_s"] = float(np.exp(p[2])) * scene.duration_s
        return found

    def parse(self, scene, parameters, model):
        level = 10 ** (parameters.get("level_dbc", -200.0) / 20) * np.exp(1j * model.get("phase_rad", 0.0))
        decays = "decay_s" in parameters
        tail = np.log(parameters["decay_s"] / scene.duration_s) if decays else 0.0
        return start(self, [level.real, level.imag, tail], free=[True, True, decays], aux={"decays": decays, **said_rms(model)})

    def model(self, scene, effect):
        return {"phase_rad": float(np.angle(complex_pair(effect.p))), "wanted_rms": scene.wanted_rms}

    def describe(self, number):
        return f"The receiver adds DC, {number('level_dbc')} relative to the wanted signal."
