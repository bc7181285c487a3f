# SPDX-License-Identifier: GPL-3.0-or-later
"""What the families have in common that change the gain over time: y·g(t), at the receiver with the noise in front of it, or
(aux side tx) at a transmitter, where it is as late as the path it takes."""

import numpy as np

from .base import RX_GAIN, TX_LO, Family


class GainFamily(Family):
    either_side = True

    def at(self, effect):
        return TX_LO if effect.aux.get("side") == "tx" else RX_GAIN

    def factor(self, scene, effect) -> np.ndarray:
        """(n,) the gain over time."""
        raise NotImplementedError

    def apply(self, chain, effect):
        factor = self.factor(chain.scene, effect)
        if effect.aux.get("side") == "tx":
            chain.modulate(effect.aux["source"], factor)
        else:
            chain.y = chain.y * factor
            chain.wanted = chain.wanted * factor

    def model(self, scene, effect):
        return {"at": effect.aux.get("side", "rx")}
