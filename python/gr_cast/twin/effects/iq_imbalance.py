# SPDX-License-Identifier: GPL-3.0-or-later
"""I/Q imbalance: y + β·y*, at the receiver or (aux side tx) at the transmitter. Internal: Re β, Im β.

With unequal gain 1 + g and phase error φ the image factor is β = (1 − G·e^{jφ})/(1 + G·e^{jφ}), G = 1 + g.
"""

import numpy as np

from .base import RX_IQ, TX_IQ, Family, complex_pair, db, start
from .values import NUMBER

WEAKEST = 10 ** (-75 / 20)  # no radio is balanced better, whatever the data would carry
STRONGEST = 10 ** (-10 / 20)  # nothing that calls itself a radio is balanced worse


class IqImbalance(Family):
    name = "iq_imbalance"
    sizes = (0, 1)
    parameters = {"image_rejection_db": NUMBER, "gain_imbalance_db": NUMBER, "phase_imbalance_rad": NUMBER}
    owners = ("rx", "tx")
    common = True
    two_sided = True

    def at(self, effect):
        return TX_IQ if effect.aux.get("side") == "tx" else RX_IQ

    def apply(self, chain, effect):
        beta = complex_pair(effect.p)
        if effect.aux.get("side") == "tx":
            i = effect.aux["source"]
            chain.waves[i] = chain.waves[i] + beta * np.conj(chain.waves[i])
        else:
            chain.y = chain.y + beta * np.conj(chain.y)

    def starts(self, view):
        yield start(self, [0.0, 0.0], aux={"side": "rx"})
        for i in range(len(view.scene.sources)):
            yield start(self, [0.0, 0.0], aux={"side": "tx", "source": i})

    def plausible(self, effect):
        return WEAKEST < abs(complex_pair(effect.p)) < STRONGEST

    def noise_gain_db(self, effect):
        image = abs(complex_pair(effect.p))  # noise passes a receiver's unequal gains too
        return db((1 + image) / (1 - image))

    def values(self, scene, effect, p):
        beta = complex_pair(p)
        ratio = (1 - beta) / (1 + beta)
        return {
            "image_rejection_db": -db(beta),
            "gain_imbalance_db": db(ratio),
            "phase_imbalance_rad": float(np.angle(ratio)),
        }

    def parse(self, scene, parameters, model):
        ratio = 10 ** (parameters.get("gain_imbalance_db", 0.0) / 20) * np.exp(1j * parameters.get("phase_imbalance_rad", 0.0))
        beta = (1 - ratio) / (1 + ratio)
        if not {"gain_imbalance_db", "phase_imbalance_rad"} & {*parameters}:  # an image of that level, by the gains alone
            beta = complex(10 ** (-parameters["image_rejection_db"] / 20))
        return start(
            self,
            [beta.real, beta.imag],
            aux={"side": model.get("side", "rx"), "source": model.get("source", 0)},
        )

    def describe(self, number):
        return (
            f"I and Q are unbalanced: an image {number('image_rejection_db')} below the signal "
            f"(gain {number('gain_imbalance_db')}, phase {number('phase_imbalance_rad')})."
        )
