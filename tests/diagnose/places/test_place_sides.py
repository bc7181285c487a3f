# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes whose shadow leaves their outline open, and whose sides' few echoes do not; what a side sends against the tracer's."""

from dataclasses import replace

import numpy as np
import pytest
from gr_cast.diagnose.places import sides
from gr_cast.diagnose.places.coherent import Phased
from gr_cast.diagnose.places.fit import evaluated, fitted, with_effect
from gr_cast.diagnose.places.shades import Ways
from gr_cast.diagnose.places.view import View
from gr_cast.twin.places.families.additions import Sheet
from gr_cast.twin.places.families.base import Effect

from tests.diagnose.places.test_place_bodies import BY_NAME, KNOWN, SIDES, heard, ours, theirs


def box(centre_m, turn_rad: float, size_m) -> np.ndarray:
    """Corners (8, 3) of a box on the ground."""
    ring = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * np.array(size_m[:2]) / 2
    turn = np.array([[np.cos(turn_rad), -np.sin(turn_rad)], [np.sin(turn_rad), np.cos(turn_rad)]])
    ring = ring @ turn.T + centre_m
    return np.array([[x, y, z] for z in (-0.05, size_m[2]) for x, y in ring])


def begun(sheet: Sheet, made) -> Effect:
    return Effect(family=BY_NAME["missing_object"], owner="place", values=np.array([0.0, 0.0, *np.log(made)]), choice=sheet)


@pytest.mark.parametrize("made", [(1.0, 1e7), (2.2, 0.001), (4.4, 0.07)])
def test_what_a_side_explains_is_what_the_tracer_has_of_it(made):
    face = np.array([(-3, -9.0, -0.5), (4, -8.0, -0.5), (4, -8.0, 6), (-3, -9.0, 6)])
    u = (face[1] - face[0]) / np.linalg.norm(face[1] - face[0])
    sheet = Sheet(
        origin_m=tuple(face[0]), normal=(-u[1], u[0], 0.0), u=tuple(u), v=(0.0, 0.0, 1.0), low_m=(0.0, 0.0), high_m=(7.0711, 6.5)
    )  # fmt: skip
    ears = heard(theirs(), 60.0)
    before = evaluated(ears, ours(), ())
    there = with_effect(ears, before, begun(sheet, made))
    ears[0].heard.y[:] += there.fits[0].model - before.fits[0].model
    rows = Phased.of(ears[0], evaluated(ears, ours(), ()).fits[0], before.world)
    plane = np.array([sheet.normal]), np.array([np.array(sheet.normal) @ face[0]])
    met = (rows.met_m(*plane)[:, 0] - face[0]) @ np.array([sheet.u, sheet.v]).T
    lit = ((met > 0) & (met < np.array(sheet.high_m))).all(axis=1)
    nats = np.abs(there.fits[0].model - before.fits[0].model) ** 2 * ears[0].heard.weight
    assert lit.sum() > 5
    assert rows.made_nats(*plane, [made], 0.1)[0, lit, 0].sum() == pytest.approx(nats.sum(), rel=0.03)


@pytest.mark.parametrize(
    ("centre_m", "turn_rad", "size_m", "material", "phase"),
    [
        ((0.0, 2.68), 0.35, (3.85, 1.35, 2.46), "metal", "snapshot"),
        ((1.3, -0.4), 0.5, (3.4, 1.7, 3.1), "concrete", "none"),
        ((1.86, 1.0), 1.1, (1.6, 2.5, 2.0), "brick", "none"),
    ],
)
def test_a_box_has_its_sides_where_few_echoes_have_them(centre_m, turn_rad, size_m, material, phase):
    world = theirs()
    world["objects"]["shed"] = {"tris": box(centre_m, turn_rad, size_m)[SIDES], "surface": None}
    world["materials"]["shed"] = material
    unknown = KNOWN | {"phase": phase}
    ears = heard(world, 30.0, **unknown)
    view = View(ears, evaluated(ears, ours(), ()), unknown)
    dark = begun(view.shades()[0], (1.0, 1e-5))
    shaded = with_effect(ears, view.model, dark)
    found = min(
        (fitted(ears, with_effect(ears, view.model, begun(*one)), rounds=4) for one in view.sided(dark)),
        key=lambda one: one.energy,
    )
    assert found.energy - ears[0].count < 0.25 * (shaded.energy - ears[0].count)
    front = found.effects[-1].choice.normal_at(found.effects[-1].values[1])
    turned = np.degrees(np.arctan2(front[1], front[0]) - turn_rad) % 90
    assert min(turned, 90 - turned) < 5


def test_a_box_lower_than_the_antennas_is_told_by_the_echo_of_its_top():
    world = theirs()
    world["objects"]["bench"] = {"tris": box((-1.3, -1.4), 0.3, (2.4, 2.7, 1.1))[SIDES], "surface": None}
    world["materials"]["bench"] = "metal"
    ears = heard(world, 30.0)
    view = View(ears, evaluated(ears, ours(), ()), KNOWN)
    dark = begun(view.shades()[0], (1.0, 1e-5))
    shaded, count = with_effect(ears, view.model, dark), ears[0].count
    fits = [fitted(ears, with_effect(ears, view.model, begun(*one)), rounds=4) for one in view.sided(dark)]
    assert min(one.energy for one in fits) - count < 0.25 * (shaded.energy - count)


def test_what_sides_send_is_the_same_whatever_was_asked_before():
    world = theirs()
    world["objects"]["shed"] = {"tris": box((0.0, 2.68), 0.35, (3.85, 1.35, 2.46))[SIDES], "surface": None}
    world["materials"]["shed"] = "metal"
    ears = heard(world, 30.0)
    view = View(ears, evaluated(ears, ours(), ()), KNOWN)
    normal = np.array([np.cos(0.4), np.sin(0.4), 0.0])
    known, random = sides._Outline(rows=view.phased, ways=Ways.of(view), normal=normal, level_m=1.2), np.random.default_rng(3)
    for _ in range(6):
        ends = random.choice([-2.0, -1.0, 0.5, 1.5], (20, 5)) + [0.0, 3.0, 2.5, 2.5, 0.0]
        afresh = replace(known, known={})
        np.testing.assert_allclose(known.nats(ends), afresh.nats(ends), rtol=1e-12)
    assert known.known
