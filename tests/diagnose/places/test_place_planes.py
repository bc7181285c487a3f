# SPDX-License-Identifier: GPL-3.0-or-later
"""Planes that nobody drew, by the phases of their echoes, in bands too narrow for delays; sums against echoes written out."""

from dataclasses import replace

import numpy as np
import pytest
from gr_cast.diagnose.places import planes
from gr_cast.diagnose.places.coherent import Phased
from gr_cast.diagnose.places.ears import ResponseEar
from gr_cast.diagnose.places.fit import evaluated, with_effect
from gr_cast.diagnose.places.likelihood import Fitted, Heard
from gr_cast.diagnose.places.view import View
from gr_cast.twin.places.predict import Predictor

from tests.diagnose.places.test_place_bodies import BY_NAME, CARRIER_HZ, KNOWN, QUAD, best_of, heard, ours, theirs

LIGHT = 299792458.0
ROOF_M = 4.217
LEVEL, UPRIGHT = np.array([0.0, 0.0, 1.0]), np.array([-np.sin(np.arctan2(1, 18)), np.cos(np.arctan2(1, 18)), 0.0])
ROOF = np.array([(-15, -15, ROOF_M), (15, -15, ROOF_M), (15, 15, ROOF_M), (-15, 15, ROOF_M)])
FENCE = np.array([(-13, -9.5, 0), (14, -8, 0), (14, -8, 5), (-13, -9.5, 5)], float)  # as the wall stands


@pytest.mark.parametrize(("corners_m", "normal"), [(ROOF, LEVEL), (FENCE, UPRIGHT)])
def test_a_plane_that_stands_as_others_do_is_found_by_phase_where_delays_tell_nothing(corners_m, normal):
    world = theirs(bandwidth_hz=4e6)
    world["objects"]["hidden"] = {"tris": corners_m[QUAD], "surface": None}
    world["materials"]["hidden"] = "concrete"
    ears = heard(world, 30.0, band_hz=4e6)  # a cell of delay is 75 m
    best = View(ears, evaluated(ears, ours(), ()), KNOWN).sheets()[0]
    apart_m = (corners_m - np.array(best.origin_m)) @ normal
    assert abs(np.array(best.normal) @ normal) > 0.9999
    assert np.abs(apart_m).max() < LIGHT / CARRIER_HZ


def test_a_plane_is_fitted_to_the_noise_in_the_well_of_its_phases_and_as_far_as_it_goes():
    world = theirs(bandwidth_hz=4e6)
    world["objects"]["hidden"] = {"tris": ROOF[QUAD], "surface": None}
    world["materials"]["hidden"] = "plasterboard"
    ears = heard(world, 30.0, band_hz=4e6)
    found = best_of("missing_object", ears)
    assert found.energy - ears[0].count < 4 * np.sqrt(ears[0].count)
    assert found.world.mesh.solids[-1].vertices_m[:, 2] == pytest.approx([ROOF_M] * 4, abs=0.003)


def test_a_plane_is_begun_in_phase_though_its_ends_and_the_phases_of_all_soundings_are_unknown():
    face = np.array([(-3, -9.0, 0), (2, -9.0 + 5 / 18, 0), (2, -9.0 + 5 / 18, 2), (-3, -9.0, 2)], float)
    world = theirs()
    world["objects"]["hidden"] = {"tris": face[QUAD], "surface": None}
    world["materials"]["hidden"] = "metal"
    unknown = {"phase": "snapshot", "delay": "link", "gain": "none"}
    ears = heard(world, 30.0, **unknown)
    view = View(ears, evaluated(ears, ours(), ()), KNOWN | unknown)
    begun = [with_effect(ears, view.model, one) for one in BY_NAME["missing_object"].starts(view, "place")]
    best = min(begun, key=lambda one: one.energy)
    seen = best.world.mesh.solids[-1].vertices_m
    assert np.abs((seen - face[0]) @ UPRIGHT).max() < LIGHT / CARRIER_HZ / 10
    assert best.energy - ears[0].count < 0.1 * (view.model.energy - ears[0].count)


def rows(random) -> tuple:
    """Two links, one of which moves, that hear noise."""
    world = ours()
    links = [("n0", "n2"), ("n1", "n3")]
    time_s, f_hz = np.linspace(0, 3, 5), np.linspace(-3e6, 3e6, 16)
    shape = len(links), len(time_s), len(f_hz)
    y = random.normal(size=shape) + 1j * random.normal(size=shape)
    factor = np.exp(1j * random.normal(size=shape)) * np.exp(0.2 * random.normal(size=shape))
    told = Heard(links=tuple(links), y=y, weight=random.uniform(1, 2, shape), frequency_hz=f_hz, **KNOWN)
    ear = ResponseEar(Predictor(*zip(*links, strict=True), time_s, f_hz), told)
    return ear, Fitted(model=np.zeros(shape, complex), residual=y, energy=0.0, factor=factor), world


def test_nats_of_a_plane_are_those_of_least_squares_written_out():
    ear, fit, world = rows(np.random.default_rng(4))
    phased = Phased.of(ear, fit, world)
    level_m, f_hz = -3.0, ear.heard.frequency_hz
    columns, y = [], []
    for index in range(2):
        tx_m, rx_m = ear.predictor.ends_m(world, index)
        for step in range(5):
            image_m = rx_m[step] * [1, 1, -1] + [0, 0, 2 * level_m]
            out = image_m - tx_m[step]
            length_m = np.linalg.norm(out)
            across = np.cross(out, LEVEL) / np.linalg.norm(np.cross(out, LEVEL))
            sin = np.hypot(*out[:2]) / length_m  # a short dipole's field along its theta, upright: across it sends nothing
            grid = np.round(length_m / LIGHT * phased.bins_per_s) / phased.bins_per_s
            phase = np.exp(-2j * np.pi * ((CARRIER_HZ + f_hz[0]) * length_m / LIGHT + (f_hz - f_hz[0]) * grid))
            echo = 1 / (4 * np.pi * length_m) * LIGHT / CARRIER_HZ * phase * fit.factor[index, step]
            root = np.sqrt(ear.heard.weight[index, step])
            assert abs(across[2]) < 1e-12
            columns.append(echo * sin**2 * root)
            y.append(fit.residual[index, step] * root)
    column, y = np.concatenate(columns), np.concatenate(y)
    wanted = np.abs(np.vdot(column, y)) ** 2 / np.vdot(column, column).real
    assert phased.nats(LEVEL[None], np.array([level_m]))[0] == pytest.approx(wanted, rel=1e-4)


def test_along_a_normal_nats_are_those_of_each_level():
    ear, fit, world = rows(np.random.default_rng(5))
    phased, levels_m = Phased.of(ear, fit, world), np.arange(-9.0, -8.0, 0.004)
    each = phased.nats(np.repeat(LEVEL[None], len(levels_m), axis=0), levels_m)
    assert phased.nats_along(LEVEL, levels_m) == pytest.approx(each, rel=0.01, abs=0.02)


def test_a_plane_that_one_still_link_alone_sees_is_found():
    plate = np.array([(-2.95, -6.6, 4.0), (-2.25, -6.6, 4.0), (-2.25, -5.9, 4.0), (-2.95, -5.9, 4.0)])
    world = theirs()
    world["objects"]["plate"] = {"tris": plate[QUAD], "surface": None}
    world["materials"]["plate"] = "metal"
    ears = heard(world, 30.0, phase="snapshot")
    before, count = evaluated(ears, ours(), ()).energy, ears[0].count
    assert before - count > 500
    assert best_of("missing_object", ears).energy - count < 0.1 * (before - count)


def test_an_echo_from_beyond_the_limits_of_a_place_is_no_candidate():
    """As where frequencies are in MHz for Hz, which makes every delay a million times as long: here 2 ms, and 600 km."""
    (ear,) = heard(theirs(), 30.0, band_hz=80.0)
    f_hz, y = ear.heard.frequency_hz, ear.heard.y.copy()
    y[0] += 3 * np.abs(y).max() * np.exp(-2j * np.pi * f_hz * 2e-3)
    echo = replace(ear, heard=replace(ear.heard, y=y))
    view = View([echo], evaluated([echo], ours(), ()), KNOWN)
    assert planes.lone(view)[1] == []
    assert BY_NAME["missing_object"].starts(view, "place")
