# SPDX-License-Identifier: GPL-3.0-or-later
"""From a place to IQ samples and back: what is sounded in an emulated world is that world, whatever its twin believes."""

import re

import _program  # noqa: F401  (finds gr_cast's programs)
import cast_case
import numpy as np
import place_case
import pytest
from gr_cast.core.errors import CastError
from gr_cast.diagnose.places import diagnose
from gr_cast.scenario.create import spec, trace
from gr_cast.twin.places import document, play

C_M_PER_S, CARRIER_HZ = 299_792_458.0, 2.4e9
FREQUENCY_HZ = np.linspace(-1.0e7, 1.0e7, 41)
FLOOR = "o floor\nv -50 -50 0\nv 50 -50 0\nv 50 50 0\nv -50 50 0\nf 1 2 3 4\n"
WALL = "o wall\nv -50 20 0\nv 50 20 0\nv 50 20 40\nv -50 20 40\nf 5 6 7 8\n"
SPEC = """
cast_create: 1
id: yard
environment: {carrier_hz: 2.4e+9, bandwidth_hz: 20.0e+6}
model: {mesh: mesh.obj}
materials: {"*": metal}
nodes:
  a: {position_m: [0, 0, 6]}
  b: {position_m: [12, 3, 2]}
  c: {waypoints_m: [[5, 12, 1.5], [15, 12, 1.5]], speed_m_per_s: 5}
sampling: {duration_s: 2, step_s: 0.05, max_depth: 1}
"""
TIMES_S = np.array([0.0, 1.0, 1.5])


def twin(folder, mesh=FLOOR):
    links = dict(tx=np.array(["a", "a"]), rx=np.array(["b", "c"]), time_s=TIMES_S)
    monday = links | dict(frequency_hz=FREQUENCY_HZ, response=np.zeros((2, 3, 41), np.complex64), noise_power=np.ones(2))
    flight = links | dict(power_db=np.zeros((2, 3)), std_db=np.array([0.2, 0.2]))
    return place_case.write(folder, spec=SPEC, mesh=mesh, monday=monday, flight=flight)


def heard(images_m, at_m):
    """Paths from images of node a in perfect conductors: a vertical field keeps its sign on a floor, and turns it on a wall."""
    out = 0
    for image_m, sign in images_m:
        length_m = np.linalg.norm(np.array(at_m) - image_m)
        gain = sign * C_M_PER_S / CARRIER_HZ / (4 * np.pi * length_m)
        out = out + gain * np.exp(-2j * np.pi * (CARRIER_HZ + FREQUENCY_HZ) * length_m / C_M_PER_S)
    return out


DIRECT, ON_FLOOR, ON_WALL = (np.array([0, 0, 6.0]), 1), (np.array([0, 0, -6.0]), 1), (np.array([0, 40, 6.0]), -1)
WHERE = {"b": [(12, 3, 2)] * 3, "c": [(5 + 5 * t, 12, 1.5) for t in TIMES_S]}


@pytest.fixture
def played(tmp_path, monkeypatch):
    """What is sounded where there is a wall, by a case whose twin has none."""
    monkeypatch.setattr(trace, "is_installed", lambda: False)
    twin(tmp_path / "case")
    twin(tmp_path / "world", FLOOR + WALL)
    arguments = ["place", tmp_path / "case", "--world", tmp_path / "world" / "spec.yaml", "--output", tmp_path / "played"]
    assert cast_case.main([str(one) for one in arguments]) == 0
    return document.read(tmp_path / "played")


def test_a_wall_that_the_twin_has_not_is_in_what_is_sounded_through_iq_samples(played):
    assert [solid.name for solid in played.solids] == ["floor"]  # the twin is as it was
    monday, flight = played.soundings
    assert monday.tx == ("a", "a") and monday.rx == ("b", "c") and np.array_equal(monday.time_s, TIMES_S)
    np.testing.assert_allclose(monday.frequency_hz, FREQUENCY_HZ)
    for row, node in enumerate(monday.rx):
        true, believed = (
            np.stack([heard(images, at_m) for at_m in WHERE[node]])
            for images in ([DIRECT, ON_FLOOR, ON_WALL], [DIRECT, ON_FLOOR])
        )
        error, missing = (np.sum(np.abs(monday.response[row] - H) ** 2) / monday.noise_power[row] for H in (true, believed))
        # What taps lose weighs as one entry whenever they differ; a wall shows. Taps one step apart are told apart at all times.
        assert error < 6 * (1 if node == "b" else 3) and missing > 100, (node, error, missing)
        power_db = 10 * np.log10(np.mean(np.abs(true) ** 2, axis=1))
        np.testing.assert_allclose(flight.power_db[row], power_db, atol=1.5)


def test_nobody_is_accused_of_what_four_taps_lose_and_it_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(trace, "is_installed", lambda: False)
    twin(tmp_path / "case")
    assert cast_case.main(["place", str(tmp_path / "case"), "--output", str(tmp_path / "played")]) == 0
    assert re.search(r"four taps on a grid of 10 ns lose -\d\d\.\d dB .* worst -\d\d\.\d dB, a>[bc]", capsys.readouterr().out)
    found = diagnose(document.read(tmp_path / "played")).document
    assert found["verdict"] == "no_mismatch" and found["effects"] == []


def test_what_four_taps_lose_is_named_where_the_noise_does_not_hide_it(tmp_path, monkeypatch):
    """Soundings of a scenario that say of themselves no more noise than a sounder has: no wall, body or gain is accused."""
    monkeypatch.setattr(trace, "is_installed", lambda: False)
    monkeypatch.setattr(play.pipeline, "lost", lambda *_: {})
    still = SPEC.replace("waypoints_m: [[5, 12, 1.5], [15, 12, 1.5]], speed_m_per_s: 5", "position_m: [5, 12, 1.5]")
    links = dict(tx=np.array(["a", "a", "b"]), rx=np.array(["b", "c", "c"]), time_s=TIMES_S[:1])
    monday = links | dict(frequency_hz=FREQUENCY_HZ, response=np.zeros((3, 1, 41), np.complex64), noise_power=np.ones(3))
    flight = links | dict(power_db=np.zeros((3, 1)), std_db=np.full(3, 0.5))
    place_case.write(tmp_path / "case", spec=still, mesh=FLOOR + WALL, monday=monday, flight=flight)
    assert cast_case.main(["place", str(tmp_path / "case"), "--output", str(tmp_path / "played")]) == 0
    found = diagnose(document.read(tmp_path / "played"), budget_s=30.0).document
    assert found["verdict"] == "no_mismatch" and found["effects"] == []
    assert (
        len(found["warnings"]) == 1 and "4 taps on a grid of 10 ns" in found["warnings"][0] and "lose -4" in found["warnings"][0]
    )


def test_the_same_seed_gives_the_same_soundings_and_a_folder_that_is_there_stays(played, tmp_path, capsys):
    world = play.world(
        spec.read(tmp_path / "world" / "spec.yaml"), play.pipeline.Run(folder=tmp_path / "w", tell=lambda line: None)
    )
    again = play.campaigns(document.read(tmp_path / "case"), world, noise_power_db=-110, seed=1)
    np.testing.assert_array_equal(again["monday.npz"]["response"], played.soundings[0].response)
    with pytest.raises(CastError, match="is there already"):
        cast_case.main(["place", str(tmp_path / "case"), "--output", str(tmp_path / "played")])


def test_nodes_and_times_that_a_world_has_not_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr(trace, "is_installed", lambda: False)
    place = document.read(twin(tmp_path / "case"))
    other = SPEC.replace("  c: {", "  d: {").replace("duration_s: 2", "duration_s: 1")
    (tmp_path / "case" / "other.yaml").write_text(other)
    world = play.world(
        spec.read(tmp_path / "case" / "other.yaml"), play.pipeline.Run(folder=tmp_path / "w", tell=lambda line: None)
    )
    with pytest.raises(CastError) as error:
        play.campaigns(place, world, noise_power_db=-110, seed=1)
    assert sum("node c: not in the world" in line for line in error.value.faults) == 2
    assert sum("the world lasts from 0 to 1 s" in line for line in error.value.faults) == 2
