# SPDX-License-Identifier: GPL-3.0-or-later
"""Lost (or inserted) samples: from one moment on the recording is ahead by a whole number of samples.
What is inserted repeats what comes before it, or is zeros. Internal: index of the first sample after the joint, samples lost."""

from dataclasses import replace

import numpy as np

from .base import LINK, Family, Multiplicity, Role, start
from .values import NEEDED, TRUTH, Value

MOST_LOST = 1 << 24  # samples at one joint; of a repeated waveform they count modulo its period
SAMPLES_APART = 50.0  # by which joints of two recordings may differ and be one
ONE_JOINT = 40  # samples: too few between two joints to tell that there are two


class SampleLoss(Family):
    name = "sample_loss"
    parameters = {"time_s": NEEDED, "samples": Value(low=-MOST_LOST, high=MOST_LOST, needed=True), "zeros": TRUTH}
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
        if effect.aux.get("zeros"):
            silent = (chain.scene.index >= joint) & (chain.scene.index < joint - lost)
            chain.silent = silent if chain.silent is None else chain.silent | silent

    def starts(self, view):
        everywhere = lambda lost: start(self, [-np.inf, lost], free=[False, False])  # noqa: E731
        found = [self._read(view, joint, lost, {"later": later}) for joint, lost, later in view.jumps(everywhere)]
        for first, count in view.written_zeros:
            found += [self._read(view, first, -count, {"later": later}) for later in (False, True)]
        return {(*one.p, *one.aux.values()): one for one in found}.values()  # zeros at a jump are found there too

    def at_once(self, view):
        later, joints = view.steps_of_lag()
        return later, [self._read(view, *joint, {}) for joint in joints]

    def _read(self, view, joint, lost, aux):
        """Samples lost at a joint, or inserted as the zeros that the recording has there."""
        if zeros := view.zeros(joint, lost):
            (joint, lost), aux = zeros, {**aux, "zeros": True}
        return start(self, [joint, lost], free=[False, False], aux=aux, trials=view.scene.count)

    def another(self, effect):
        return [effect.moved(effect.p + np.array([0.0, one])) for one in (-1.0, 1.0)]

    def moment(self, scene, effect):
        return float(effect.p[0])

    def happening(self, scene, effect, first):
        return effect.moved(np.array([first, effect.p[1]]))

    def joined(self, effect, other):
        alike = effect.aux.get("later") == other.aux.get("later") and abs(effect.p[0] - other.p[0]) < ONE_JOINT
        if not alike:
            return None
        lost = effect.p[1] + other.p[1]
        return replace(other, p=np.array([other.p[0], lost]), aux={k: v for k, v in other.aux.items() if k != "zeros"})

    def in_time(self, scene, effect, later, longer):
        return effect.moved(effect.p - [later * scene.span, 0.0])

    def values(self, scene, effect, p):
        return {"time_s": p[0] / scene.sample_rate_hz, "samples": float(round(p[1]))}

    def constants(self, scene, effect):
        return {"zeros": True} if effect.aux.get("zeros") else {}

    def parse(self, scene, parameters, model):
        aux = {"zeros": True} if parameters.get("zeros") else {}
        joint = round(parameters["time_s"] * scene.sample_rate_hz, 6)  # k/rate·rate is not k for every k
        return start(self, [joint, parameters["samples"]], free=[False, False], aux=aux)

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
        zeros = " as zeros" if number.constants.get("zeros") else ""
        return f"Samples are missing from {number('time_s')} on: {number('samples')} (negative: inserted{zeros})."
