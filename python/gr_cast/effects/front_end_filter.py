# SPDX-License-Identifier: GPL-3.0-or-later
"""Roll-off, ripple and group delay of a front end: a short complex FIR on the received signal, its main tap
1.

Internal: real and imaginary parts of the taps from aux low to aux high, the main tap left out.
"""

import numpy as np

from .base import RX_FILTER, Effect, Family, shifted, start

SIZES = (
    (0, 1),
    (-1, 0),
    (-1, 1),
    (0, 2),
    (-2, 2),
    (0, 4),
    (-4, 4),
    (0, 8),
    (-8, 8),
    (-4, 16),
    (-16, 16),
    (-10, 25),
)


class FrontEndFilter(Family):
    name = "front_end_filter"
    stage = RX_FILTER
    linear = True

    @staticmethod
    def impulse_response(effect, p):
        low, high = effect.aux["low"], effect.aux["high"]
        taps = np.zeros(high - low + 1, complex)
        taps[np.arange(low, high + 1) != 0] = p[::2] + 1j * p[1::2]
        taps[-low] = 1.0
        return taps

    def apply(self, chain, effect):
        taps, low = self.impulse_response(effect, effect.p), effect.aux["low"]
        full = np.convolve(chain.y, taps)
        chain.y = full[-low : -low + chain.scene.count]
        chain.wanted = chain.y

    def nest(self, scene, effect):
        low, high = -16, min(25, scene.count // 12 - 17)
        lags = np.delete(np.arange(low, high + 1), -low)
        size = 2 * len(lags)
        whole = Effect(
            family=self.name, p=np.zeros(size), free=np.ones(size, bool), aux={"low": low, "high": high}
        )
        mine = np.isin(
            lags, np.delete(np.arange(effect.aux["low"], effect.aux["high"] + 1), -effect.aux["low"])
        )
        return "taps", whole, np.flatnonzero(np.repeat(mine, 2))

    def columns(self, scene, effect, chain, before, rest):
        lags = np.delete(np.arange(effect.aux["low"], effect.aux["high"] + 1), -effect.aux["low"])
        c = np.array([shifted(before.y, lag) for lag in lags])
        return np.stack([c, 1j * c], 1).reshape(2 * len(lags), -1)

    def starts(self, view):
        for low, high in SIZES:
            if low < -16 or max(-low, high) > view.scene.count // 24:
                continue
            lags = np.delete(np.arange(low, high + 1), -low)
            # Far taps are expected to be smaller; the strength is chosen by evidence.
            prior = np.repeat(1.0 / (1.0 + np.abs(lags)) ** 1.5, 2) if high - low > 4 else None
            yield start(
                self, np.zeros(2 * len(lags)), aux={"low": low, "high": high}, prior=prior, trials=len(SIZES)
            )

    def values(self, scene, effect, p):
        response = np.abs(np.fft.fft(self.impulse_response(effect, p), 512))
        inside = response[scene.occupied]
        return {"ripple_db": 20 * np.log10(inside.max() / max(inside.min(), 1e-6))}

    def parse(self, scene, parameters, model):
        taps = model.get("taps", [])
        low = int(model.get("low", 0))
        return start(self, taps, aux={"low": low, "high": low + len(taps) // 2})

    def model(self, effect):
        return {"low": effect.aux["low"], "taps": [float(v) for v in effect.p]}

    def describe(self, number):
        return (
            f"The front end filters the signal: {number('ripple_db')} between the strongest and the "
            "weakest of the occupied band."
        )
