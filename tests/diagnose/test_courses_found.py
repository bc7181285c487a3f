# SPDX-License-Identifier: GPL-3.0-or-later
"""Slow and fast courses of gain and phase, each told as the one thing that it is."""

import numpy as np
import pytest
from conftest_world import COUNT
from gr_cast.diagnose import diagnose, read_case

U = np.arange(COUNT) / COUNT


def _told(world, folder, y):
    document = diagnose(read_case(world.write(folder, world.noisy(y))), budget_s=3000).document
    assert document["verdict"] == "identified"
    return document["effects"]


def _scattered(rng, turns: float) -> np.ndarray:
    """(COUNT,) a course of power 1 of waves from all around, that turn so often at most (Clarke 1968)."""
    way, phase = rng.uniform(0, 2 * np.pi, (2, 64, 1))
    return np.exp(1j * (2 * np.pi * turns * np.cos(way) * U + phase)).sum(0) / 8


@pytest.mark.parametrize(("turns", "scattered_db", "seed"), [(5.0, -5.0, 3), (60.0, -3.0, 2)])
def test_a_path_that_fades_is_one_effect_however_fast_and_its_mean_no_image(world, tmp_path, turns, scattered_db, seed):
    path = 0.15 * np.exp(1.1j) * world.path(9)
    course = 10 ** (scattered_db / 20) * _scattered(np.random.default_rng(seed), turns)
    (told,) = _told(world, tmp_path / "case", world.clean() + path * course)
    assert told["family"] == "tap_fading"


@pytest.mark.parametrize("course", [1 - np.exp(-U / 0.8), np.log2(1 + U)], ids=["relaxation", "logarithm"])
def test_a_gain_that_levels_off_is_a_drift_and_no_hum_beside(world, tmp_path, course):
    (told,) = _told(world, tmp_path / "case", world.clean() * 10 ** (0.8 * course / 20))
    assert told["family"] == "gain_drift"
    total = told["parameters"]["total_db"]
    assert abs(total["value"] - 0.8 * course[-1]) < max(3 * total["std"], 0.02)
