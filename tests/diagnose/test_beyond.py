# SPDX-License-Identifier: GPL-3.0-or-later
"""Physics without a name in the contract is told as what is left, where it is, and nothing is named in its place."""

import numpy as np
import pytest
from conftest_world import COUNT, RATE_HZ
from gr_cast.diagnose import diagnose, read_case

U = np.arange(COUNT) / COUNT


def _document(world, folder, y):
    return diagnose(read_case(world.write(folder, world.noisy(y))), budget_s=3000).document


@pytest.mark.parametrize(("first", "last"), [(0.4, 0.47), (0.55, 1.0), (0.7, 0.7)], ids=["glitch", "hop", "jump"])
def test_an_oscillator_that_is_off_for_a_while_is_told_and_is_no_random_phase(world, tmp_path, first, last):
    turned = np.clip((U - first) / max(last - first, 1e-9), 0, 1)
    document = _document(world, tmp_path / "case", world.clean() * np.exp(0.2j * turned))
    (left,) = document["residual"]["where"]
    assert document["verdict"] == "unexplained" and document["effects"] == []
    assert "oscillator is off for a while" in left["test"]
    assert left["time_s"] == pytest.approx([first * COUNT / RATE_HZ, last * COUNT / RATE_HZ], abs=0.02 * COUNT / RATE_HZ)


def test_a_phase_that_walks_at_random_is_phase_noise(world, tmp_path):
    walk = np.cumsum(world.rng.normal(size=COUNT)) * 1e-3
    document = _document(world, tmp_path / "case", world.clean() * np.exp(1j * walk))
    assert document["verdict"] == "identified" and [e["family"] for e in document["effects"]] == ["phase_noise"]


@pytest.mark.parametrize("squared", [0.0, 1.0])
def test_a_receiver_that_bends_by_even_orders_is_told_and_is_no_row_of_tones(world, tmp_path, squared):
    world.taps = [(0, 1.0), (9, 0.8 * np.exp(0.7j)), (31, 0.5j)]  # a signal whose power changes
    y = world.clean()
    y = y + 0.3 * np.exp(0.5j) * np.abs(y) ** 2 + 0.2 * squared * y**2
    document = _document(world, tmp_path / "case", y)
    assert document["verdict"] == "unexplained"
    assert {e["family"] for e in document["effects"]} <= {"dc_offset"}
    assert any("even orders" in left["test"] for left in document["residual"]["where"])
