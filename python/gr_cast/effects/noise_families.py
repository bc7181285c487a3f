# SPDX-License-Identifier: GPL-3.0-or-later
"""Families of the noise: they change its variance over time or frequency, never the prediction.

`variance(scene, effect, wanted)` is the noise power of each sample relative to the floor (n,),
`spectrum(…)` that of each
FFT bin. Strengths are in aux-free parameters, fitted by maximum likelihood in `diagnose.noise`.
"""

import numpy as np

from .base import NOISE, Family, start


class NoiseFamily(Family):
    stage = NOISE
    noise_like = True

    def apply(self, chain, effect):
        pass

    def variance(self, scene, effect, wanted):
        return None

    def spectrum(self, scene, effect):
        return None

    def parse(self, scene, parameters, model):
        return start(self, model.get("p", []), free=[False] * len(model.get("p", [])), aux=model.get("aux", {}))

    def model(self, effect):
        return {
            "p": [float(v) for v in effect.p],
            "aux": {k: v for k, v in effect.aux.items() if not k.startswith("_")},
        }


class NoiseFloor(NoiseFamily):
    """Level other than the twin's. p: change in dB."""

    name = "noise_floor"

    def values(self, scene, effect, p):
        return {"change_db": p[0]}

    def describe(self, number):
        return f"The noise floor is {number('change_db')} from what the twin says."


class SignalDependentNoise(NoiseFamily):
    """Noise that follows the wanted power. p: ln of its power at mean wanted power over the floor."""

    name = "signal_dependent_noise"

    def variance(self, scene, effect, wanted):
        return 1 + np.exp(effect.p[0]) * np.abs(wanted) ** 2 / np.mean(np.abs(wanted) ** 2)

    def values(self, scene, effect, p):
        return {"slope_db": 10 / np.log(10) * p[0]}

    def describe(self, number):
        return f"Noise grows with the signal: at mean wanted power it is {number('slope_db')} relative to the floor."


class PulsedInterference(NoiseFamily):
    """Pulses: on for a share of each period. p: ln of power while on over the floor; period and start in
    samples, duty."""

    name = "pulsed_interference"
    level = "environment"

    @staticmethod
    def gate(scene, effect):
        _, period, first, duty = effect.p
        return ((scene.index - first) / period) % 1.0 < duty

    def variance(self, scene, effect, wanted):
        return 1 + np.exp(effect.p[0]) * self.gate(scene, effect)

    def values(self, scene, effect, p):
        floor = effect.aux["_floor"]
        return {
            "period_s": p[1] / scene.sample_rate_hz,
            "duty_cycle": p[3],
            "power_dbc": 10 * np.log10(np.exp(p[0]) * floor / scene.rms**2),
        }

    def describe(self, number):
        return f"Pulses every {number('period_s')}, on for {number('duty_cycle')} of it, {number('power_dbc')} while on."


class ImpulsiveNoise(NoiseFamily):
    """Single strong samples. p: ln of an impulse's power over the floor, ln of their share of samples."""

    name = "impulsive_noise"

    level = "environment"

    def values(self, scene, effect, p):
        floor = effect.aux["_floor"]
        return {
            "rate_hz": float(np.exp(p[1])) * scene.sample_rate_hz,
            "power_db": 10 * np.log10(np.exp(p[0]) * floor),
        }

    def describe(self, number):
        return f"Impulses: {number('rate_hz')} of them, each {number('power_db')} re full scale."


class NarrowbandInterference(NoiseFamily):
    """Noise in a part of the band. p: ln of its density over the floor, centre and width in cycles per
    sample."""

    name = "narrowband_interference"
    level = "environment"

    def spectrum(self, scene, effect):
        f = np.fft.fftfreq(scene.count)
        distance = np.abs((f - effect.p[1] + 0.5) % 1.0 - 0.5)
        return 1 + np.exp(effect.p[0]) * (distance <= effect.p[2] / 2)

    def values(self, scene, effect, p):
        floor = effect.aux["_floor"]
        return {
            "frequency_hz": p[1] * scene.sample_rate_hz,
            "bandwidth_hz": p[2] * scene.sample_rate_hz,
            "power_dbc": 10 * np.log10(np.exp(p[0]) * floor * p[2] / scene.rms**2),
        }

    def where(self, scene, effect, values):
        f, b = values["frequency_hz"], values["bandwidth_hz"]
        return {"frequency_hz": [f - b / 2, f + b / 2]}

    def describe(self, number):
        return f"Interference {number('bandwidth_hz')} wide at {number('frequency_hz')} from the carrier, {number('power_dbc')}."
