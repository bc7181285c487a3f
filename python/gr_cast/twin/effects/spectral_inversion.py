# SPDX-License-Identifier: GPL-3.0-or-later
"""The spectrum is inverted: the recording is the complex conjugate."""

import numpy as np

from .base import INVERSION, Family, Role, start


class SpectralInversion(Family):
    name = "spectral_inversion"
    role = Role.ORIENTATION
    stage = INVERSION
    leaps = True  # gain and phase must turn with it

    def starts(self, view):
        """Of a real waveform over several paths: mirrored it is itself, and only how the paths' phases fit tells."""
        if len(view.scene.taps) > 1 and all(s.on_one_line for s in view.scene.sources):
            yield start(self, [])

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
