# SPDX-License-Identifier: GPL-3.0-or-later
"""The noise floor at another level than the twin's. Internal: change in dB (found in `diagnose.run`, beside the
twin's own figure)."""

import numpy as np

from .base import Role
from .noise_family import REMEMBERED, NoiseFamily
from .values import NEEDED

BY_CHANCE = 3.0  # standard deviations by which unseen samples may fall short of what is expected


class NoiseFloor(NoiseFamily):
    name = "noise_floor"
    parameters = {"change_db": NEEDED}
    remembered = REMEMBERED
    role = Role.FLOOR
    lasting = False

    def values(self, scene, effect, p):
        return {"change_db": p[0]}

    def _levels(self, scene, parameters, model, floor, rms):
        return [parameters["change_db"]]

    def added(self, scene, effect, wanted, draw):
        return np.zeros(scene.count)  # the floor itself is another one

    def spared_nats(self, effect, count):
        """Energies of noise are exponential: a level δ higher gives so many samples δ²/2 nats each, give or take δ together."""
        change = abs(np.expm1(np.log(10) / 10 * effect.p[0]))
        return max(0.0, BY_CHANCE * change * float(np.sqrt(count)) - count * change**2 / 2)

    def describe(self, number):
        return f"The noise floor differs from the twin's by {number('change_db')}."
