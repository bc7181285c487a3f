# SPDX-License-Identifier: GPL-3.0-or-later
"""The converter clips: I and Q each limited to ±level of full scale. Internal: level."""

import numpy as np

from .base import RAILS, Family, start


class AdcClipping(Family):
    name = "adc_clipping"
    stage = RAILS

    def apply(self, chain, effect):
        level = effect.p[0]
        chain.y = np.clip(chain.y.real, -level, level) + 1j * np.clip(chain.y.imag, -level, level)

    def values(self, scene, effect, p):
        return {"level": p[0]}

    def parse(self, scene, parameters, model):
        return start(self, [parameters["level"]], free=[False])

    def describe(self, number):
        return f"The converter clips: I and Q never pass ±{number('level')} of full scale."
