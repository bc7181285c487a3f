# SPDX-License-Identifier: GPL-3.0-or-later
"""Sample clock offset: the received waveform runs fast by offset_ppm, x(t(1 + ε)). Internal: samples
gained.

A receiver's clock (aux side rx) stretches all that comes, so that a carrier turns (1 + ε) times as often in its samples; a
transmitter's (tx) what is sent: a path that comes τ later does so by τ·(1 + ε) of its samples then. Where neither is seen no side
is said.
"""

from dataclasses import replace

from .base import CLOCK, Family, Multiplicity, Role, side_of, start
from .values import NEEDED, SIDE


class SampleClockOffset(Family):
    name = "sample_clock_offset"
    sizes = (0,)
    parameters = {"offset_ppm": NEEDED}
    remembered = {"at": SIDE}
    role = Role.CLOCK
    owners = ("tx", "rx")
    multiplicity = Multiplicity.ONE
    common = True
    stage = CLOCK
    either_side = True

    def apply(self, chain, effect):
        chain.clock = chain.clock + effect.p[0]
        if effect.aux.get("side") == "tx":
            slower = 1 + effect.p[0] / chain.scene.span
            chain.paths = [replace(p, delay=p.delay * slower) if p.source == effect.aux["source"] else p for p in chain.paths]
        elif effect.aux.get("side") == "rx":
            chain.pace = chain.pace + effect.p[0] / chain.scene.span

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
        side = {"side": "rx"} if model.get("at") == "rx" else side_of(model) if "at" in model else {}  # not by whose it is alone
        return start(self, [parameters.get("offset_ppm", 0.0) * 1e-6 * scene.span], aux=side)

    def model(self, scene, effect):
        return {"at": effect.aux["side"]} if "side" in effect.aux else {}

    def describe(self, number):
        return f"The sample clocks differ: the received waveform runs fast by {number('offset_ppm')}."
