# SPDX-License-Identifier: GPL-3.0-or-later
"""A tap of the twin with another Doppler. Internal: cycles over the recording, phase kept at mid-
recording."""

from dataclasses import replace

import numpy as np

from .base import start
from .tap import TapFamily


class TapDoppler(TapFamily):
    name = "tap_doppler"
    same_as = {"carrier_frequency_offset": "with one tap and one link: every path turns alike"}
    follows_carrier = {"doppler_hz": 1}

    def apply(self, chain, effect):
        k, extra = effect.aux["tap"], effect.p[0]
        path = chain.paths[k]
        gain = path.gain * np.exp(1j * (effect.p[1] - np.pi * extra))
        chain.paths[k] = replace(path, gain=gain, doppler=path.doppler + extra, drift=path.drift + chain.scene.drift_of(extra))

    def starts(self, view):
        for k in view.tap_order():
            yield start(self, [0.0, 0.0], aux={"tap": k}, trials=len(view.scene.taps))
            for cycles in view.tap_lines(k):
                yield start(self, [cycles, 0.0], aux={"tap": k}, trials=len(view.scene.taps) * 50)

    def later(self, effect, lengths):
        return effect.moved(effect.p + np.array([0.0, 2 * np.pi * effect.p[0] * lengths]))

    def values(self, scene, effect, p):
        return {
            "delay_s": self.delay_of(scene, effect),
            "doppler_hz": (scene.taps[effect.aux["tap"]].doppler + p[0]) / scene.duration_s,
        }

    def parse(self, scene, parameters, model):
        k = self.find(scene, parameters, model)
        extra = parameters.get("doppler_hz", 0.0) * scene.duration_s - scene.taps[k].doppler
        return start(self, [extra, np.pi * extra], aux={"tap": k})

    def describe(self, number):
        return f"The twin's path at {number('delay_s')} moves: Doppler {number('doppler_hz')}."
