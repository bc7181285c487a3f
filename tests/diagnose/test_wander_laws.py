# SPDX-License-Identifier: GPL-3.0-or-later
"""The slowest of what an oscillator wanders is its own, and no offset nor drift of a carrier: phase noise has the law it has."""

import numpy as np
import pytest
from conftest_world import COUNT
from gr_cast.diagnose import diagnose, read_case

RMS_RAD = 0.7


def _wandering(rng, slope: float) -> np.ndarray:
    """(COUNT,) a phase of density 1/f^slope, of which slope and mean are taken out, as a held mean frequency leaves it."""
    f = np.maximum(np.fft.rfftfreq(8 * COUNT), 0.3 / COUNT)
    spectrum = f ** (-slope / 2) * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
    phase, u = np.fft.irfft(spectrum)[:COUNT], np.arange(COUNT)
    phase -= np.polyval(np.polyfit(u, phase, 1), u)
    return phase * RMS_RAD / np.sqrt(np.mean(phase**2))


@pytest.mark.parametrize("slope", [2.0, 3.0], ids=["free", "flicker"])
@pytest.mark.parametrize("seed", range(2))
def test_an_oscillator_that_wanders_freely_has_no_offset_beside(world, tmp_path, slope, seed):
    phase = _wandering(np.random.default_rng(seed), slope)
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean() * np.exp(1j * phase))))
    (told,) = diagnose(case, budget_s=3000).document["effects"]
    assert told["family"] == "phase_noise"
    number = told["parameters"]["rms_rad"]
    assert abs(number["value"] - RMS_RAD) < 3 * number["std"]
