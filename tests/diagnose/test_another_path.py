# SPDX-License-Identifier: GPL-3.0-or-later
"""A path that is gone takes no delay with it: what is found where it was looked for may be another one."""

import numpy as np
import pytest
from conftest_world import RATE_HZ, noise, sent_once
from gr_cast.diagnose import align, diagnose, read_case
from gr_cast.diagnose.search import beginnings, refit
from gr_cast.diagnose.view import View
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start


@pytest.mark.parametrize(
    ("left", "noise_rms", "family"), [(0.0, 0.01, "missing_path"), (0.0, 0.08, "missing_path"), (0.06, 0.01, "tap_gain_error")]
)
def test_a_strongest_path_that_is_gone_or_weak_is_named_though_another_is_found_at_its_delay(
    world, tmp_path, left, noise_rms, family
):
    world.noise_rms = noise_rms
    world.taps = [(0, 1.0), (9, 0.3 * np.exp(0.7j)), (25, 0.2 * np.exp(-1.1j))]
    world.taps[0] = (0, left * np.exp(2j))
    y = world.noisy(world.clean())
    world.taps[0] = (0, 1.0)
    case = read_case(world.write(tmp_path / "case", y))
    _, data, model = align.build(case, case.observations[0])
    best = beginnings(data, model)[0]
    assert [e.family for e in best.model.effects] == [family]
    assert best.model.base[0] == pytest.approx(37.0, abs=5 * noise_rms)
    assert best.sigma2 < 1.2 * world.noise_rms**2


@pytest.mark.parametrize("late", [40, 374, 900])
def test_an_echo_of_what_is_sent_once_is_found_however_late_it_is(tmp_path, late):
    rng = np.random.default_rng(late)
    sent = np.sign(rng.normal(size=6000)) + 1j * np.sign(rng.normal(size=6000))
    heard = noise(rng, 8000, 0.05)
    for delay, gain in ((300, 0.2), (300 + late, 0.1 * np.exp(1j))):
        heard[delay : delay + len(sent)] += gain * sent
    document = diagnose(sent_once(tmp_path, heard, sent)).document
    (echo,) = document["effects"]
    assert document["verdict"] == "identified" and echo["family"] == "extra_path"
    assert echo["parameters"]["delay_s"]["value"] * RATE_HZ == pytest.approx(late, abs=0.05)
    assert echo["parameters"]["gain_db"]["value"] == pytest.approx(20 * np.log10(0.5), abs=0.2)


def test_where_all_paths_are_gone_no_clock_is_read_of_them(world, tmp_path):
    case = read_case(world.write(tmp_path / "case", world.noisy(0 * world.clean())))
    _, data, model = align.build(case, case.observations[0])
    for tap in range(2):
        model = model.adding(start(FAMILIES["missing_path"], [], aux={"tap": tap}))
    assert View(refit(data, model)).timing_drift() == 0.0
