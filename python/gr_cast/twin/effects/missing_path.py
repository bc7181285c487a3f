# SPDX-License-Identifier: GPL-3.0-or-later
"""A tap of the twin that is not there in the world. No free number."""

from dataclasses import replace

from .base import start
from .tap import TapFamily
from .values import NEEDED


class MissingPath(TapFamily):
    name = "missing_path"
    parameters = {"delay_s": NEEDED}

    def apply(self, chain, effect):
        k = effect.aux["tap"]
        chain.paths[k] = replace(chain.paths[k], gain=0.0)

    def starts(self, view):
        for k in range(len(view.scene.taps)):
            if sum(t.source == view.scene.taps[k].source for t in view.scene.taps) > 1:
                yield start(self, [], aux={"tap": k}, trials=len(view.scene.taps))

    def elsewhere(self, scene):
        for k, late in self._others(scene):
            yield late, start(self, [], aux={"tap": k}, trials=len(scene.taps))

    def values(self, scene, effect, p):
        return {"delay_s": self._delay_of(scene, effect)}

    def parse(self, scene, parameters, model):
        return start(self, [], aux={"tap": self._tap_of(scene, parameters, model)})

    def describe(self, number):
        return f"The twin's path at {number('delay_s')} is not there."
