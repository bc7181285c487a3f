# SPDX-License-Identifier: GPL-3.0-or-later
"""A step of gain at one moment: y·exp(s) from t0 on. Internal: s (nepers), t0 as a share of the recording
(found by search)."""

import numpy as np

from .base import Multiplicity, Role, side_of, start
from .gain_family import GainFamily
from .values import NEEDED, SIDE

SHARE_APART = 0.01  # of the recording, by which two steps are told apart
HEAVY = 2.5  # of the standard deviation of its time: its errors fall off like exp(−|t|), one in 200 is eight of them
LEAST_PART = 16  # samples on either side of a step
LEAST_ENERGY = 1e-9  # of all, that is heard on either side: what is summed of less is rounding
LARGEST_STEP = 100.0  # nepers: a trial beyond it is as far off, and its square can still be held


class GainStep(GainFamily):
    name = "gain_step"
    sizes = (0,)
    parameters = {"time_s": NEEDED, "step_db": NEEDED}
    remembered = {"at": SIDE}
    role = Role.STEP
    owners = ("rx", "tx")
    multiplicity = Multiplicity.MANY
    place, place_step = 1, SHARE_APART
    lasting = False

    def factor(self, effect, u):
        step, u0 = effect.p
        return np.where(u >= u0, np.exp(min(step, LARGEST_STEP)), 1.0)

    def starts(self, view):
        score, norm = view.amplitude_moments()
        a, e = np.cumsum(score), np.cumsum(norm)
        low, high = LEAST_PART, len(e) - LEAST_PART
        if high - low < LEAST_PART:
            return
        share = e / e[-1]
        sides = np.where(share * (1 - share) > LEAST_ENERGY, share * (1 - share), np.inf)
        gain = (a - share * a[-1]) ** 2 / (e[-1] * sides)
        at = low + int(np.argmax(gain[low:high]))
        yield start(self, [0.0, view.scene.u[min(at + 1, view.scene.count - 1)]], free=[True, False], trials=200)

    def moment(self, scene, effect):
        return float(effect.p[1] * scene.span)

    def happening(self, scene, effect, first):
        return effect.moved(np.array([effect.p[0], first / scene.span]))

    def in_time(self, scene, effect, later, longer):
        return effect.moved((effect.p - [0.0, later]) / [1.0, longer])

    def spread(self, scene, effect, sigma2, power):
        """Hinkley (1970): a change of mean is placed to a few noise variances over its square."""
        change = (np.exp(effect.p[0]) - 1) ** 2 * power
        return {"time_s": (0.5 + 2.5 * sigma2 / change) / scene.sample_rate_hz}

    def placed(self, scene, told):
        unit_s = SHARE_APART * scene.duration_s
        return told["time_s"]["value"] / unit_s, HEAVY * told["time_s"]["std"] / unit_s

    def resolution(self, scene, name, value):
        return 2.0 / scene.sample_rate_hz if name == "time_s" else super().resolution(scene, name, value)

    def plausible(self, effect):
        return abs(effect.p[0]) < 4

    def values(self, scene, effect, p):
        return {"time_s": p[1] * scene.duration_s, "step_db": 20 / np.log(10) * p[0]}

    def parse(self, scene, parameters, model):
        return start(
            self,
            [parameters["step_db"] * np.log(10) / 20, parameters["time_s"] / scene.duration_s],
            free=[True, False],
            aux=side_of(model),
        )

    def where(self, scene, effect, values):
        t, reach = values["time_s"], 0.005 * scene.duration_s + effect.aux.get("gap", 0.0) / 2 / scene.sample_rate_hz
        return {"time_s": [t - reach, t + reach]}

    def describe(self, number):
        return f"The gain steps by {number('step_db')} at {number('time_s')}."
