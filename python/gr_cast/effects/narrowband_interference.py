# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise in a part of the band. Internal: ln of its density over the floor, centre and width in cycles per sample."""

import numpy as np
from scipy import fft as sp_fft

from .base import start
from .noise_family import NoiseFamily, two_levels

NYQUIST = 0.01  # of the sample rate on either side of its half: what interpolation between samples cannot know


class NarrowbandInterference(NoiseFamily):
    name = "narrowband_interference"
    level = "environment"
    strengths = 3

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

    def levels(self, scene, parameters, model, floor, rms):
        width = parameters["bandwidth_hz"] / scene.sample_rate_hz
        strength = np.log(10 ** (parameters["power_dbc"] / 10) * rms**2 / floor / width)
        return [strength, parameters["frequency_hz"] / scene.sample_rate_hz, width]

    def where(self, scene, effect, values):
        f, b = values["frequency_hz"], values["bandwidth_hz"]
        return {"frequency_hz": [f - b / 2, f + b / 2]}

    def describe(self, number):
        return f"Interference {number('bandwidth_hz')} wide at {number('frequency_hz')} from the carrier, {number('power_dbc')}."

    def find(self, view, near=None):
        """(gain, effect) of noise that is stronger in one band."""
        power = np.abs(sp_fft.fft(view.weighted)) ** 2
        n = len(power)
        cells = int(min(256, n // 16))
        edges = np.linspace(0, n, cells + 1).astype(int)
        energy = np.add.reduceat(power, edges[:-1])
        size = np.diff(edges)
        last = np.abs(edges[:-1] + size / 2 - n / 2) < NYQUIST * n
        energy[last] = size[last] * energy[~last].sum() / size[~last].sum()
        e2, n2 = np.cumsum(np.concatenate([[0], energy, energy])), np.cumsum(np.concatenate([[0], size, size]))
        best = (0.0, 0, 1)
        for length in range(1, cells // 2):
            gain = two_levels(
                n2[length : length + cells] - n2[:cells],
                e2[length : length + cells] - e2[:cells],
                n,
                energy.sum(),
            )
            i = int(np.argmax(gain))
            if gain[i] > best[0]:
                best = (float(gain[i]), i, length)
        gain, i, length = best
        share = view.use.sum() / n
        if gain * share < 20:
            return 0.0, None
        on_e, on_n = e2[i + length] - e2[i], n2[i + length] - n2[i]
        ratio = max(on_e / on_n / ((energy.sum() - on_e) / (n - on_n)) - 1, 1e-3)
        low = edges[i % cells] / n
        width = on_n / n
        centre = (low + width / 2 + 0.5) % 1.0 - 0.5
        effect = start(
            self,
            [np.log(ratio), centre, width],
            free=[False] * 3,
            trials=cells**2 / 2,
            aux={"_std": [(1 + ratio) / ratio / np.sqrt(on_n * share), 0.3 / cells, 0.4 / cells]},
        )
        return gain * share, effect
