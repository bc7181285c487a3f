# SPDX-License-Identifier: GPL-3.0-or-later
"""A slow change of gain: linear in dB or in amplitude, or a relaxation a·(1 − exp(−t/τ)) in dB (warming up). Internal: total
(nepers), ln(τ/T); aux `law`, and `before`: what a twin's own has changed before a part of a recording (nepers)."""

from dataclasses import replace

import numpy as np

from .base import Multiplicity, Role, side_of, start
from .gain_family import GainFamily
from .values import NEEDED, POSITIVE, SIDE, Value, one_of

LONGEST_BACK = 50.0  # time constants, beyond which a relaxation is not followed back
LATEST = 0.05  # of a relaxation that a part shows: with less, where it began cannot be told
DECIBELS, AMPLITUDE, RELAXATION = "decibels", "amplitude", "relaxation"  # what changes evenly, or does not
LEAST, MOST = 1e-6, 30.0  # of a factor, and nepers: amplitudes end there, whatever a search tries
LEAST_LEFT = 0.05  # of an amplitude that changes evenly beyond what was heard of it: before it ends it goes on in decibels


class GainDrift(GainFamily):
    name = "gain_drift"
    sizes = (0,)
    parameters = {"total_db": NEEDED, "time_constant_s": POSITIVE}
    remembered = {"at": SIDE, "duration_s": Value(low=1e-9), "law": one_of(DECIBELS, AMPLITUDE, RELAXATION)}
    role = Role.DRIFT
    owners = ("rx", "tx")
    multiplicity = Multiplicity.ONE
    lasting = False
    common = True

    def _nepers(self, u, effect):
        """What it has changed at `u` (n,), from 0 on."""
        change, log_tau = effect.p
        law = _law(effect)
        if law == AMPLITUDE:
            return _even(change, u)
        tau = np.exp(log_tau)
        return change * (u if law == DECIBELS else (1 - np.exp(-u / tau)) / (1 - np.exp(-1 / tau)))

    def factor(self, effect, u):
        return np.exp(effect.aux.get("before", 0.0) + self._nepers(np.maximum(u, 0.0), effect))

    def starts(self, view):
        for law in (DECIBELS, AMPLITUDE):
            yield start(self, [0.0, 0.0], free=[True, False], aux={"law": law})
        for tau in (0.03, 0.1, 0.3, 1.0):
            yield start(self, [0.0, np.log(tau)], aux={"law": RELAXATION}, trials=4)

    def in_time(self, scene, effect, later, longer):
        change, log_tau = effect.p
        if _ends(effect, later, later + longer):
            effect = replace(effect, aux={**effect.aux, "law": DECIBELS})
        if _law(effect) == RELAXATION:
            tau = np.exp(log_tau)
            back, whole = np.exp(min(-later / tau, LONGEST_BACK)), -np.expm1(-1 / tau)
            begun, gone = change * (1 - back) / whole, -back * np.expm1(-longer / tau) / whole
            change, log_tau = change * min(gone, longer / LATEST), log_tau - np.log(longer)
        else:
            begun = float(self._nepers(later, effect))
            change = float(self._nepers(later + longer, effect)) - begun
        return replace(effect, p=np.array([change, log_tau]), aux={**effect.aux, "before": effect.aux.get("before", 0.0) + begun})

    def values(self, scene, effect, p):
        tau_s = float(np.exp(np.clip(p[1], -12, 8))) * scene.duration_s
        law = self._law_of_all(scene, effect.moved(p))
        nepers = _over(p[0], scene.duration_s, scene.whole_s, law, tau_s)
        told = {"total_db": 20 / np.log(10) * nepers}
        return told | {"time_constant_s": tau_s} if _law(effect) == RELAXATION else told

    def _law_of_all(self, scene, effect) -> str:
        """Its law over the whole recording, of which `scene` may be a part."""
        return DECIBELS if _ends(effect, 0.0, scene.whole_s / scene.duration_s) else _law(effect)

    def spread(self, scene, effect, sigma2, power):
        """Both even laws bend apart by little where a burst is heard, a parabola without its mean, and go on differently where
        it is not."""
        heard = scene.u[scene.on_air()]
        if _law(effect) == RELAXATION or scene.whole != scene.span or len(heard) < 2:
            return {}
        first, last = heard[0], heard[-1]
        change = float(np.diff(self._nepers(np.array([first, last]), effect))[0])
        ends = (np.array([0.0, 1.0]) - first) / (last - first)
        begun, ended = change * ends if _law(effect) == AMPLITUDE else np.maximum(_even(change, ends), np.log(LEAST_LEFT))
        nats = 4 / 45 * np.log(np.cosh(change / 2)) ** 2 * power * scene.count / sigma2
        return {"total_db": 20 / np.log(10) * abs(ended - begun - effect.p[0]) / np.sqrt(1 + np.exp(min(nats, MOST)))}

    def parse(self, scene, parameters, model):
        tau_s = parameters.get("time_constant_s")
        law = RELAXATION if tau_s else AMPLITUDE if model.get("law") == AMPLITUDE else DECIBELS
        whole_s = model.get("duration_s", scene.whole_s)
        change = _over(parameters["total_db"] * np.log(10) / 20, whole_s, scene.duration_s, law, tau_s)
        log_tau = np.log(tau_s / scene.duration_s) if tau_s else 0.0
        return start(self, [change, log_tau], free=[True, bool(tau_s)], aux={"law": law, **side_of(model)})

    def model(self, scene, effect):
        return {**super().model(scene, effect), "duration_s": scene.whole_s, "law": self._law_of_all(scene, effect)}

    def describe(self, number):
        return f"The gain drifts by {number('total_db')} over the recording."


def _law(effect) -> str:
    return effect.aux.get("law", DECIBELS)


def _ends(effect, *at: float) -> bool:
    """Whether an amplitude that changes evenly has all but ended somewhere `at`."""
    left = 1 + np.expm1(np.clip(effect.p[0], -MOST, MOST)) * np.array(at)
    return _law(effect) == AMPLITUDE and bool(left.min() < LEAST_LEFT)


def _over(nepers: float, known_s: float, wanted_s: float, law: str, tau_s: float | None) -> float:
    """What a drift that changes so much within a time from its beginning changes within another."""
    if law == AMPLITUDE:
        return float(_even(nepers, wanted_s / known_s))
    known, wanted = (t_s if law == DECIBELS else -np.expm1(-t_s / tau_s) for t_s in (known_s, wanted_s))
    return nepers * wanted / known


def _even(nepers: float, u):
    """Nepers at `u` of an amplitude that changes evenly to so many at 1."""
    return np.log(np.maximum(1 + np.expm1(np.clip(nepers, -MOST, MOST)) * u, LEAST))
