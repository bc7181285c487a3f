# SPDX-License-Identifier: GPL-3.0-or-later
"""A tap of the twin at another delay. Internal: samples."""

from dataclasses import replace

from .base import start
from .tap import TapFamily
from .values import NEEDED


class TapDelayError(TapFamily):
    name = "tap_delay_error"
    sizes = (0,)
    parameters = {"delay_s": NEEDED, "error_s": NEEDED}

    def apply(self, chain, effect):
        k = effect.aux["tap"]
        chain.paths[k] = replace(chain.paths[k], delay=chain.paths[k].delay + effect.p[0])

    def starts(self, view):
        for k in view.tap_order():
            yield start(self, [0.0], aux={"tap": k}, trials=len(view.scene.taps))
            for jump in view.tap_shift(k):
                yield start(self, [jump], aux={"tap": k}, trials=len(view.scene.taps) * 50)

    def delays(self, scene, effect):
        return (scene.taps[effect.aux["tap"]].delay + effect.p[0],)

    def plausible(self, effect):
        return abs(effect.p[0]) < 30

    def values(self, scene, effect, p):
        return {"delay_s": self._delay_of(scene, effect), "error_s": p[0] / scene.sample_rate_hz}

    def parse(self, scene, parameters, model):
        return start(
            self,
            [parameters.get("error_s", 0.0) * scene.sample_rate_hz],
            aux={"tap": self._tap_of(scene, parameters, model)},
        )

    def describe(self, number):
        return f"The twin's path at {number('delay_s')} comes {number('error_s')} later than it says."
