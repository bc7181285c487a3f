# SPDX-License-Identifier: GPL-3.0-or-later
"""A tap of the twin with another strength and phase. Internal: ln of the ratio of amplitudes, phase."""

from dataclasses import replace

import numpy as np

from .base import start
from .tap import TapFamily
from .values import NEEDED, NUMBER

GONE = 1e-3  # of a path's amplitude: less is nothing
WEAK = -2.3  # nepers: a strongest path a tenth as strong, which is no longer found at its delay


class TapGainError(TapFamily):
    name = "tap_gain_error"
    sizes = (0, 1)
    parameters = {"delay_s": NEEDED, "error_db": NUMBER, "error_rad": NUMBER}

    def apply(self, chain, effect):
        k = effect.aux["tap"]
        chain.paths[k] = replace(chain.paths[k], gain=chain.paths[k].gain * np.exp(complex(*effect.p)))

    def stepped(self, p, step):
        """The complex gain goes straight, its logarithm does not."""
        gain = np.exp(complex(*p)) * (1 + complex(*step))
        return np.array([np.log(max(abs(gain), GONE)), np.angle(gain)])

    def starts(self, view):
        for k in view.tap_order():
            yield start(self, [0.0, 0.0], aux={"tap": k}, trials=len(view.scene.taps))

    def elsewhere(self, scene):
        for k, late in self._others(scene):
            yield late, start(self, [WEAK, 0.0], aux={"tap": k}, trials=len(scene.taps))

    def values(self, scene, effect, p):
        return {
            "delay_s": self._delay_of(scene, effect),
            "error_db": 20 / np.log(10) * p[0],
            "error_rad": float((p[1] + np.pi) % (2 * np.pi) - np.pi),
        }

    def contradiction(self, parameters, model):
        return None if {"error_db", "error_rad"} & {*parameters} else "needs error_db or error_rad"

    def parse(self, scene, parameters, model):
        p = [parameters.get("error_db", 0.0) * np.log(10) / 20, parameters.get("error_rad", 0.0)]
        return start(self, p, aux={"tap": self._tap_of(scene, parameters, model)})

    def describe(self, number):
        return f"The twin's path at {number('delay_s')} is off by {number('error_db')} and {number('error_rad')}."
