# SPDX-License-Identifier: GPL-3.0-or-later
"""Interference in a part of the band is found where it can be, and not where interpolation ends."""

from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start
from gr_cast.twin.effects.noise_family import NoiseView


def _view(centre, width=0.006, count=65_536):
    rng = np.random.default_rng(5)
    noise = rng.normal(size=count) + 1j * rng.normal(size=count)
    f = np.fft.fftfreq(count)
    inside = np.abs((f - centre + 0.5) % 1.0 - 0.5) < width / 2
    y = np.fft.ifft(np.fft.fft(noise) * np.where(inside, 3.0, 1.0))
    return NoiseView(use=np.ones(count, bool), energy=np.abs(y) ** 2, wanted_power=np.ones(count), weighted=y)


@pytest.mark.parametrize("centre", [0.0, 0.3, -0.45])
def test_a_band_of_stronger_noise_is_found_at_its_frequency(centre):
    _, effect = FAMILIES["narrowband_interference"].find(_view(centre))
    assert effect.p[1] == pytest.approx(centre, abs=0.004)


def test_what_is_left_at_half_the_sample_rate_is_no_interference():
    assert FAMILIES["narrowband_interference"].find(_view(0.5, width=0.004))[1] is None


def _gapped(width, excess_db, count=60_000):
    """Noise with a band at 0.2 of the rate, of which an eighth is held out, in runs of 16 samples."""
    rng = np.random.default_rng(3)
    noise, loud = rng.normal(size=(2, count, 2)) @ [1, 1j] / np.sqrt(2)
    inside = np.abs(np.fft.fftfreq(count) - 0.2) < width / 2
    y = noise + np.fft.ifft(np.fft.fft(loud) * inside) * 10 ** (excess_db / 20)
    use = np.repeat(rng.integers(0, 8, count // 16) > 0, 16)
    return NoiseView(use=use, energy=np.abs(y) ** 2, wanted_power=np.ones(count), weighted=y * use)


@pytest.mark.parametrize(("width", "excess_db"), [(0.036, 44.0), (0.01, 50.0), (0.1, 20.0), (0.05, 3.0)])
def test_a_band_is_as_wide_and_as_strong_as_it_is_however_loud(width, excess_db):
    """Samples that are held out cut it into pieces, whose spectrum is wider."""
    _, effect = FAMILIES["narrowband_interference"].find(_gapped(width, excess_db))
    assert effect.p[1:] == pytest.approx([0.2, width], abs=0.006)
    told_db, true_db = (10 * np.log10(x) for x in (np.exp(effect.p[0]) * effect.p[2], 10 ** (excess_db / 10) * width))
    assert told_db == pytest.approx(true_db, abs=0.35)


@pytest.mark.parametrize(("off", "louder_db", "held"), [(0.02, -8.0, True), (0.3, -8.0, False), (0.02, 8.0, False)])
def test_a_fainter_line_in_the_middle_of_a_band_is_its_carrier(off, louder_db, held):
    band, tone = FAMILIES["narrowband_interference"], FAMILIES["tone_interference"]
    scene = SimpleNamespace(sample_rate_hz=1e6, duration_s=0.05, rms=1.0, wanted_rms=1.0)
    noise = start(band, [np.log(0.01 / 1e-4 / 0.05), 0.1, 0.05], aux={"_floor": 1e-4})  # a hundredth of the wanted power
    line = start(tone, [np.sqrt(0.01 * 10 ** (louder_db / 10)), 0.0, (0.1 + off * 0.05) * 5e4])
    assert bool(band.holds(scene, noise, line)) == held
