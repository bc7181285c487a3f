# SPDX-License-Identifier: GPL-3.0-or-later
"""A slow change of gain: linear in dB, or a relaxation a·(1 − exp(−t/τ)) (warming up). Internal: total
(nepers), ln(τ/T)."""

import numpy as np

from .base import side_of, start
from .gain_family import GainFamily


class GainDrift(GainFamily):
    name = "gain_drift"

    def _shape(self, u, effect, p):
        if not effect.aux.get("relaxes"):
            return u
        tau = np.exp(p[1])
        return (1 - np.exp(-u / tau)) / (1 - np.exp(-1 / tau))

    def factor(self, effect, u):
        return np.exp(effect.p[0] * self._shape(np.maximum(u, 0.0), effect, effect.p))

    def starts(self, view):
        yield start(self, [0.0, 0.0], free=[True, False])
        for tau in (0.03, 0.1, 0.3):
            yield start(self, [0.0, np.log(tau)], aux={"relaxes": True}, trials=3)

    def values(self, scene, effect, p):
        found = {"total_db": 20 / np.log(10) * p[0]}
        if effect.aux.get("relaxes"):
            found["time_constant_s"] = float(np.exp(np.clip(p[1], -12, 8))) * scene.duration_s
        return found

    def parse(self, scene, parameters, model):
        relaxes = "time_constant_s" in parameters
        told_s, tau_s = model.get("duration_s", scene.duration_s), parameters.get("time_constant_s", np.inf)
        # "Over the recording" is over the one in which it was measured.
        share = np.expm1(-scene.duration_s / tau_s) / np.expm1(-told_s / tau_s) if relaxes else scene.duration_s / told_s
        tau = np.log(tau_s / scene.duration_s) if relaxes else 0.0
        total = parameters["total_db"] * np.log(10) / 20 * share
        return start(self, [total, tau], free=[True, relaxes], aux={"relaxes": relaxes, **side_of(model)})

    def model(self, scene, effect):
        return {**super().model(scene, effect), "duration_s": scene.duration_s}

    def describe(self, number):
        return f"The gain drifts by {number('total_db')} over the recording."
