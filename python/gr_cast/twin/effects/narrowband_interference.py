# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise in a part of the band. Internal: ln of its density over the floor, centre and width in cycles per sample."""

import numpy as np
from scipy import fft as sp_fft

from .base import around_circle, at_half_the_rate, start
from .noise_family import LOUD, REMEMBERED, NoiseFamily, filled, two_levels
from .tone_interference import ToneInterference
from .values import NEEDED, NEEDED_POSITIVE

WIDEST = 3  # a band wider than this part of the rate is what a filter leaves of the noise
CELLS = 256  # of frequency, at most
ROUNDS = 5  # in which gaps are filled with what the last one tells of a loud band
MIDDLE = 0.05  # of its width, by which a band's own carrier may be off its middle: its edges are found no nearer
FINE = 12  # steps per cell in which the edges of a band are looked for


class NarrowbandInterference(NoiseFamily):
    name = "narrowband_interference"
    parameters = {"frequency_hz": NEEDED, "bandwidth_hz": NEEDED_POSITIVE, "power_dbc": NEEDED}
    remembered = REMEMBERED
    owners = ("environment",)
    _strengths = 3

    def band(self, effect):
        return effect.p[1], effect.p[2]

    def spectrum(self, scene, effect):
        return 1 + np.exp(effect.p[0]) * (around_circle(np.fft.fftfreq(scene.count), effect.p[1]) <= effect.p[2] / 2)

    def values(self, scene, effect, p):
        floor = effect.aux["_floor"]
        return {
            "frequency_hz": p[1] * scene.sample_rate_hz,
            "bandwidth_hz": p[2] * scene.sample_rate_hz,
            "power_dbc": 10 * np.log10(np.exp(p[0]) * floor * p[2] / scene.wanted_rms**2),
        }

    def _levels(self, scene, parameters, model, floor, rms):
        width = parameters["bandwidth_hz"] / scene.sample_rate_hz
        strength = np.log(10 ** (parameters["power_dbc"] / 10) * rms**2 / floor / width)
        return [strength, parameters["frequency_hz"] / scene.sample_rate_hz, width]

    def where(self, scene, effect, values):
        f, b = values["frequency_hz"], values["bandwidth_hz"]
        return {"frequency_hz": [f - b / 2, f + b / 2]}

    def holds(self, scene, effect, other):
        """Its own carrier: a fainter line in its middle, as a station's is that modulates its amplitude."""
        if other.family != ToneInterference.name:
            return False
        own, line = self.values(scene, effect, effect.p), ToneInterference().values(scene, other, other.p)
        off = abs(line["frequency_hz"] - own["frequency_hz"]) / own["bandwidth_hz"]
        return off < MIDDLE and line["power_dbc"] < own["power_dbc"]

    def describe(self, number):
        return f"Interference {number('bandwidth_hz')} wide at {number('frequency_hz')} from the carrier, {number('power_dbc')}."

    def find(self, view, near=None):
        """(gain, effect) of noise that is stronger in one band."""
        power, share = _periodogram(view), view.use.sum() / len(view.use)
        n, (edges, size, energy) = len(power), _cells(power)
        cells = len(size)
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
        if gain * share < 20 or length > cells // WIDEST:
            return 0.0, None
        gain, first, last = _edges(power, edges[i % cells], edges[i % cells] + n2[i + length] - n2[i], n // cells)
        on_n = last - first
        on_e = np.take(power, np.arange(first, last), mode="wrap").sum()
        ratio = max(on_e / on_n / ((energy.sum() - on_e) / (n - on_n)) - 1, 1e-3)
        width = on_n / n
        centre = (first / n + width / 2 + 0.5) % 1.0 - 0.5
        effect = start(
            self,
            [np.log(ratio), centre, width],
            free=[False] * 3,
            trials=cells**2 / 2,
            aux={"_std": [(1 + ratio) / ratio / np.sqrt(on_n * share), 0.1 / cells, 0.2 / cells]},
        )
        return gain * share, effect


def _cells(power):
    """(edges, sizes, energies) of cells of a periodogram; at half the sample rate, where interpolation leaves something of the
    signal, with what is beside it."""
    n = len(power)
    edges = np.linspace(0, n, int(min(CELLS, max(n // 16, 4))) + 1).astype(int)
    size, energy = np.diff(edges), np.add.reduceat(power, edges[:-1])
    top = at_half_the_rate((edges[:-1] + size / 2) / n)
    energy[top] = size[top] * np.interp(np.flatnonzero(top), np.flatnonzero(~top), (energy / size)[~top])
    return edges, size, energy


def _periodogram(view):
    """(n,) |FFT|² of the noise, as it would be without gaps: these are filled with what goes on of a loud band, and the rest is
    added that no filling tells (Dempster 1977). What is less than halfway up to the loudest, in dB, is taken for what the gaps
    spread of that."""
    power, gaps = np.abs(sp_fft.fft(view.weighted)) ** 2, ~view.use
    for _ in range(ROUNDS if gaps.any() else 0):
        _, size, energy = _cells(power)
        density = energy / size / len(power)
        floor = np.median(density)
        if density.max() <= LOUD * floor:
            break
        spectrum = np.repeat(np.where(density > np.sqrt(floor * density.max()), density, floor), size)
        x, loud = filled(view.weighted, view.use, spectrum), spectrum.mean()
        told = np.clip(np.mean(np.abs(x[gaps]) ** 2) / (loud - floor), 0.0, 1.0)
        power = np.abs(sp_fft.fft(x)) ** 2 + gaps.sum() * (told * floor + (1 - told) * spectrum)
    return power


def _edges(power, first, last, cell):
    """(gain, first bin, last bin + 1) of the band near the one given, to within a cell on either side, that stands out
    most."""
    steps = np.unique(np.linspace(-cell, cell, 2 * FINE + 1).astype(int))
    low, high = first + steps[:, None], last + steps[None]
    wrapped = np.arange(first - cell, last + cell + 1)
    sums = np.concatenate([[0.0], np.cumsum(np.take(power, wrapped, mode="wrap"))])
    on_e = sums[high - wrapped[0]] - sums[low - wrapped[0]]
    gains = np.where(high > low, two_levels(high - low, on_e, len(power), power.sum()), 0.0)
    k, m = np.unravel_index(int(np.argmax(gains)), gains.shape)
    return float(gains[k, m]), int(low[k, 0]), int(high[0, m])
