# SPDX-License-Identifier: GPL-3.0-or-later
"""Interference in a part of the band is found where it can be, and not where interpolation ends."""

import numpy as np
import pytest
from gr_cast.twin.effects import FAMILIES
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
