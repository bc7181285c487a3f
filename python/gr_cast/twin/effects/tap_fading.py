# SPDX-License-Identifier: GPL-3.0-or-later
"""A tap of the twin that fades: its gain times 1 + c(t), c complex on a cosine basis. Internal: Re and Im
of coefficients."""

from dataclasses import replace

import numpy as np

from ..basis import course_orders
from ..columns import Courses
from .base import PROBE, start
from .extra_path import ExtraPath
from .iq_imbalance import IqImbalance
from .tap import TapFamily
from .tap_gain_error import TapGainError
from .values import NEEDED, Value

BY_CHANCE = 1e-6  # of the means of courses that are larger: what is no fading may pass for one
MOST = 480  # cosines: the fastest fading that is followed
SLOW_CYCLES = 2.0  # over the recording: of a slower course the mean may be any


class TapFading(TapFamily):
    name = "tap_fading"
    parameters = {"delay_s": NEEDED, "k_factor_db": NEEDED, "doppler_spread_hz": Value(low=0.0, needed=True)}
    lasting = False
    flexible = True
    linear = True
    random = True
    wanders = ("gain", "phase")
    least_error = {"k_factor_db": 0.6, "doppler_spread_hz": 0.2}
    follows_carrier = {"doppler_spread_hz": 1}

    def course(self, scene, effect, p):
        return 1 + scene.course(p[::2] + 1j * p[1::2])

    def spectrum_of(self, effect):
        p, variance = super().spectrum_of(effect)
        return p[::2] + 1j * p[1::2], variance[::2] + variance[1::2]

    def apply(self, chain, effect):
        k = effect.aux["tap"]
        path = chain.paths[k]
        track = self.course(chain.scene, effect, effect.p)
        chain.paths[k] = replace(path, track=track if path.track is None else path.track * track)

    def nest(self, scene, effect):
        size = 2 * max(course_orders(scene)[-1], len(effect.p) // 2)
        return (
            (effect.aux["tap"], size),
            replace(effect, p=np.zeros(size), free=np.ones(size, bool), prior=None),
            np.arange(len(effect.p)),
        )

    def columns(self, scene, effect, chain, before, rest):
        path = before.paths[effect.aux["tap"]]
        steady = before.copy()
        steady.paths.append(replace(path, gain=PROBE * path.gain))
        signal = (rest(steady, effect).y - chain.y) / PROBE
        return Courses(signals=np.stack([signal, 1j * chain.facing * signal]), orders=len(effect.p) // 2, scene=scene)

    def starts(self, view):
        slow, fast = course_orders(view.scene), course_orders(view.scene, MOST)
        for k in range(len(view.scene.taps)):  # of one path too: no other family changes gain and phase at random
            for size in fast if k in view.fast_taps else slow:
                yield start(
                    self,
                    np.zeros(2 * size),
                    prior=np.ones(2 * size),
                    aux={"tap": k},
                    trials=2 * len(view.scene.taps),
                )

    def values(self, scene, effect, p):
        c = p[::2] + 1j * p[1::2]
        scattered = np.sum(np.abs(c) ** 2) + float(np.sum(effect.aux.get("_variance", [0.0]))) + 1e-30
        k = np.arange(1, 1 + len(c))
        spread = np.sqrt(2 * np.sum(k**2 * np.abs(c) ** 2) / scattered) / 2 / scene.duration_s
        return {
            "delay_s": self._delay_of(scene, effect),
            "k_factor_db": -10 * np.log10(scattered),
            "doppler_spread_hz": float(spread),
        }

    def parse(self, scene, parameters, model):
        most = max(1.0, 2 * parameters["doppler_spread_hz"] * scene.duration_s)
        k = np.arange(1, 1 + int(np.ceil(most)))
        # Scattering all around: a Doppler density of 1/√(1 − (f/f_max)²) (Clarke 1968), here between its cosines.
        share = np.diff(np.arcsin(np.minimum(np.arange(len(k) + 1) / most, 1.0)))
        prior = 10 ** (-parameters["k_factor_db"] / 10) * share / share.sum() / 2
        return start(self, np.zeros(2 * len(k)), prior=np.repeat(prior, 2), aux={"tap": self._tap_of(scene, parameters, model)})

    def holds(self, scene, effect, other):
        """Its mean, of two paths told as the other one's, or as the image that a code on one line has over two; and its strong
        moments."""
        tap, of_two = scene.taps[effect.aux["tap"]], len(scene.taps) == 2 and scene.taps[0].source == scene.taps[1].source
        if other.family == TapGainError.name and (of_two or other.aux["tap"] == effect.aux["tap"]):
            return self._may_be_its_mean(scene, effect, abs(np.exp(complex(*other.p)) - 1) ** 2)
        if other.family == IqImbalance.name and of_two and all(source.on_one_line for source in scene.sources):
            heard = sum(abs(one.gain) ** 2 for one in scene.taps)
            return self._may_be_its_mean(scene, effect, float(other.p @ other.p) * heard / abs(tap.gain) ** 2)
        return other.family == ExtraPath.name and abs(tap.delay - other.p[2]) < 1.0

    def _may_be_its_mean(self, scene, effect, size: float) -> bool:
        """Whether the mean of a course may have a power over that of its path: any, where it is slow."""
        told = self.values(scene, effect, effect.p)
        cycles = told["doppler_spread_hz"] * scene.duration_s
        if cycles < SLOW_CYCLES:
            return True
        # The power of Clarke's mean over what is left of the course, which has 1 + 2·cycles complex numbers: Fisher's law.
        times = (1 + 2 * cycles) * (BY_CHANCE ** (-1 / (1 + 2 * cycles)) - 1) / (np.pi * cycles)
        return size < times * 10 ** (-told["k_factor_db"] / 10)

    def played(self, scene, effect, rng):
        return effect.moved(rng.normal(size=len(effect.p)) * np.sqrt(effect.prior))

    def describe(self, number):
        return (
            f"The twin's path at {number('delay_s')} fades: steady over scattered power "
            f"{number('k_factor_db')}, Doppler up to {number('doppler_spread_hz')}."
        )
