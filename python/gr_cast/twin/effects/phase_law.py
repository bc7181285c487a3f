# SPDX-License-Identifier: GPL-3.0-or-later
"""What the laws have in common that a receiver's phase follows and no family of the contract has: y·exp(jφ(u)), the first number
the size of φ in rad. Found, one is told as what is left, never as a cause; a random phase stands in its place or not at all.
"""

import numpy as np

from .base import RX_LO, Family, Multiplicity
from .phase_noise import PhaseNoise


class PhaseLaw(Family):
    multiplicity = Multiplicity.ONE
    lasting = False
    stage = RX_LO
    sizes = (0,)
    beyond = True

    def _phase(self, p: np.ndarray, u: np.ndarray) -> np.ndarray:
        """(n,) rad at shares `u` (n,) of the recording."""
        raise NotImplementedError

    def apply(self, chain, effect):
        chain.y = chain.y * np.exp(1j * self._phase(effect.p, chain.u))
        chain.wanted = chain.y

    def mirrored(self, effect):
        return effect.moved(np.array([-effect.p[0], *effect.p[1:]]))

    def excludes(self, effect, other):
        return other.family == PhaseNoise.name
