# SPDX-License-Identifier: GPL-3.0-or-later
"""A tone beside a band of noise that is far louder than it."""

import numpy as np
import pytest
from conftest_world import RATE_HZ, noise, sent_once
from gr_cast.diagnose import diagnose


@pytest.mark.parametrize("seed", [3, 4])
def test_a_loud_band_hides_no_tone_and_its_own_ringing_is_nothing_more(tmp_path, seed):
    rng, n = np.random.default_rng(seed), 20_000
    x = noise(rng, n)
    f = np.fft.fftfreq(n)
    band = np.fft.ifft(np.where(np.abs(f + 0.22) < 0.02, np.fft.fft(noise(rng, n)), 0.0))  # with sharp edges
    band *= 5 / np.sqrt(np.mean(np.abs(band) ** 2))
    tone = 0.06 * np.exp(2j * np.pi * (0.0277 * np.arange(n) + 0.3))
    case = sent_once(tmp_path, 0.1 * (x + band + tone) + noise(rng, n, 0.02), x)
    document = diagnose(case, budget_s=3000).document
    told = {e["family"]: e for e in document["effects"]}
    assert document["verdict"] == "identified" and set(told) == {"narrowband_interference", "tone_interference"}
    assert told["tone_interference"]["parameters"]["frequency_hz"]["value"] == pytest.approx(0.0277 * RATE_HZ, abs=5)
