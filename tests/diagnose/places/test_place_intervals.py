# SPDX-License-Identifier: GPL-3.0-or-later
"""How well numbers are known: against the energy's own slope and curvature by differences, where its noise is not white."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gr_cast.diagnose.places.ears import ResponseEar
from gr_cast.diagnose.places.fit import evaluated, normal_equations
from gr_cast.diagnose.places.likelihood import Heard
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
