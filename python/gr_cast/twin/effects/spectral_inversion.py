# SPDX-License-Identifier: GPL-3.0-or-later
"""The spectrum is inverted: the recording is the complex conjugate."""

import numpy as np

from .base import INVERSION, Family, Role, start


class SpectralInversion(Family):
    name = "spectral_inversion"
    role = Role.ORIENTATION
    stage = INVERSION

    def apply(self, chain, effect):
        chain.y = np.conj(chain.y)
        chain.wanted = np.conj(chain.wanted)
        chain.facing = -chain.facing

    def values(self, scene, effect, p):
        return {}

    def parse(self, scene, parameters, model):
        return start(self, [])

    def describe(self, number):
        return "The spectrum is inverted: I and Q are swapped, or the mixer's side is the other one."
