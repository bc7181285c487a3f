# SPDX-License-Identifier: GPL-3.0-or-later
"""A slow change of gain: linear in dB, or a relaxation a·(1 − exp(−t/τ)) (warming up). Internal: total
(nepers), ln(τ/T); aux `before`: what a twin's own has changed before a part of a recording (nepers)."""

from dataclasses import replace

import numpy as np

from .base import Multiplicity, Role, side_of, start
from .gain_family import GainFamily
from .values import NEEDED, POSITIVE, SIDE, Value

LONGEST_BACK = 50.0  # time constants, beyond which a relaxation is not followed back
LATEST = 0.05  # of a relaxation that a part shows: with less, where it began cannot be told


class GainDrift(GainFamily):
    name = "gain_drift"
    sizes = (0,)
    parameters = {"total_db": NEEDED, "time_constant_s": POSITIVE}
    remembered = {"at": SIDE, "duration_s": Value(low=1e-9)}
    role = Role.DRIFT
    owners = ("rx", "tx")
    multiplicity = Multiplicity.ONE
    lasting = False
    common = True

    def _shape(self, u, effect, p):
        """How far it has come at `u` (n,), of 1 at the end of the recording."""
        if not effect.aux.get("relaxes"):
            return u
        tau = np.exp(p[1])
        return (1 - np.exp(-u / tau)) / (1 - np.exp(-1 / tau))

    def factor(self, effect, u):
        return np.exp(effect.aux.get("before", 0.0) + effect.p[0] * self._shape(np.maximum(u, 0.0), effect, effect.p))

    def starts(self, view):
        yield start(self, [0.0, 0.0], free=[True, False])
        for tau in (0.03, 0.1, 0.3):
            yield start(self, [0.0, np.log(tau)], aux={"relaxes": True}, trials=3)

    def in_time(self, scene, effect, later, longer):
        change, log_tau = effect.p
        begun, gone = later, longer
        if effect.aux.get("relaxes"):
            tau = np.exp(log_tau)
            back, whole = np.exp(min(-later / tau, LONGEST_BACK)), -np.expm1(-1 / tau)
            begun, gone, log_tau = (1 - back) / whole, -back * np.expm1(-longer / tau) / whole, log_tau - np.log(longer)
        aux = {**effect.aux, "before": effect.aux.get("before", 0.0) + change * float(begun)}
        return replace(effect, p=np.array([change * min(gone, longer / LATEST), log_tau]), aux=aux)

    def values(self, scene, effect, p):
        tau_s = float(np.exp(np.clip(p[1], -12, 8))) * scene.duration_s if effect.aux.get("relaxes") else None
        total_db = 20 / np.log(10) * p[0] * _course(scene.whole_s, tau_s) / _course(scene.duration_s, tau_s)
        return {"total_db": total_db} if tau_s is None else {"total_db": total_db, "time_constant_s": tau_s}

    def parse(self, scene, parameters, model):
        tau_s = parameters.get("time_constant_s")
        change = parameters["total_db"] * np.log(10) / 20 / _course(model.get("duration_s", scene.whole_s), tau_s)
        change *= _course(scene.duration_s, tau_s)
        aux = {"relaxes": bool(tau_s), **side_of(model)}
        return start(self, [change, np.log(tau_s / scene.duration_s) if tau_s else 0.0], free=[True, bool(tau_s)], aux=aux)

    def model(self, scene, effect):
        return {**super().model(scene, effect), "duration_s": scene.whole_s}

    def describe(self, number):
        return f"The gain drifts by {number('total_db')} over the recording."


def _course(t_s: float, tau_s: float | None) -> float:
    """How far a drift has come after `t_s`, up to a factor."""
    return t_s if tau_s is None else -np.expm1(-t_s / tau_s)
