# SPDX-License-Identifier: GPL-3.0-or-later
"""A receiver that bends by even orders: y + a·|y|² + b·y², without the constant that it adds, which is DC. Internal: real and
imaginary parts of a and b over the rms of the wanted signal.

No family of the contract, so never a cause in a diagnosis: found, it is told as what is left.
"""

import numpy as np

from .base import RX_IQ, Family, Multiplicity, complex_pair, rms_of, start

LEAST_VARIED = 1e-6  # of the mean of |y|², squared: an envelope that varies less makes nothing but DC


class SecondOrder(Family):
    name = "second_order"
    multiplicity = Multiplicity.ONE
    relative = True
    stage = RX_IQ
    linear = True
    sizes = (0, 1, 2, 3)
    beyond = True

    def apply(self, chain, effect):
        if effect.p.any():  # else as it is where a search begins
            y, rms = chain.y, rms_of(chain.scene, effect)
            squared = np.abs(y) ** 2
            chain.y = y + (complex_pair(effect.p) * (squared - squared.mean()) + complex_pair(effect.p[2:]) * y**2) / rms

    def mirrored(self, effect):
        return effect.moved(effect.p * [1.0, -1.0, 1.0, -1.0])

    def starts(self, view):
        power = np.abs(view.wanted) ** 2
        if np.var(power) > LEAST_VARIED * np.mean(power) ** 2:
            for both in (False, True):
                yield start(self, np.zeros(4), free=[True, True, both, both], trials=4)

    def values(self, scene, effect, p):
        return {"level": float(np.hypot(abs(complex_pair(p)), abs(complex_pair(p[2:]))))}

    def describe(self, number):
        return f"The receiver bends by even orders, {number('level')} of the signal at its rms."
