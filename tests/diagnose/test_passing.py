# SPDX-License-Identifier: GPL-3.0-or-later
"""A random course is one throughout a recording: what moves in one stretch alone is no phase noise and no fading."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest_world import RATE_HZ
from gr_cast.diagnose import diagnose, passing, read_case
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start

LAWS = {"free": lambda k: 1 / k, "held": lambda k: 1 / np.hypot(1, k / 20), "flat": np.ones_like}


def _p_value(family, numbers, count=20_000):
    scene = SimpleNamespace(index=np.arange(count, dtype=float), span=count, sample_rate_hz=RATE_HZ)
    fit = SimpleNamespace(
        data=SimpleNamespace(scene=scene, use=np.ones(count)), chain=SimpleNamespace(wanted=np.ones(count)), model=None
    )
    return passing.stretch(fit, start(FAMILIES[family], numbers)).p_value


@pytest.mark.parametrize("family", ["phase_noise", "tap_fading"])
@pytest.mark.parametrize("law", LAWS)
def test_a_course_of_any_law_moves_in_no_stretch_alone(monkeypatch, family, law):
    monkeypatch.setattr(passing, "SURROGATES", 60)
    rng, orders = np.random.default_rng(5), np.repeat(np.arange(1.0, 49.0), 2 if family == "tap_fading" else 1)
    told = [_p_value(family, LAWS[law](orders) * rng.normal(size=len(orders))) for _ in range(10)]
    assert min(told) > 1e-3 and np.mean(told) > 0.2


def test_an_oscillator_that_slips_for_a_while_has_no_phase_noise(world, tmp_path):
    phase = 12 * np.clip((world.n - 8_000) / 3_000, 0, 1)
    document = diagnose(
        read_case(world.write(tmp_path / "case", world.noisy(world.clean() * np.exp(1j * phase)))), budget_s=60
    ).document
    assert document["verdict"] == "unexplained"
    assert not {"phase_noise", "tap_fading"} & {e["family"] for e in document["effects"]}
    places = [w["time_s"] for w in document["residual"]["where"] if "time_s" in w]
    assert any(a * RATE_HZ < 11_300 and b * RATE_HZ > 7_700 for a, b in places)


def test_an_oscillator_that_wanders_throughout_has_phase_noise(world, tmp_path):
    phase = np.cumsum(world.rng.normal(size=len(world.n))) * 0.01
    document = diagnose(
        read_case(world.write(tmp_path / "case", world.noisy(world.clean() * np.exp(1j * phase)))), budget_s=3000
    ).document
    assert "phase_noise" in {e["family"] for e in document["effects"]} and document["verdict"] == "identified"


@pytest.mark.parametrize(("turns", "orders"), [(1, 6), (1, 24), (2, 24), (5, 96), (9, 96), (13, 96)])
def test_paths_that_fade_as_clarke_says_lie_along_no_line(turns, orders):
    """Whose cosines beyond the Doppler spread are what the two ends of the recording make of them."""
    rng, u = np.random.default_rng(turns), (np.arange(2048) + 0.5) / 2048
    cosines = np.sqrt(2) * np.cos(np.pi * np.arange(1, orders + 1)[:, None] * u) / len(u)
    p_values = []
    for _ in range(150):
        angle, phase = rng.uniform(0, 2 * np.pi, (2, 48))
        course = np.exp(1j * (2 * np.pi * turns * np.cos(angle)[:, None] * u + phase[:, None])).sum(axis=0) / 7
        noise_rms = 10 ** rng.uniform(-4, -2)
        c = cosines @ course + noise_rms * (rng.normal(size=orders) + 1j * rng.normal(size=orders))
        p_values.append(passing.of_one_line(c, np.full(orders, 2 * noise_rms**2)))
    assert min(p_values) > 1e-5 and np.mean(np.array(p_values) < 0.01) < 0.06


@pytest.mark.parametrize("turn_rad", [0.0, 0.9, np.pi / 2])
def test_a_path_that_is_shaded_for_a_while_changes_along_one_line(turn_rad):
    u = (np.arange(4096) + 0.5) / 4096
    dip = -0.3 * (np.tanh((u - 0.2) / 0.05) - np.tanh((u - 0.5) / 0.05))
    rng = np.random.default_rng(5)
    c = np.array([np.sqrt(2) * np.mean(dip * np.cos(np.pi * k * u)) for k in range(1, 25)]) * np.exp(1j * turn_rad)
    c = c + 0.003 * (rng.normal(size=24) + 1j * rng.normal(size=24))
    assert passing.of_one_line(c, np.full(24, 2e-5)) < 1e-5
    assert passing.of_one_line(c * np.exp(2j * np.pi * rng.random(24)), np.full(24, 2e-5)) > 1e-3
    assert passing.of_one_line(1e-3 * c, np.full(24, 2e-5)) == 1.0  # of what is not clear nothing is told
