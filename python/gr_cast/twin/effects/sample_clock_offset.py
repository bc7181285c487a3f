# SPDX-License-Identifier: GPL-3.0-or-later
"""Sample clock offset: the received waveform runs fast by offset_ppm, x(t(1 + ε)). Internal: samples
gained."""

from .base import CLOCK, Family, Multiplicity, Role, start
from .values import NEEDED


class SampleClockOffset(Family):
    name = "sample_clock_offset"
    sizes = (0,)
    parameters = {"offset_ppm": NEEDED}
    role = Role.CLOCK
    owners = ("tx", "rx")
    multiplicity = Multiplicity.ONE
    common = True
    stage = CLOCK

    def apply(self, chain, effect):
        chain.clock = chain.clock + effect.p[0]

    def starts(self, view):
        yield start(self, [0.0])
        drift = view.timing_drift()
        if abs(drift) > 0.2:
            yield start(self, [drift], trials=20)

    def in_time(self, scene, effect, later, longer):
        return effect.moved(effect.p * longer)

    def values(self, scene, effect, p):
        return {"offset_ppm": p[0] / scene.span * 1e6}

    def parse(self, scene, parameters, model):
        return start(self, [parameters.get("offset_ppm", 0.0) * 1e-6 * scene.span])

    def describe(self, number):
        return f"The sample clocks differ: the received waveform runs fast by {number('offset_ppm')}."
