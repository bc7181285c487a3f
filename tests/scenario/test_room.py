# SPDX-License-Identifier: GPL-3.0-or-later
"""The closed-form room against Fermat's principle, Friis, Brewster, and derivatives taken numerically."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.scenario.create import materials, mesh_files, room
from gr_cast.scenario.create.media import Medium
from gr_cast.scenario.create.nodes import Node, position_m
from gr_cast.scenario.create.spec import read
from scipy.optimize import minimize

C_M_PER_S = 299_792_458.0
SIZE_M = np.array([19.0, 12.0, 3.2])


@pytest.fixture(scope="module")
def arena():
    spec = read(sc.examples_folder() / "arena.yaml")
    return spec, materials.assign(mesh_files.read(spec.model_path), spec.materials, spec.carrier_hz)


def test_lengths_are_the_shortest_ways_over_the_sides(arena):
    spec, solids = arena
    nodes = {node.name: node for node in spec.nodes}
    tx, rx = (position_m(nodes[name], np.zeros(1))[0] for name in ("c12", "s5"))
    link = room.link_paths(spec, solids, nodes["c12"], nodes["s5"], np.zeros(1), 1)
    found_m = np.sort(link.delay_s[0] * C_M_PER_S)

    def shortest(axis, wall):
        def length(free):
            point = np.insert(free, axis, wall)
            return np.linalg.norm(point - tx) + np.linalg.norm(rx - point)

        return minimize(length, np.delete((tx + rx) / 2, axis), tol=1e-12).fun

    expected = [shortest(axis, side * SIZE_M[axis]) for axis, side in itertools.product(range(3), range(2))]
    np.testing.assert_allclose(found_m, np.sort([*expected, np.linalg.norm(rx - tx)]), rtol=1e-7)
    direct = link.gain[0, np.argmin(link.delay_s[0])]
    assert abs(direct) == pytest.approx(C_M_PER_S / spec.carrier_hz / (4 * np.pi * found_m[0]))  # Friis


def test_every_side_reflects_as_its_own_material(arena):
    spec, solids = arena
    nodes = {node.name: node for node in spec.nodes}
    tx, rx = (position_m(nodes[name], np.zeros(1))[0] for name in ("c12", "s5"))
    link = room.link_paths(spec, solids, nodes["c12"], nodes["s5"], np.zeros(1), 1)
    for axis, wall, material in ((0, 0.0, "plasterboard"), (0, 19.0, "brick"), (2, 0.0, "concrete")):
        image = tx.copy()
        image[axis] = 2 * wall - tx[axis]
        length_m = np.linalg.norm(rx - image)
        path = np.argmin(np.abs(link.delay_s[0] * C_M_PER_S - length_m))
        eta = Medium(material=material).complex_permittivity(spec.carrier_hz)
        cosine = abs(rx[axis] - image[axis]) / length_m
        # Snell: what is transmitted goes on at the angle whose sine is the other's over the square root of eta.
        beyond = np.sqrt(1 - (1 - cosine**2) / eta)
        n = np.sqrt(eta)
        te, tm = (cosine - n * beyond) / (cosine + n * beyond), (n * cosine - beyond) / (n * cosine + beyond)
        expected = (tm if axis == 2 else te) * C_M_PER_S / spec.carrier_hz / (4 * np.pi * length_m)
        assert link.gain[0, path] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("order", "count"), [(0, 1), (1, 7), (2, 25), (3, 63)])
def test_the_way_back_is_the_same_and_every_image_is_there_once(arena, order, count):
    spec, solids = arena
    nodes = {node.name: node for node in spec.nodes}
    there = room.link_paths(spec, solids, nodes["c10"], nodes["s6"], np.zeros(1), order)
    back = room.link_paths(spec, solids, nodes["s6"], nodes["c10"], np.zeros(1), order)
    assert there.delay_s.shape == (1, count)
    for name in ("delay_s", "gain"):
        values = [np.sort(np.abs(getattr(link, name)[0])) for link in (there, back)]
        np.testing.assert_allclose(*values, rtol=1e-12)
    assert (np.abs(there.gain[0]) <= C_M_PER_S / spec.carrier_hz / (4 * np.pi * C_M_PER_S * there.delay_s[0]) + 1e-15).all()


def test_rates_are_the_derivatives_of_the_delays(arena):
    spec, solids = arena
    nodes = {node.name: node for node in spec.nodes}
    at_s, hair_s = 4.0, 1e-4
    link = room.link_paths(spec, solids, nodes["c12"], nodes["m1"], np.array([at_s - hair_s, at_s, at_s + hair_s]), 2)
    numeric = (link.delay_s[2] - link.delay_s[0]) / (2 * hair_s)
    np.testing.assert_allclose(link.rate_after[1], numeric, rtol=1e-4, atol=1e-14)


def test_reflections_at_the_limits():
    normal, grazing = np.array([1.0]), np.array([1e-6])
    te, tm = room.fresnel(5.24 - 0.6j, normal)
    assert te == pytest.approx(-tm)
    assert abs(room.fresnel(5.24, grazing)[0][0]) == pytest.approx(1, abs=1e-5)
    brewster = np.array([1 / np.sqrt(1 + 5.24)])
    assert abs(room.fresnel(5.24, brewster)[1][0]) < 1e-12
    te, tm = room.fresnel(Medium(material="metal").complex_permittivity(2.4e9), np.array([0.5]))
    assert (abs(te[0]), abs(tm[0])) == pytest.approx((1, 1), abs=1e-3)


def test_a_walker_turns_round_at_both_ends():
    node = Node(name="m", waypoints_m=[[0, 0, 1], [3, 0, 1]], speed_m_per_s=1.0)
    x_m = position_m(room.walking_on(node, 10.0), np.arange(11.0))[:, 0]
    np.testing.assert_allclose(x_m, [0, 1, 2, 3, 2, 1, 0, 1, 2, 3, 2])


def test_four_taps_keep_the_power_of_all_paths(arena):
    spec, _ = arena
    short = replace(spec, update_s=0.01)
    every, four = (room.scenario(short, [("c12", "s2"), ("c12", "m1")], 1.0, four_taps=four) for four in (False, True))
    assert four.links["c12", "m1"].gain.shape[1] == 4
    for key in every.links:
        powers_db = [sc.tap_power_db(scenario, key).mean() for scenario in (every, four)]
        assert abs(powers_db[0] - powers_db[1]) < 3.0
