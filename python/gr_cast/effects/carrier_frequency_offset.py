# SPDX-License-Identifier: GPL-3.0-or-later
"""Carrier frequency offset and drift: y·exp(j2π(f·t + ½·d·t²)). Internal: cycles at mid-recording, cycles
of drift."""

import numpy as np

from .base import RX_LO, Family, start


class CarrierFrequencyOffset(Family):
    name = "carrier_frequency_offset"
    level = "tx"
    stage = RX_LO
    follows_carrier = {"offset_hz": 1, "drift_hz_per_s": 1}

    def apply(self, chain, effect):
        v = chain.u - 0.5
        chain.y = chain.y * np.exp(2j * np.pi * v * (effect.p[0] + 0.5 * effect.p[1] * v))
        chain.wanted = chain.y

    def starts(self, view):
        yield start(self, [0.0, 0.0], free=[True, False])
        yield start(self, [0.0, 0.0])
        peak = view.modulation_peak()
        if peak is not None:
            yield start(self, [peak, 0.0], trials=view.scene.count)

    def values(self, scene, effect, p):
        duration = scene.duration_s
        return {"offset_hz": (p[0] - 0.5 * p[1]) / duration, "drift_hz_per_s": p[1] / duration**2}

    def parse(self, scene, parameters, model):
        drift = parameters.get("drift_hz_per_s", 0.0) * scene.duration_s**2
        return start(self, [parameters.get("offset_hz", 0.0) * scene.duration_s + 0.5 * drift, drift])

    def describe(self, number):
        return f"The carrier lies {number('offset_hz')} off at the start and drifts by {number('drift_hz_per_s')}."
