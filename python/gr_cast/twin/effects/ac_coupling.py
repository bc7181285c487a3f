# SPDX-License-Identifier: GPL-3.0-or-later
"""A receiver that is coupled by a capacitor, or whose DC a loop takes away: a high-pass of one pole, y + d·low,
lowₙ = a·lowₙ₋₁ + (1 − a)·yₙ with a = exp(−1/τ); d = −1 where nothing of DC passes. Told as a filter, of which a row of taps
would have to be as long as its memory.

Internal: d, ln τ (samples), and Re and Im of what was left in it when the first sample came, over the wanted rms.
"""

import numpy as np
from scipy import signal as sp_signal

from ..interpolate import TAU
from .base import RX_FILTER, Family, Multiplicity, complex_pair, rms_of, start
from .values import NUMBER, POSITIVE

MEMORIES = (4.0, 16.0, 64.0, 256.0)  # samples, from which a fit finds its way
LONGEST = 1024.0  # samples: a twin is played in blocks whose ends are thrown away
MOST_OF_SCENE = 50  # times the memory, that a recording must last
WHOLE = 0.5  # of DC, by which what is taken away may differ from all of it: else it is no coupling
BINS = 512  # of the band, in whose middles its response is told


class AcCoupling(Family):
    name = "ac_coupling"
    told_as = "front_end_filter"
    parameters = {"ripple_db": NUMBER}
    remembered = {"corner_hz": POSITIVE, "passed": NUMBER}
    owners = ("rx", "tx")
    multiplicity = Multiplicity.ONE
    common = True
    relative = True
    stage = RX_FILTER
    telling = "ripple_db"

    def impulse_response(self, effect, p):
        pole = _pole(p)
        taps = p[0] * (1 - pole) * pole ** np.arange(int(8 * LONGEST))
        taps[0] += 1
        return taps

    def apply(self, chain, effect):
        pole = _pole(effect.p)
        low = sp_signal.lfilter([1 - pole], [1.0, -pole], chain.y)
        left = complex_pair(effect.p[2:]) * rms_of(chain.scene, effect) * pole ** np.arange(chain.scene.count)
        chain.y = chain.y + effect.p[0] * low + left
        chain.wanted = chain.y

    def starts(self, view):
        for memory in MEMORIES:
            if memory * MOST_OF_SCENE < view.scene.count:
                yield start(self, [0.0, np.log(memory), 0.0, 0.0], trials=len(MEMORIES))

    def plausible(self, effect):
        return abs(effect.p[0] + 1) < WHOLE and np.exp(effect.p[1]) < LONGEST

    def in_time(self, scene, effect, later, longer):
        return effect.moved(effect.p * [1.0, 1.0, 0.0, 0.0])

    def values(self, scene, effect, p):
        pole, frequency = _pole(p), (np.arange(BINS) + 0.5) / BINS
        response = np.abs(1 + p[0] * (1 - pole) / (1 - pole * np.exp(-1j * TAU * frequency)))[scene.occupied]
        return {"ripple_db": 20 * np.log10(response.max() / max(response.min(), 1e-6))}

    def parse(self, scene, parameters, model):
        memory = scene.sample_rate_hz / (TAU * model["corner_hz"])
        return start(self, [model.get("passed", 0.0) - 1, np.log(memory), 0.0, 0.0])

    def model(self, scene, effect):
        corner_hz = scene.sample_rate_hz / (TAU * np.exp(effect.p[1]))
        return {"corner_hz": float(corner_hz), "passed": float(1 + effect.p[0])}

    def describe(self, number):
        return (
            f"The receiver lets no DC through: {number('ripple_db')} between the strongest and the weakest of the occupied band."
        )


def _pole(p: np.ndarray) -> float:
    return float(np.exp(-1 / np.clip(np.exp(p[1]), 1.0, LONGEST)))
