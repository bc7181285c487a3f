# SPDX-License-Identifier: GPL-3.0-or-later
"""How well numbers are known: against the energy's own slope and curvature by differences, where its noise is not white."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gr_cast.diagnose.places.ears import ResponseEar
from gr_cast.diagnose.places.fit import deviations, evaluated, fitted, normal_equations
from gr_cast.diagnose.places.likelihood import Heard
from gr_cast.diagnose.places.run import _confidence, _doubt
from gr_cast.diagnose.places.search import Found
from gr_cast.scenario.create.nodes import Node
from gr_cast.twin.places.families.base import Effect
from gr_cast.twin.places.families.nodes import NodeDelay, NodePosition
from gr_cast.twin.places.predict import Predictor
from gr_cast.twin.places.world import Radio

sys.path.insert(0, str(Path(__file__).parent))
from test_place_edges import FREQUENCY_HZ, LINKS, ours

TIME_S = np.linspace(0, 3, 6)
EFFECTS = (
    Effect(family=NodePosition(), owner="b", values=np.array([0.012, -0.004, 0.007])),
    Effect(family=NodeDelay(), owner="c", values=np.array([0.3e-9])),
)


def _sounded(scattering: float, diffraction: bool, phase: str):
    """A yard whose `c` walks; 25 dB over the noise and, where it scatters, as much again by patches that nobody knows."""
    random, world = np.random.default_rng(8), replace(ours(), diffraction=diffraction)
    walk = Node(name="c", waypoints_m=np.array([[7.3, -2.2, 2.6], [7.3, 1.2, 2.6]]), speed_m_per_s=1.0, antenna="dipole")
    world = replace(world, radios={**world.radios, "c": Radio(node=walk)})
    world = world.with_surface([0, 1, 2], scattering=scattering)
    predictor = Predictor(*zip(*LINKS, strict=True), TIME_S, FREQUENCY_HZ)
    true = predictor.response(world)
    noise = (np.abs(true) ** 2).mean() / 300
    normal = random.normal(size=(2, *true.shape)) * np.sqrt(noise / 2)
    y = true + normal[0] + 1j * normal[1]
    heard = Heard(
        links=tuple(LINKS), y=y, weight=np.full(y.shape, 1 / noise), frequency_hz=FREQUENCY_HZ, phase=phase, delay="none",
        gain="none",
    )  # fmt: skip
    return [ResponseEar(predictor, heard)], world


def _energy(ears, world, shift):
    first, second = EFFECTS
    return evaluated(ears, world, (first.moved(first.values + shift[:3]), second.moved(second.values + shift[3:]))).energy


@pytest.mark.parametrize("scattering, diffraction", [(0.0, False), (0.6, False), (0.0, True)])
@pytest.mark.parametrize("phase", ["none", "snapshot"])
def test_a_step_goes_where_the_energy_falls_and_deviations_are_of_its_curvature(scattering, diffraction, phase):
    ears, world = _sounded(scattering, diffraction, phase)
    a, b = normal_equations(ears, evaluated(ears, world, EFFECTS), np.arange(4))
    scale = np.sqrt(np.diag(a))
    here = _energy(ears, world, np.zeros(4))
    sides = np.array([[_energy(ears, world, sign * step) for sign in (1, -1)] for step in np.diag(0.3 / scale)])
    slope, curvature = (sides[:, 0] - sides[:, 1]) / 0.6, (sides.sum(axis=1) - 2 * here) / 0.09
    assert -2 * b / scale == pytest.approx(slope, abs=0.12 * np.abs(slope).max())
    assert curvature == pytest.approx(2.0, rel=0.45)


def test_intervals_hold_the_truth_beside_echoes_that_nobody_names():
    """A clock's error of 0.4 ns where each link has an echo, 20 to 30 dB down, of some place: 36 draws."""
    random, within, narrow = np.random.default_rng(2), [], []
    effect = Effect(family=NodeDelay(), owner="c", values=np.array([0.4e-9]))
    for _ in range(36):
        ears, world = _sounded(0.0, False, "none")
        heard, true = ears[0].heard, ears[0].predictor.response(effect.family.apply(world, effect))
        late_s = random.uniform(2e-9, 9e-8, (3, 1, 1))
        size = 10 ** (-random.uniform(20, 30, (3, 1, 1)) / 20) * np.exp(2j * np.pi * random.random((3, 1, 1)))
        strength = np.sqrt((np.abs(true) ** 2).mean(axis=(1, 2), keepdims=True))
        echo = strength * size * np.exp(-2j * np.pi * FREQUENCY_HZ * late_s)
        noise = 1e-5 * (strength**2).min()
        y = true + echo + random.normal(size=(2, *true.shape)).T.dot([1, 1j]).T * np.sqrt(noise / 2)
        ears = [ResponseEar(ears[0].predictor, replace(heard, y=y, weight=np.full(y.shape, 1 / noise)))]
        model = fitted(ears, evaluated(ears, world, (effect,)))
        found = Found(model=model, start=model, rivals={}, tried=1, count=ears[0].count, spent=False)
        std_s = np.sqrt(deviations(ears, model)[0][0, 0] * np.array([1.0, _doubt(found, ears, False)]))
        off = np.abs(model.effects[0].values[0] - 0.4e-9) / std_s
        narrow.append(off[0] < 1.96)
        within.append(off[1] < 1.96)
        assert _doubt(found, ears, True) == 1.0
    assert np.mean(narrow) < 0.3 and np.mean(within) > 0.85


def test_what_another_explains_as_well_is_as_likely_as_not():
    ears, world = _sounded(0.0, False, "none")
    model = evaluated(ears, world, EFFECTS)
    found = Found(model=model, start=model, rivals={}, tried=1, count=1.0, spent=False)
    mine, _ = EFFECTS
    sure = [_confidence(mine, 500.0, behind, 50.0, True, found) for behind in ([], [0.0], [9.0])]
    assert sure[0] == pytest.approx(0.95, abs=0.05)
    assert sure[1] == pytest.approx(sure[0] / 2, abs=0.01) and sure[1] < sure[2] < sure[0]
    assert _confidence(mine, 500.0, [], -50.0, True, found) < 0.6 > 0.9 * _confidence(mine, 500.0, [], 50.0, False, found)


def test_what_was_told_when_the_time_ended_is_less_sure():
    ears, world = _sounded(0.0, False, "none")
    model = evaluated(ears, world, EFFECTS)
    ended, done = (Found(model=model, start=model, rivals={}, tried=1, count=1.0, spent=spent) for spent in (True, False))
    mine, _ = EFFECTS
    sure = [_confidence(mine, 500.0, [9.0], 50.0, True, found) for found in (ended, done)]
    assert sure[0] < 0.9 * sure[1]
