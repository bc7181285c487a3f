# SPDX-License-Identifier: GPL-3.0-or-later
"""A tap of the twin with another Doppler. Internal: cycles over the recording, and by how much the phase differs from the
twin's: amid the recording, or at its first sample where it is `held` at the twin's."""

from dataclasses import replace

import numpy as np

from .base import start
from .tap import TapFamily
from .tap_delay_error import TapDelayError
from .tap_gain_error import TapGainError
from .values import NEEDED, NUMBER


class TapDoppler(TapFamily):
    name = "tap_doppler"
    sizes = (0, 1)
    parameters = {"delay_s": NEEDED, "doppler_hz": NEEDED}
    remembered = {"phase_rad": NUMBER}
    same_as = {"carrier_frequency_offset": "with one tap and one link: every path turns alike"}
    follows_carrier = {"doppler_hz": 1}

    def apply(self, chain, effect):
        k, extra = effect.aux["tap"], effect.p[0]
        path = chain.paths[k]
        gain = path.gain * np.exp(1j * _begins_at(effect))
        chain.paths[k] = replace(path, gain=gain, doppler=path.doppler + extra, drift=path.drift + chain.scene.drift_of(extra))

    def starts(self, view):
        for k in view.tap_order():
            yield start(self, [0.0, 0.0], aux={"tap": k}, trials=len(view.scene.taps))
            for cycles in view.tap_lines(k):
                yield start(self, [cycles, 0.0], aux={"tap": k}, trials=len(view.scene.taps) * 50)

    def less(self, scene, effect, others):
        """Nothing but the Doppler is wrong, as the twin's phase at the recording's first sample tells, or nothing but the
        phase."""
        if "held" in effect.aux or scene.begins:
            return ()
        aux = {"tap": effect.aux["tap"], "held": True}
        held = start(self, [effect.p[0], 0.0], free=[True, False], aux=aux, trials=effect.trials)
        return held, start(TapGainError(), [0.0, effect.p[1]], aux=effect.aux, trials=effect.trials)

    def apart(self, scene, effect):
        """A path that turns otherwise may be at another delay too."""
        return effect, start(TapDelayError(), [0.0], aux={"tap": effect.aux["tap"]}, trials=len(scene.taps))

    def mirrored(self, effect):
        return effect.moved(-effect.p)

    def in_time(self, scene, effect, later, longer):
        cycles = effect.p[0] * longer
        if "held" in effect.aux and not later:
            return effect.moved(np.array([cycles, 0.0]))
        begins_at_rad = _begins_at(effect) + 2 * np.pi * effect.p[0] * later
        free, aux = np.ones(2, bool), {"tap": effect.aux["tap"]}
        return replace(effect, p=np.array([cycles, begins_at_rad + np.pi * cycles]), free=free, aux=aux)

    def values(self, scene, effect, p):
        return {
            "delay_s": self._delay_of(scene, effect),
            "doppler_hz": (scene.taps[effect.aux["tap"]].doppler + p[0]) / scene.duration_s,
        }

    def model(self, scene, effect):
        return {} if "held" in effect.aux else {"phase_rad": float(_begins_at(effect))}

    def parse(self, scene, parameters, model):
        k = self._tap_of(scene, parameters, model)
        extra = parameters.get("doppler_hz", 0.0) * scene.duration_s - scene.taps[k].doppler
        return _free(self, k, extra, model.get("phase_rad", 0.0))

    def describe(self, number):
        return f"The twin's path at {number('delay_s')} moves: Doppler {number('doppler_hz')}."


def _free(family, tap, cycles, begins_at_rad):
    return start(family, [cycles, begins_at_rad + np.pi * cycles], aux={"tap": tap})


def _begins_at(effect) -> float:
    """Radian by which the phase differs from the twin's at the first sample."""
    return effect.p[1] - (0.0 if "held" in effect.aux else np.pi * effect.p[0])
