# SPDX-License-Identifier: GPL-3.0-or-later
"""Carrier frequency offset and drift: y·exp(j2π(f·t + ½·d·t²)). Internal: cycles at mid-recording, cycles
of drift, which stays 0 in recordings too short for an oscillator to drift.

A transmitter's offset (aux side tx) is delayed with its signal: a path that comes τ later is turned by −2πf·τ against what
a receiver's offset makes of it. Where no path comes much later the two are the same, and no side is said.
"""

import numpy as np

from .base import RX_LO, TX_LO, Family, Multiplicity, Role, amid, side_of, start
from .values import NUMBER, SIDE

FASTEST_DRIFT = 1e-3  # share of the carrier per second; what turns faster is no oscillator's drift
LEAST_DRIFT = 0.1  # cycles of it that a recording must be long enough for


class CarrierFrequencyOffset(Family):
    name = "carrier_frequency_offset"
    sizes = (0, 1)
    parameters = {"offset_hz": NUMBER, "drift_hz_per_s": NUMBER}
    remembered = {"at": SIDE}
    role = Role.CARRIER
    owners = ("tx", "rx")
    multiplicity = Multiplicity.ONE
    common = True
    stage = RX_LO
    either_side = True
    follows_carrier = {"offset_hz": 1, "drift_hz_per_s": 1}

    def at(self, effect):
        return TX_LO if effect.aux.get("side") == "tx" else RX_LO

    def apply(self, chain, effect):
        if effect.aux.get("side") == "tx":
            i = effect.aux["source"]
            chain.carriers = {**chain.carriers, i: chain.carriers.get(i, 0.0) + effect.p}
        else:
            chain.y = chain.y * chain.turn(effect.p)
            chain.wanted = chain.y
            chain.turned += float(effect.p[0])

    def starts(self, view):
        own = [e for e in view.fit.model.effects if e.fixed and e.family == self.name]
        if any(e.free[0] for e in own):  # how far it lies off is fitted already
            if self._can_drift(view.scene):
                yield start(self, [0.0, 0.0], free=[False, True])
            return
        yield start(self, [0.0, 0.0], free=[True, False])
        if self._can_drift(view.scene):
            yield start(self, [0.0, 0.0])
        peak = view.modulation_peak()
        if peak is not None:
            yield start(self, [peak, 0.0], free=[True, self._can_drift(view.scene)], trials=view.scene.span)

    @staticmethod
    def _can_drift(scene) -> bool:
        """Whether an oscillator's drift could show within the recording."""
        return not scene.carrier_hz or FASTEST_DRIFT * scene.carrier_hz * scene.duration_s**2 > LEAST_DRIFT

    def settled(self, scene, effect):
        return np.array([effect.free[0], self._can_drift(scene)])

    def mirrored(self, effect):
        return effect.moved(-effect.p)

    def in_time(self, scene, effect, later, longer):
        cycles, drift = effect.p
        return effect.moved(np.array([(cycles + drift * amid(later, longer)) * longer, drift * longer**2]))

    def values(self, scene, effect, p):
        duration = scene.duration_s
        return {"offset_hz": (p[0] - 0.5 * p[1]) / duration, "drift_hz_per_s": p[1] / duration**2}

    def contradiction(self, parameters, model):
        return None if parameters else "needs offset_hz or drift_hz_per_s"

    def parse(self, scene, parameters, model):
        drift = parameters.get("drift_hz_per_s", 0.0) * scene.duration_s**2
        return start(self, [parameters.get("offset_hz", 0.0) * scene.duration_s + 0.5 * drift, drift], aux=side_of(model))

    def model(self, scene, effect):
        return {"at": effect.aux.get("side", "rx")} if "side" in effect.aux or len(scene.sources) > 1 else {}

    def describe(self, number):
        drift = number("drift_hz_per_s")
        drifts = "" if drift == "0 Hz/s" else f" at the start and drifts by {drift}"  # too short a recording shows none
        return f"The carrier lies {number('offset_hz')} off{drifts}."
