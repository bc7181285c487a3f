# SPDX-License-Identifier: GPL-3.0-or-later
"""Hum of the power supply on the gain: y·(1 + m·cos(2πft + φ)), and harmonics of it, as a rectifier makes them. Internal:
m·cos φ, −m·sin φ, cycles over the recording, then the first two of each harmonic from the second on."""

from dataclasses import replace

import numpy as np

from ..interpolate import turning
from .base import Multiplicity, amid, side_of, start, turned
from .gain_drift import AMPLITUDE, DECIBELS, RELAXATION, GainDrift
from .gain_family import GainFamily
from .values import NEEDED, NUMBER, SIDE

MOST = range(2, 9)  # harmonics that a twin may tell


def pairs(p: np.ndarray) -> np.ndarray:
    """(harmonics, 2) m·cos φ and −m·sin φ of the fundamental and its harmonics."""
    return np.concatenate([p[:2], p[3:]]).reshape(-1, 2)


class PowerSupplyHum(GainFamily):
    name = "power_supply_hum"
    sizes = (0, 1)
    parameters = {"frequency_hz": NEEDED, "depth": NEEDED}
    remembered = {"phase_rad": NUMBER, "at": SIDE} | {n: NUMBER for k in MOST for n in (f"depth_{k}", f"phase_{k}_rad")}
    owners = ("rx", "tx")
    multiplicity = Multiplicity.ONE

    def factor(self, effect, u):
        turn = turning(effect.p[2], u) * np.exp(-1j * np.pi * effect.p[2])  # from mid-recording
        swing = np.zeros_like(turn)
        for a, b in pairs(effect.p)[::-1]:  # Horner's rule: a polynomial in the fundamental's turn
            swing += a - 1j * b
            swing *= turn
        return 1.0 + swing.real

    def starts(self, view):
        for cycles, harmonics in view.hums(count=2):
            yield start(self, [0.0, 0.0, cycles, *[0.0] * (2 * harmonics - 2)], trials=view.hum_bins)

    def less(self, scene, effect, others):
        """Without harmonics or, where the second is stronger than the fundamental, of the even ones alone, whose own is twice as
        fast; and where not even one period is seen, a drift."""
        plain, even = effect.p[:3], pairs(effect.p)[1::2]
        if len(effect.p) > len(plain):
            twice = np.array([*even[0], 2 * effect.p[2], *even[1:].ravel()])
            fewer = twice if np.hypot(*even[0]) > np.hypot(*plain[:2]) else plain
            yield replace(effect, p=fewer, free=effect.free[: len(fewer)])
        if abs(effect.p[2]) < 1.0 and not any(e.family == GainDrift.name for e in others):
            side = {k: effect.aux[k] for k in ("side", "source") if k in effect.aux}
            for law, tau in ((DECIBELS, 1.0), (AMPLITUDE, 1.0), (RELAXATION, 0.1), (RELAXATION, 0.3)):
                aux, relaxes = {"law": law, **side}, law == RELAXATION
                yield start(GainDrift(), [0.0, np.log(tau)], free=[True, relaxes], aux=aux, trials=3 if relaxes else 1)

    def in_time(self, scene, effect, later, longer):
        p = effect.p.copy()
        for k, pair in enumerate(pairs(p), 1):
            at = 0 if k == 1 else 2 * k - 1
            p[at : at + 2] = turned(pair, -k * effect.p[2] * amid(later, longer))
        p[2] *= longer
        return effect.moved(p)

    def values(self, scene, effect, p):
        return {"frequency_hz": abs(p[2]) / scene.duration_s, "depth": float(np.hypot(p[0], p[1]))}

    def contradiction(self, parameters, model):
        told = [k for k in MOST if f"depth_{k}" in model or f"phase_{k}_rad" in model]
        whole = told == [*MOST][: len(told)] and all({f"depth_{k}", f"phase_{k}_rad"} <= {*model} for k in told)
        return None if whole else "model: needs depth_k and phase_k_rad of every harmonic from 2 on"

    def parse(self, scene, parameters, model):
        m, cycles = parameters["depth"], parameters["frequency_hz"] * scene.duration_s
        p, at, k = [], np.pi * cycles, 1
        told = {"depth_1": m, "phase_1_rad": model.get("phase_rad", 0.0), **model}
        while f"depth_{k}" in told:
            depth, phase = told[f"depth_{k}"], told[f"phase_{k}_rad"]
            p += [depth * np.cos(phase + k * at), -depth * np.sin(phase + k * at)]
            p += [cycles] if k == 1 else []
            k += 1
        return start(self, p, aux=side_of(model))

    def model(self, scene, effect):
        cycles, told = abs(effect.p[2]), super().model(scene, effect)
        for k, (a, b) in enumerate(pairs(effect.p), 1):
            phase = np.arctan2(-np.sign(effect.p[2]) * b, a) - k * np.pi * cycles  # at t = 0
            phase = float((phase + np.pi) % (2 * np.pi) - np.pi)
            told |= {"phase_rad": phase} if k == 1 else {f"depth_{k}": float(np.hypot(a, b)), f"phase_{k}_rad": phase}
        return told

    def describe(self, number):
        return f"The gain hums at {number('frequency_hz')} with a depth of {number('depth')}."
