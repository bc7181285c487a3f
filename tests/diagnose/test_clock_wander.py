# SPDX-License-Identifier: GPL-3.0-or-later
"""A sample clock that wanders is no cause of the contract: it is told as what is left, and nothing is claimed in its place."""

import re

import numpy as np
import pytest
from gr_cast.diagnose import diagnose, read_case
from scipy.interpolate import CubicSpline
from scipy.signal import resample

FINE = 16  # times finer, that a spline through the samples is the signal between them


def _heard(world, late):
    """The recording of a world whose receiver takes every sample `late` (n,) samples late."""
    count, period = len(world.n), len(world.x)
    link = np.zeros(period, complex)
    for delay, gain in world.taps:
        link[delay] = 0.3 * np.exp(0.4j) * gain
    whole = np.tile(np.fft.ifft(np.fft.fft(world.x) * np.fft.fft(link)), 3)
    fine = resample(whole, FINE * len(whole))[FINE * period // 2 : FINE * 5 * period // 2]
    between = CubicSpline(np.arange(len(fine)) / FINE - period / 2, fine)
    assert len(late) == count
    return world.noisy(between((world.n + late - 37.0) % period))


def _document(world, folder, late):
    return diagnose(read_case(world.write(folder, _heard(world, late)))).document


@pytest.mark.parametrize(("turns", "samples"), [(0.5, 0.08), (2.0, 0.08), (2.0, 0.4)])
def test_a_wandering_sample_clock_is_left_and_no_cause_stands_in_for_it(world, tmp_path, turns, samples):
    wander = samples * np.cos(2 * np.pi * turns * world.n / len(world.n))
    around = wander - np.polyval(np.polyfit(world.n, wander, 1), world.n)
    document = _document(world, tmp_path / "case", wander)
    assert document["verdict"] == "unexplained" and not document["effects"]
    (left,) = document["residual"]["where"]
    value, unit = re.match(r"The sample clock wanders: ([\d.]+) ± [\d.]+ (\w+) rms", left["test"]).groups()
    assert float(value) * {"ns": 1e-9, "µs": 1e-6}[unit] == pytest.approx(1e-6 * np.std(around), rel=0.15)
    assert document["fit"]["corrected_nmse_db"] < document["fit"]["noise_floor_db"] + 0.3


def test_a_clock_that_is_steadily_fast_does_not_wander(world, tmp_path):
    document = _document(world, tmp_path / "case", 0.3 * world.n / len(world.n))
    assert document["verdict"] == "identified"
    (effect,) = document["effects"]
    assert effect["family"] == "sample_clock_offset"
    assert effect["parameters"]["offset_ppm"]["value"] == pytest.approx(15.0, abs=4 * effect["parameters"]["offset_ppm"]["std"])
