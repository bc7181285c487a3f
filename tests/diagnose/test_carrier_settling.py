# SPDX-License-Identifier: GPL-3.0-or-later
"""A frequency that relaxes is no random phase, and a random phase is not taken for one that relaxes."""

import re

import numpy as np
import pytest
from conftest_world import RATE_HZ
from gr_cast.diagnose import align, diagnose, read_case
from gr_cast.diagnose.search import refit
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start
from gr_cast.twin.effects.carrier_settling import relaxation
from gr_cast.twin.effects.phase_noise import shape_of


def warmed_up(world, turn_rad, share):
    u = world.n / len(world.n)
    return world.noisy(world.clean() * np.exp(1j * turn_rad * np.exp(-u / share)))


@pytest.mark.parametrize("log_tau", [-3.0, -1.0, 0.0])
def test_a_relaxation_has_no_mean_and_no_slope(log_tau):
    u = (np.arange(100_000) + 0.5) / 100_000
    course = relaxation(u, log_tau)
    assert np.allclose([course.mean(), course @ (u - 0.5) / len(u)], 0.0, atol=1e-8)
    bent = np.diff(course[::1000], 2)  # falls by one share from each to the next
    assert bent[1:] / bent[:-1] == pytest.approx(np.exp(-0.01 / np.exp(log_tau)), rel=1e-3)


@pytest.mark.parametrize(("turn_rad", "share"), [(0.6, 0.15), (-1.2, 0.1)])
def test_an_oscillator_that_warms_up_is_left_with_its_time_constant(world, tmp_path, turn_rad, share):
    document = diagnose(read_case(world.write(tmp_path / "case", warmed_up(world, turn_rad, share))), budget_s=100).document
    assert document["verdict"] == "unexplained"
    assert {e["family"] for e in document["effects"]} <= {"carrier_frequency_offset"}
    [rest] = [rest for rest in document["residual"]["where"] if rest["test"].startswith("The oscillator settles")]
    tau_s = share * len(world.n) / RATE_HZ
    told = [float(number) for number in re.findall(r"(-?[\d.]+) ±", rest["test"])]  # in Hz and ms
    assert told == pytest.approx([-turn_rad / (2 * np.pi * tau_s), 1e3 * tau_s], rel=0.03)


def _likelier(world, tmp_path, seed, heard) -> float:
    """Nats by which a settling oscillator is likelier than the random phase that was fitted first."""
    case = read_case(world.write(tmp_path / f"{seed}", heard))
    scene, data, model = align.build(case, case.observations[0])
    family, carrier = FAMILIES["phase_noise"], start(FAMILIES["carrier_frequency_offset"], [0.0, 0.0])
    wander = start(family, np.zeros(6), prior=shape_of({"law": "free"}, 6), trials=12, aux={"law": "free"})
    random = refit(data, model.adding(carrier).adding(wander))
    at = next(i for i, e in enumerate(random.model.effects) if e.family == "phase_noise")
    span = random.model.span(at)
    [(settles, _)] = FAMILIES["carrier_settling"].instead_of(scene, random.model.effects[at], random.covariance[span, span])
    return refit(data, random.model.replacing(at, settles)).evidence - random.evidence


def test_a_walk_of_a_few_cosines_is_no_relaxation(world, tmp_path):
    """Under 1/f⁴, the smoothest that an oscillator walks, at any loudness."""
    won = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        steps = np.cumsum(np.cumsum(rng.normal(size=len(world.n)))) if seed % 2 else np.cumsum(rng.normal(size=len(world.n)))
        u = np.linspace(-1, 1, len(steps))
        course = steps - np.polyval(np.polyfit(u, steps, 1), u)
        loud = 10 ** rng.uniform(-2, 0) / np.std(course)
        won += _likelier(world, tmp_path, seed, world.noisy(world.clean() * np.exp(1j * loud * course))) > 0
    assert won == 0
    assert _likelier(world, tmp_path, 99, warmed_up(world, 0.6, 0.15)) > 10
