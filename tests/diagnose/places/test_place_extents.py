# SPDX-License-Identifier: GPL-3.0-or-later
"""Where added planes end, walls that close a room, one more of what stands there: told apart by one trace, and by the vault."""

from dataclasses import replace

import numpy as np
import pytest
from gr_cast.diagnose.places import elsewhere, extents, foretold, search
from gr_cast.diagnose.places.fit import applied, evaluated, fitted
from gr_cast.diagnose.places.view import View
from gr_cast.scenario.create.fields import surface_of
from gr_cast.scenario.create.geometry import Solid
from gr_cast.scenario.create.media import Medium
from gr_cast.twin.places.families.additions import MissingObject, Sheet
from gr_cast.twin.places.families.base import Effect
from gr_cast.twin.places.families.objects import ObjectMoved, usual_at
from gr_cast.twin.places.world import Mesh

from tests.diagnose.places import test_place_search as room
from tests.diagnose.places.test_place_bodies import (
    BY_NAME,
    CARRIER_HZ,
    KNOWN,
    POSTS,
    QUAD,
    SIDES,
    heard,
    of,
    ours,
    shed,
    theirs,
    walking,
)

FENCE = np.array([(-9.0, -7.0, 0.3), (6.5, -7.0, 0.3), (6.5, -7.0, 2.6), (-9.0, -7.0, 2.6)])
STONE = (5.2, 0.1)


def sheet(low_m, high_m) -> Sheet:
    """On the fence's plane, in steps from its middle."""
    return Sheet(
        origin_m=(-1.25, -7.0, 1.45), normal=(0.0, 1.0, 0.0), u=(-1.0, 0.0, 0.0), v=(0.0, 0.0, 1.0), low_m=low_m, high_m=high_m
    )


def added(choice: Sheet, made=STONE) -> Effect:
    return Effect(family=MissingObject(), owner="place", values=np.array([0.0, 0.0, *np.log(made)]), choice=choice)


def fenced() -> list:
    world = theirs(max_depth=2)
    world["objects"]["fence"], world["materials"]["fence"] = {"tris": FENCE[QUAD], "surface": None}, "concrete"
    return heard(world, 30.0)


@pytest.mark.parametrize("is_clear", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_paths_beside_an_endless_plane_are_those_of_a_tracer_wherever_it_ends(is_clear, seed):
    random, base = np.random.default_rng(seed), replace(ours(), max_depth=2)
    base = base.with_surface(slice(None), clear=is_clear)
    (ear,), wide = heard(theirs(), 30.0), sheet((-30.0, -20.0), (30.0, 20.0))
    effect = added(sheet((-3.0, -1.0), (4.0, 1.0)))
    here, endless = (applied(base, [one]) for one in (effect, replace(effect, choice=wide)))
    beside = extents._heard_beside(ear, here, endless, endless.mesh.index("missing_1"), effect)
    low_m = random.uniform(-9, 3, 2) * [1, 0.2]
    high_m = low_m + random.uniform(0.5, 12, 2) * [1, 0.3]
    told = ear.predicted(applied(base, [added(sheet(tuple(low_m), tuple(high_m)))]))
    crossed = np.count_nonzero(~np.isnan(beside.crossed_m[..., 0]).all(axis=1))
    assert crossed > 10 and np.count_nonzero(~np.isnan(beside.met_m[..., 0]).all(axis=1)) > 10
    assert np.abs(beside.response(low_m, high_m) - told).max() < 1e-9 * np.abs(told).max()


def test_a_plane_ends_where_it_explains_most_wherever_it_was_begun():
    ears, base = fenced(), replace(ours(), max_depth=2)
    view = View(ears, evaluated(ears, base, ()), KNOWN)
    true = evaluated(ears, base, [added(sheet((-7.75, -1.15), (7.75, 1.15)))])
    for low_m, high_m in (((-40.0, -2.0), (40.0, 9.0)), ((-1.0, -0.5), (0.2, 0.4)), ((9.0, 2.0), (12.0, 4.0))):
        begun = added(sheet(low_m, high_m))
        model = evaluated(ears, base, [begun])
        found = evaluated(ears, base, [begun.family.ended(View(ears, model, KNOWN), begun)])
        assert found.energy < true.energy + 1.0 < model.energy
        assert view.ended(begun).choice != begun.choice  # on thinned soundings, beside the model's own effects


def test_a_plane_that_explains_alike_ends_as_it_did():
    ears, base = fenced(), replace(ours(), max_depth=2)
    true = added(sheet((-7.75, -1.15), (7.75, 1.15)))
    assert true.family.ended(View(ears, evaluated(ears, base, [true]), KNOWN), true).choice == true.choice


def test_a_wall_that_closes_a_room_is_begun_between_corners_of_the_others():
    world = room.theirs()
    ears, base = room.heard(world, 30.0), room.ours()
    open_ = [solid for solid in base.mesh.solids if solid.name != "west"]
    media = {solid.name: base.media[solid.name] for solid in open_}
    mesh = Mesh.of(tuple(open_), np.array([track[0] for track, _, _ in room.SPEC.values()]))
    base = replace(base, mesh=mesh, media=media, surface=surface_of([*media.values()], room.CARRIER_HZ))
    view = View(ears, evaluated(ears, base, ()), room.UNKNOWN)
    west = np.array(room.WALLS["west"][0], float)
    walls = [one for one in view.gaps() if np.abs(np.sort(one.corners_m(), axis=0) - np.sort(west, axis=0)).max() < 1e-9]
    assert len(walls) == 1
    assert any(one.choice == walls[0] for one in BY_NAME["missing_object"].starts(view, "place"))


def test_usual_materials_are_known_at_any_carrier():
    for carrier_hz in (4e8, 2.4e9, 3e11):
        made = usual_at(carrier_hz)
        assert len(made) == 3 and all(permittivity >= 1 and conductivity > 0 for permittivity, conductivity in made)


def with_shed(world):
    """Our yard with the shed in it."""
    media = world.media | {"shed": Medium(material="metal", thickness_m=0.02)}
    mesh = Mesh.of((*world.mesh.solids, Solid(name="shed", vertices_m=shed(), faces=SIDES)), np.array(POSTS))
    return replace(world, mesh=mesh, media=media, surface=surface_of([media[name] for name in mesh.names], CARRIER_HZ))


def test_one_more_like_what_stands_there_is_found_in_its_row():
    turn = np.array([np.cos(0.5), np.sin(0.5), 0.0])
    world = theirs()
    for name, corners in (("shed", shed()), ("twin", shed() + 3.75 * turn)):
        world["objects"][name], world["materials"][name] = {"tris": corners[SIDES], "surface": None}, "metal"
    ears, base = heard(world, 30.0), with_shed(ours())
    rest = evaluated(ears, base, ())
    best, *_ = elsewhere.copies(ears, rest, search.Budget.of(60.0))
    model = fitted(ears, evaluated(ears, base, [best]))
    corners_m = model.world.mesh.solids[-1].vertices_m
    assert np.abs(corners_m.mean(axis=0) - (shed() + 3.75 * turn).mean(axis=0)).max() < 0.03
    assert model.left_nats(ears[0].count) < 4 * ears[0].count ** 0.5 < 0.01 * rest.left_nats(ears[0].count)


def test_what_stands_still_all_the_time_does_not_pass_by():
    walk = walking([1.3, -0.4], [0.0, 0.0], radius_m=0.4, rcs_m2=0.5), walking([-1.5, -0.8], [1.2, 0.3], radius_m=0.4, rcs_m2=0.5)
    for person, goes in zip(walk, (False, True), strict=True):
        ears = heard(theirs(person=person), 30.0)
        begun = np.array([*person["position_m"][:2], *person["velocity_m_per_s"][:2], np.log(0.5), 1.8])
        effect = Effect(family=BY_NAME["moving_scatterer"], owner="place", values=begun, choice=(0.4, False))
        model = fitted(ears, evaluated(ears, ours(), [effect]))
        assert search._stands_out(ears, model, ears[0].count, 50) == goes


def test_what_a_field_takes_for_its_own_is_refused_by_the_vault():
    ears = heard(theirs(), 30.0)
    wrong = of("node_position", "n4", 0.0003, -0.0003, 0.0)
    field = Effect(family=BY_NAME["missing_scattering"], owner="place", values=np.zeros(0), choice=0.6)
    model = evaluated(ears, ours(), [wrong, field])
    assert 0 not in foretold._refused(ears, model) and 0 in foretold.refused(ears, model)


def test_numbers_that_only_the_vault_would_tell_foretell_nothing():
    """A fence that no fitted link sees may stand in any phase: that one of them suits the vault's noise is no proof."""
    whole = heard(theirs(), 30.0)
    weight = np.where(np.arange(len(whole[0].heard.links))[:, None, None] < 1, whole[0].heard.weight, 0.0)
    ears = [replace(whole[0], heard=replace(whole[0].heard, weight=weight))]
    unlit = added(sheet((-0.4, -0.2), (0.4, 0.2)), (1.05, 1e-3))  # n1 > n3 and others see it, faintly
    plain, more = (evaluated(ears, ours(), effects) for effects in ((), (unlit,)))
    assert more.energy == pytest.approx(plain.energy)
    assert foretold.foreseen(ears, whole, more) > foretold.foreseen(ears, whole, plain)


def test_a_dark_thing_has_no_numbers_and_a_wall_has_its_four():
    dark, wall = (added(sheet((-1.0, -1.0), (1.0, 1.0)), made) for made in ((1.0, 1e-5), STONE))
    assert [one.family.told_numbers(one) for one in (dark, wall)] == [0, 4]


def test_a_box_whose_sides_nobody_lights_may_stand_beside_itself():
    box = added(replace(sheet((-1.0, -1.0), (1.0, 1.0)), depth_m=0.7))
    steps_m = [np.array(one.choice.origin_m) - box.choice.origin_m for one in box.family.beside(ours(), box)]
    assert np.ptp(steps_m, axis=0) == pytest.approx([ours().wavelength_m, ours().wavelength_m, 0.0])  # along u, and its normal
    assert box.family.beside(ours(), added(sheet((-1.0, -1.0), (1.0, 1.0)))) == []


def test_a_moved_thing_and_a_new_one_at_its_place_are_one_more_like_it(monkeypatch):
    """What came close to the first effect, and is of the same family and owner as the second, may take the place of both."""
    base = with_shed(ours())
    shape = Sheet.about(shed(), np.array([np.cos(0.5), np.sin(0.5), 0.0]), 0.02)
    turn = np.array([np.cos(0.5), np.sin(0.5), 0.0])
    copy = added(replace(shape, origin_m=tuple(shape.origin_m + 3.75 * turn)), (1.0, 1e7))
    ears = heard(theirs(), 30.0)
    ears = [replace(ears[0], heard=replace(ears[0].heard, y=ears[0].predicted(applied(base, [copy]))))]
    moved = Effect(family=ObjectMoved(), owner="shed", values=np.array([3.75]), choice=tuple(turn))
    both = evaluated(ears, base, [moved, added(shape, (1.0, 1e7))])
    assert both.left_nats(ears[0].count) < 0
    model = search._asked_again(ears, both, ears[0].count, 50, {moved.key: [copy]}, search.Budget.of(60.0))
    assert [one.family.name for one in model.effects] == ["missing_object"]
    assert np.abs(np.array(model.effects[0].choice.origin_m) - copy.choice.origin_m).max() < 1e-9
