# SPDX-License-Identifier: GPL-3.0-or-later
"""The shortest repetition of a waveform."""

import numpy as np
import pytest
from gr_cast.signals.periods import one_period

RNG = np.random.default_rng(3)


def gaussian(count):
    return (RNG.normal(size=count) + 1j * RNG.normal(size=count)).astype(np.complex64)


@pytest.mark.parametrize("period", [1, 7, 12, 255, 1024])
@pytest.mark.parametrize("times", [1, 2, 3, 8, 30])
def test_a_waveform_that_holds_some_periods_is_one_of_them(period, times):
    once = gaussian(period)
    assert np.array_equal(one_period(np.tile(once, times)), once)


def test_one_sample_that_differs_makes_it_whole():
    wave = np.tile(gaussian(100), 4)
    wave[250] += 1e-3
    assert len(one_period(wave)) == 400


def test_unknown_samples_are_alike_where_all_periods_have_them():
    wave = np.tile(gaussian(100), 3)
    wave[[5, 105, 205]] = np.nan
    assert len(one_period(wave)) == 100
    wave[6] = np.nan
    assert len(one_period(wave)) == 300


def test_a_period_that_does_not_divide_the_file_is_none_of_it():
    assert len(one_period(np.tile(gaussian(100), 4)[:350])) == 350
