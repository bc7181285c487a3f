# SPDX-License-Identifier: GPL-3.0-or-later
"""Lost (or inserted) samples: from one moment on the recording is ahead by a whole number of samples.
Internal: index of the
first sample after the joint, samples lost."""

import numpy as np

from .base import LINK, Family, Multiplicity, Role, start

SAMPLES_APART = 50.0  # by which joints of two recordings may differ and be one


class SampleLoss(Family):
    name = "sample_loss"
    role = Role.SLIP
    multiplicity = Multiplicity.MANY
    place = 0
    lasting = False
    stage = LINK
    leaps = True

    def apply(self, chain, effect):
        joint, lost = effect.p
        if effect.aux.get("later"):
            shift = np.where(chain.scene.index < joint, -int(round(lost)), 0)
        else:
            shift = np.where(chain.scene.index >= joint, int(round(lost)), 0)
        chain.shift = shift if chain.shift is None else chain.shift + shift
        chain.u = (chain.scene.index + chain.shift) / chain.scene.span

    def starts(self, view):
        for joint, lost, later in view.jumps():
            yield start(self, [joint, lost], free=[False, False], aux={"later": later}, trials=view.scene.count)

    def later(self, scene, effect, lengths):
        return effect.moved(effect.p - [lengths * scene.span, 0.0])

    def values(self, scene, effect, p):
        return {"time_s": p[0] / scene.sample_rate_hz, "samples": float(round(p[1]))}

    def parse(self, scene, parameters, model):
        return start(self, [parameters["time_s"] * scene.sample_rate_hz, parameters["samples"]], free=[False, False])

    def placed(self, scene, told):
        return told["time_s"]["value"] * scene.sample_rate_hz / SAMPLES_APART, 0.0

    def resolution(self, scene, name, value):
        return {"time_s": 2.0 / scene.sample_rate_hz, "samples": 0.0}[name]

    def hidden(self, effect):
        return 1

    def where(self, scene, effect, values):
        t = values["time_s"]
        reach = 0.002 * scene.duration_s + effect.aux.get("gap", 0.0) / 2 / scene.sample_rate_hz
        return {"time_s": [t - reach, t + reach]}

    def describe(self, number):
        return f"Samples are missing from {number('time_s')} on: {number('samples')} (negative: inserted)."
