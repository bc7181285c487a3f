# SPDX-License-Identifier: GPL-3.0-or-later
"""What is left of a fit is made white, whatever part of it is held out."""

import numpy as np
import pytest
from gr_cast.diagnose.fit import Data


@pytest.mark.parametrize("excess_db", [10.0, 44.0])
def test_noise_with_a_loud_band_is_white_of_unit_power_beside_samples_that_are_held_out(excess_db):
    rng, count = np.random.default_rng(4), 48_000
    inside = np.abs(np.fft.fftfreq(count) + 0.1) < 0.02
    spectrum = np.where(inside, 10 ** (excess_db / 10), 1.0)
    y = np.fft.ifft(np.fft.fft(rng.normal(size=(count, 2)) @ [1, 1j] / np.sqrt(2)) * np.sqrt(spectrum))
    use = np.repeat(rng.integers(0, 8, count // 16) > 0, 16).astype(float)
    white = Data(scene=None, y=y, use=use, vault=use == 0, spectrum=spectrum, loud=True).whitened(y)
    assert np.mean(np.abs(white[use > 0]) ** 2) == pytest.approx(1.0, abs=0.05)
    assert not white[use == 0].any()
