# SPDX-License-Identifier: GPL-3.0-or-later
"""A supply that switches hums far above the audible, with harmonics of its own."""

import numpy as np
import pytest
from conftest_world import RATE_HZ, noise, sent_once
from gr_cast.diagnose import diagnose


@pytest.mark.parametrize("depths", [(0.05,), (0.05, 0.02, 0.01)], ids=["sine", "harmonics"])
def test_a_hum_of_a_switched_supply_is_one_hum_and_neither_noise_nor_pulses(tmp_path, depths):
    rng, count, cycles = np.random.default_rng(4), 40_000, 622.5
    sent = np.fft.ifft(np.fft.fft(rng.normal(size=(count, 2)) @ [1, 1j]) * (np.abs(np.fft.fftfreq(count)) < 0.3))
    turn = 2 * np.pi * cycles * np.arange(count) / count
    y = 0.3 * sent * (1 + sum(m * np.cos(k * turn + k) for k, m in enumerate(depths, 1))) + noise(rng, count, 0.004)
    (told,) = diagnose(sent_once(tmp_path, y, sent), budget_s=300).document["effects"]
    assert told["family"] == "power_supply_hum"
    frequency = told["parameters"]["frequency_hz"]
    assert frequency["value"] == pytest.approx(cycles / count * RATE_HZ, abs=4 * frequency["std"])
    assert told["parameters"]["depth"]["value"] == pytest.approx(depths[0], rel=0.02)
