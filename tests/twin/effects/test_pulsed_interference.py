# SPDX-License-Identifier: GPL-3.0-or-later
"""Pulses of noise, however few of them a recording holds."""

import numpy as np
import pytest
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.noise_family import NoiseView

COUNT = 40_000


def _found(y):
    """(gain, effect) of pulses in samples `y` of noise."""
    view = NoiseView(use=np.ones(COUNT, bool), energy=np.abs(y) ** 2, wanted_power=np.ones(COUNT), weighted=y)
    return FAMILIES["pulsed_interference"].find(view)


@pytest.mark.parametrize("pulses", [3.4, 5.2, 20.3])
def test_the_period_of_a_few_pulses_is_that_of_the_pulses_and_no_part_of_it(pulses):
    """Only harmonics of a slow beat stand out of the spectrum; at half the period every other window is empty."""
    rng, period = np.random.default_rng(7), COUNT / pulses
    on = (np.arange(COUNT) - 500) / period % 1.0 < 0.1
    y = (rng.normal(size=(COUNT, 2)) @ [1, 1j]) * np.where(on, 1.3, 1.0)
    _, found = _found(y)
    assert found.p[1] == pytest.approx(period, rel=0.02) and found.p[3] == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize("length", [60, 400, 3_000])
def test_one_burst_is_no_train(length):
    rng = np.random.default_rng(8)
    y = rng.normal(size=(COUNT, 2)) @ [1, 1j] * np.where(np.abs(np.arange(COUNT) - 9_000) < length // 2, 10.0, 1.0)
    assert _found(y) == (0.0, None)


@pytest.mark.parametrize("seed", range(4))
def test_a_train_that_hardly_stands_out_has_its_period_though_no_longer_one_does(seed):
    rng, period = np.random.default_rng(seed), COUNT / 8.5
    y = rng.normal(size=(COUNT, 2)) @ [1, 1j] * np.where((np.arange(COUNT) - 500) / period % 1.0 < 0.1, 1.05, 1.0)
    gain, found = _found(y)
    assert found is None and not gain or gain > np.log(found.trials)


@pytest.mark.parametrize("seed", range(3))
def test_loud_pulses_have_their_period_and_no_multiple_of_it(seed):
    """However sure several periods are, for each has harmonics in the spectrum, the likeliest is taken."""
    rng, period = np.random.default_rng(seed), COUNT / 14.4
    y = rng.normal(size=(COUNT, 2)) @ [1, 1j] * np.where((np.arange(COUNT) - 1300) / period % 1.0 < 0.043, 4.0, 1.0)
    _, found = _found(y)
    assert found.p[1] == pytest.approx(period, rel=1e-3) and found.p[3] == pytest.approx(0.043, abs=0.003)
