# SPDX-License-Identifier: GPL-3.0-or-later
"""Another transmitter with a known code. Internal: Re a, Im a over the taps' scale, delay in samples,
carrier in cycles."""

import numpy as np

from .base import ENVIRONMENT, Family, complex_pair, db, start
from .chain import TAU, frequencies


class SecondTransmitter(Family):
    name = "second_transmitter"
    level = "environment"
    follows_carrier = {"offset_hz": 1}
    stage = ENVIRONMENT

    def apply(self, chain, effect):
        source = chain.scene.extra[effect.aux["code"]]
        re, im, delay, doppler = effect.p
        spectrum = chain.scene.spectrum_of(effect.aux["code"])
        shifted = spectrum * np.exp((-1j * TAU) * frequencies(len(spectrum)) * (delay + chain.delay))
        signal = complex(re, im) * chain.sample(source, shifted, chain.clock)
        if doppler:
            signal = signal * np.exp(1j * TAU * doppler * (chain.u - 0.5))
        chain.y = chain.y + signal

    def starts(self, view):
        for code in view.scene.extra:
            for delay, doppler, trials in view.echoes(code, count=1):
                yield start(self, [0, 0, delay, 0.0], free=[1, 1, 1, 0], aux={"code": code}, trials=trials)
                if abs(doppler) > 0.3:
                    yield start(self, [0, 0, delay, doppler], aux={"code": code}, trials=trials)

    def values(self, scene, effect, p):
        return {"gain_db": db(complex_pair(p)), "delay_s": p[2] / scene.sample_rate_hz}

    def constants(self, scene, effect):
        return {"code": effect.aux["code"]}

    def parse(self, scene, parameters, model):
        a = 10 ** (parameters["gain_db"] / 20) * np.exp(1j * model.get("phase_rad", 0.0))
        return start(
            self,
            [a.real, a.imag, parameters["delay_s"] * scene.sample_rate_hz, model.get("offset_hz", 0.0) * scene.duration_s],
            aux={"code": parameters["code"]},
        )

    def model(self, scene, effect):
        return {"phase_rad": float(np.angle(complex_pair(effect.p))), "offset_hz": float(effect.p[3]) / scene.duration_s}

    def describe(self, number):
        return (
            f"Another transmitter is on the air with the waveform {number.constants['code']}, "
            f"{number('gain_db')} on the taps' scale."
        )
