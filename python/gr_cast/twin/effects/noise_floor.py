# SPDX-License-Identifier: GPL-3.0-or-later
"""The noise floor at another level than the twin's. Internal: change in dB (found in `diagnose.run`, beside the
twin's own figure)."""

import numpy as np

from .base import Role
from .noise_family import REMEMBERED, NoiseFamily
from .values import NEEDED


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

    def describe(self, number):
        return f"The noise floor differs from the twin's by {number('change_db')}."
