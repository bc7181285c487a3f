# SPDX-License-Identifier: GPL-3.0-or-later
"""An echo that the twin leaves out. Internal: Re a, Im a (mid-recording), delay in samples, Doppler in
cycles."""

import numpy as np

from ..scene import Path
from .base import LINK, Family, Multiplicity, amid, complex_pair, db, start, turned
from .missing_path import MissingPath
from .tap import around
from .tap_gain_error import TapGainError
from .values import NEEDED, NUMBER

ONE_PLACE = 0.7  # samples within which two echoes come from one place
BY_THEIR_TURNS = 4.0  # cycles over the recording for a sample of delay: two that differ more by turns are two by them alone
AT_A_TAP, GONE = 0.5, 0.2  # samples and cycles from a tap within which an echo may be its own change; what may be left of it
FASTEST = 1e-5  # Doppler over the carrier: 3 km/s


class ExtraPath(Family):
    name = "extra_path"
    sizes = (0, 1)
    parameters = {"delay_s": NEEDED, "gain_db": NEEDED, "phase_rad": NUMBER, "doppler_hz": NUMBER}
    owners = ("link",)
    multiplicity = Multiplicity.MANY
    place = 2
    stage = LINK
    same_as = {
        "front_end_filter": "within one sample of a tap: both are one short FIR",
        "tap_doppler": "at the delay of a tap: a tap and an echo with Doppler beat as one",
    }
    follows_carrier = {"doppler_hz": 1}

    def apply(self, chain, effect):
        re, im, delay, doppler = effect.p
        gain = complex(re, im) * np.exp(-1j * np.pi * doppler)
        chain.paths.append(
            Path(
                source=effect.aux["source"],
                delay=delay,
                gain=gain,
                doppler=doppler,
                drift=chain.scene.drift_of(doppler),
            )
        )

    def starts(self, view):
        for i in range(len(view.scene.sources)):
            fastest = FASTEST * (view.scene.carrier_hz or 0.0) * view.scene.duration_s
            for delay, doppler, places, trials in view.echoes(i, count=2, fastest=fastest):
                still = abs(doppler) < 0.3 or self._too_fast(view.scene, doppler)
                yield start(self, [0, 0, delay, 0.0], free=[1, 1, 1, 0], aux={"source": i}, trials=places)
                yield start(self, [0, 0, delay, 0.0 if still else doppler], aux={"source": i}, trials=trials * 4)

    def unsteady(self, effect, other):
        """At one delay, turning by half a cycle more, or apart by their turns rather than their delays: an echo that fades, that
        comes or goes, or a filter that changes."""
        far, turns = np.abs(effect.p[2:] - other.p[2:])
        return effect.aux["source"] == other.aux["source"] and far < ONE_PLACE and turns > min(0.5, BY_THEIR_TURNS * far)

    def less(self, scene, effect, others):
        """At the delay of one of the twin's taps: that tap's own strength, or the tap that is not there."""
        source, delay, doppler = effect.aux["source"], effect.p[2], effect.p[3]
        gain = complex_pair(effect.p) * np.exp(-1j * np.pi * doppler)  # at the beginning, as a tap's
        changed = {e.aux["tap"] for e in others if "tap" in e.aux}
        for k, tap in enumerate(scene.taps):
            if (
                tap.source == source
                and tap.gain
                and k not in changed
                and max(abs(tap.delay - delay), abs(tap.doppler - doppler)) < AT_A_TAP
            ):
                left = 1 + gain / tap.gain
                if abs(left) < GONE and sum(t.source == source for t in scene.taps) > 1:
                    yield start(MissingPath(), [], aux={"tap": k}, trials=len(scene.taps))
                p = [np.log(max(abs(left), GONE)), float(np.angle(left))]
                yield start(TapGainError(), p, aux={"tap": k}, trials=len(scene.taps))

    @staticmethod
    def _too_fast(scene, cycles: float) -> bool:
        return bool(scene.carrier_hz) and abs(cycles) / scene.duration_s > FASTEST * scene.carrier_hz

    def settled(self, scene, effect):
        return np.ones(len(effect.p), bool)

    def mirrored(self, effect):
        return effect.moved(effect.p * [1.0, -1.0, 1.0, -1.0])

    def in_time(self, scene, effect, later, longer):
        re, im, delay, doppler = turned(effect.p, effect.p[3] * amid(later, longer))
        return effect.moved(np.array([re, im, delay + scene.drift_of(doppler) * later, doppler * longer]))

    def values(self, scene, effect, p):
        rate = scene.sample_rate_hz
        phase = np.angle(complex_pair(p)) - np.pi * p[3]
        return {
            "delay_s": p[2] / rate,
            "gain_db": db(complex_pair(p)),
            "phase_rad": float((phase + np.pi) % (2 * np.pi) - np.pi),
            "doppler_hz": p[3] / scene.duration_s,
        }

    def parse(self, scene, parameters, model):
        doppler = parameters.get("doppler_hz", 0.0) * scene.duration_s
        a = 10 ** (parameters["gain_db"] / 20) * np.exp(1j * (parameters.get("phase_rad", 0.0) + np.pi * doppler))
        return start(
            self,
            [a.real, a.imag, parameters["delay_s"] * scene.sample_rate_hz, doppler],
            aux={"source": model.get("source", 0)},
        )

    def placed(self, scene, told):
        return told["delay_s"]["value"] * scene.sample_rate_hz, 0.0

    def delays(self, scene, effect):
        return (effect.p[2],)

    def resolution(self, scene, name, value):
        return 0.0 if name == "delay_s" else super().resolution(scene, name, value)

    def retuned(self, parameters, model, ratio, moved_hz):
        """A path turns by its delay as well."""
        parameters, model = super().retuned(parameters, model, ratio, moved_hz)
        turned_rad = (parameters.get("phase_rad") or 0.0) - 2 * np.pi * moved_hz * parameters["delay_s"]
        return parameters | {"phase_rad": turned_rad}, model

    def where(self, scene, effect, values):
        return around(scene, values["delay_s"])

    def describe(self, number):
        return (
            f"An echo that the twin leaves out: {number('delay_s')} on the scale of its taps, "
            f"{number('gain_db')}, Doppler {number('doppler_hz')}."
        )
