# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs of zeros are blanks where noise or a few steps of a slow signal would not leave them."""

import numpy as np
import pytest
from gr_cast.diagnose import blanks
from scipy import ndimage

COUNT = 100_000


def _coarse(rng, oversampling, rms_steps):
    """A Gaussian signal that is slow, in steps of 1."""
    slow = [ndimage.gaussian_filter1d(rng.normal(size=COUNT), oversampling / 2) for _ in range(2)]
    y = rms_steps * np.array([one / one.std() for one in slow]) + 0.1 * rng.normal(size=(2, COUNT))
    return np.round(y[0]) + 1j * np.round(y[1])


@pytest.mark.parametrize("oversampling", [8, 16, 32])
@pytest.mark.parametrize("rms_steps", [1.5, 3.0, 30.0])
def test_a_slow_signal_of_few_steps_has_none(oversampling, rms_steps):
    y = _coarse(np.random.default_rng(oversampling), oversampling, rms_steps)
    assert len(blanks.runs(y)) <= 2  # of a hundred thousand samples


@pytest.mark.parametrize("rms_steps", [30.0, None])
def test_written_zeros_are_found_to_the_sample(rms_steps):
    rng = np.random.default_rng(4)
    y = rng.normal(size=COUNT) + 1j * rng.normal(size=COUNT) if rms_steps is None else _coarse(rng, 8, rms_steps)
    y[700:900], y[40_000:40_031] = 0, 0
    assert blanks.runs(y).tolist() == [[700, 900], [40_000, 40_031]]
    assert blanks.inside(y).sum() == 231


def test_a_recording_that_is_silent_for_a_good_part_has_none():
    y = np.random.default_rng(4).normal(size=COUNT) + 0j
    y[: COUNT // 5] = 0
    assert len(blanks.runs(y)) == 0
