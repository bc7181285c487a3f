# SPDX-License-Identifier: GPL-3.0-or-later
"""What the families have in common that change the gain over time: y·g(t), at the receiver with the noise in front of it, or
(aux side tx) at a transmitter, where it is as late as the path it takes."""

from functools import lru_cache

from .base import RX_GAIN, TX_LO, Family


class GainFamily(Family):
    either_side = True
    of_gain = True

    def at(self, effect):
        return TX_LO if effect.aux.get("side") == "tx" else RX_GAIN

    def apply(self, chain, effect):
        scene = chain.scene
        if effect.aux.get("side") == "tx":
            chain.modulate(effect.aux["source"], lru_cache(lambda late: self.factor(effect, scene.u - late / scene.span)))
        else:
            factor = self.factor(effect, scene.u)
            chain.y = chain.y * factor
            chain.wanted = chain.wanted * factor

    def model(self, scene, effect):
        return {"at": effect.aux.get("side", "rx")}
