# SPDX-License-Identifier: GPL-3.0-or-later
"""A slow change of gain: linear in dB, or a relaxation a·(1 − exp(−t/τ)) (warming up). Internal: total
(nepers), ln(τ/T)."""

import numpy as np

from .base import side_of, start
from .gain_family import GainFamily

LATEST = 0.05  # of a relaxation that is still to come: with less, where it began cannot be told


class GainDrift(GainFamily):
    name = "gain_drift"

    def _shape(self, u, effect, p):
        if not effect.aux.get("relaxes"):
            return u
        tau = np.exp(p[1])
        return (1 - np.exp(-u / tau)) / (1 - np.exp(-1 / tau))

    def factor(self, effect, u):
        return np.exp(effect.p[0] * self._shape(np.maximum(u, 0.0), effect, effect.p))

    def before(self, scene, effect) -> float:
        """Nepers by which the gain has changed from the recording's beginning until a scene's."""
        lengths = scene.begins / scene.span
        if not effect.aux.get("relaxes"):
            return float(effect.p[0] * lengths)
        tau = np.exp(effect.p[1])
        return float(effect.p[0] * np.expm1(min(lengths / tau, -np.log(LATEST))) / -np.expm1(-1 / tau))

    def starts(self, view):
        yield start(self, [0.0, 0.0], free=[True, False])
        for tau in (0.03, 0.1, 0.3):
            yield start(self, [0.0, np.log(tau)], aux={"relaxes": True}, trials=3)

    def values(self, scene, effect, p):
        tau_s = float(np.exp(np.clip(p[1], -12, 8))) * scene.duration_s if effect.aux.get("relaxes") else None
        total_db = 20 / np.log(10) * p[0] / _share(scene, scene.whole / scene.sample_rate_hz, tau_s)
        return {"total_db": total_db} if tau_s is None else {"total_db": total_db, "time_constant_s": tau_s}

    def parse(self, scene, parameters, model):
        tau_s = parameters.get("time_constant_s")
        share = _share(scene, model.get("duration_s", scene.whole / scene.sample_rate_hz), tau_s)
        tau = np.log(tau_s / scene.duration_s) if tau_s else 0.0
        total = parameters["total_db"] * np.log(10) / 20 * share
        return start(self, [total, tau], free=[True, bool(tau_s)], aux={"relaxes": bool(tau_s), **side_of(model)})

    def model(self, scene, effect):
        return {**super().model(scene, effect), "duration_s": scene.whole / scene.sample_rate_hz}

    def describe(self, number):
        return f"The gain drifts by {number('total_db')} over the recording."


def _share(scene, told_s: float, tau_s: float | None) -> float:
    """The change of gain within a scene over that of a whole recording of `told_s` seconds, the one in which it is measured."""
    if tau_s is None:
        return scene.duration_s / told_s
    begun = max(np.exp(-scene.begins / scene.sample_rate_hz / tau_s), LATEST)
    return begun * np.expm1(-scene.duration_s / tau_s) / np.expm1(-told_s / tau_s)
