# SPDX-License-Identifier: GPL-3.0-or-later
"""An oscillator that is off for a while: its phase turns evenly from one moment to another and stays, as after a glitch of its
loop, or, where the recording begins or ends meanwhile, a hop. Internal: radians, the two moments as shares of the recording.

No family of the contract, so never a cause in a diagnosis: found, it is told as what is left. A random phase goes on turning.
"""

import numpy as np

from .base import start
from .phase_law import PhaseLaw

SHORTEST = 1e-6  # share of a recording
AT_AN_END = 0.05  # share of it, nearer than which to an end a turn goes on there: how far is not heard


class PhaseRamp(PhaseLaw):
    name = "phase_ramp"

    def _phase(self, p, u):
        turn, first, last = p
        return turn * np.clip((u - first) / max(last - first, SHORTEST), 0.0, 1.0)

    def starts(self, view):
        for first, last, trials in view.ramps_of_phase():
            moments = [0.0 if first < AT_AN_END else first, 1.0 if last > 1 - AT_AN_END else last]
            yield start(self, [0.0, *moments], free=[True, moments[0] > 0, moments[1] < 1], trials=trials)

    def values(self, scene, effect, p):
        return {"turn_rad": p[0]}

    def where(self, scene, effect, values):
        return {"time_s": (effect.p[1:] * scene.duration_s).tolist()}

    def plausible(self, effect):
        return 0 <= effect.p[1] < effect.p[2] <= 1

    def describe(self, number):
        return f"The oscillator is off for a while: its phase turns by {number('turn_rad')}."
