# SPDX-License-Identifier: GPL-3.0-or-later
"""Where added planes end, walls that close a room, one more of what stands there: told apart by one trace, and by the vault."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast.diagnose.places import elsewhere, extents, foretold, open_wells, rounds, search, settling
from gr_cast.diagnose.places.budget import Budget
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


def backed(is_clear: bool):
    """Our yard with a wall behind the fence: what it sends crosses the fence twice."""
    base = replace(ours(), max_depth=2)
    corners_m = np.array([(-14.0, -8.6, 0.0), (12.0, -8.6, 0.0), (12.0, -8.6, 4.0), (-14.0, -8.6, 4.0)])
    base = base.with_object(Solid(name="missing_1", vertices_m=corners_m, faces=QUAD), permittivity=1.0, conductivity=1e7)
    return base.with_surface(slice(None), clear=is_clear)


@pytest.mark.parametrize("is_clear", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_paths_beside_an_endless_plane_are_those_of_a_tracer_wherever_it_ends(is_clear, seed):
    random, base = np.random.default_rng(seed), backed(is_clear)
    (ear,), wide = heard(theirs(), 30.0), sheet((-30.0, -20.0), (30.0, 20.0))
    effect = added(sheet((-3.0, -1.0), (4.0, 1.0)))
    here, endless = (applied(base, [one]) for one in (effect, replace(effect, choice=wide)))
    beside = extents._heard_beside(ear, here, endless, endless.mesh.index("missing_2"), effect)
    low_m = random.uniform(-9, 3, 2) * [1, 0.2]
    high_m = low_m + random.uniform(0.5, 12, 2) * [1, 0.3]
    told = ear.predicted(applied(base, [added(sheet(tuple(low_m), tuple(high_m)))]))
    crossed = np.count_nonzero(~np.isnan(beside.crossed_m[..., 0]).all(axis=1))
    assert crossed > 10 and np.count_nonzero(~np.isnan(beside.met_m[..., 0]).all(axis=1)) > 10
    assert np.count_nonzero((~np.isnan(beside.crossed_m[..., 0])).sum(axis=1) > 1) > 10
    least = 2e-4 if is_clear else 1e-9  # of two slabs in a row, the first turns what the second one meets
    assert np.abs(beside.response(low_m, high_m) - told).max() < least * np.abs(told).max()


def test_a_plane_ends_where_it_explains_most_wherever_it_was_begun():
    ears, base = fenced(), replace(ours(), max_depth=2)
    view = View(ears, evaluated(ears, base, ()), KNOWN)
    true = evaluated(ears, base, [added(sheet((-7.75, -1.15), (7.75, 1.15)))])
    for low_m, high_m in (((-40.0, -2.0), (40.0, 9.0)), ((-1.0, -0.5), (0.2, 0.4)), ((9.0, 2.0), (12.0, 4.0))):
        begun = added(sheet(low_m, high_m))
        model = evaluated(ears, base, [begun])
        found = evaluated(ears, base, [begun.family.ended(View(ears, model, KNOWN), begun)])
        assert found.energy < true.energy + 1.0 < model.energy
        assert evaluated(ears, base, [view.ended(begun)]).energy < model.energy  # on thinned soundings


def test_of_several_planes_each_has_its_own_ends():
    """One stands in the twin under the name of one that is added, one was found before, by another way."""
    base = backed(False)
    roof = added(replace(sheet((-3.0, -3.0), (3.0, 3.0)), origin_m=(0.0, 0.0, 3.6), normal=(0.0, 0.0, 1.0), v=(0.0, -1.0, 0.0)))
    roof = replace(roof, family=MissingObject())  # no instance of the engine's
    (ear,) = heard(theirs(), 30.0)
    fence = added(sheet((-7.75, -1.15), (7.75, 1.15)))
    told = replace(ear.heard, y=ear.predicted(applied(base, [roof, fence])))
    ears = [replace(ear, heard=told)]
    for number, far in enumerate((roof, fence)):
        begun = replace(far, choice=replace(far.choice, low_m=(-0.8, -0.9), high_m=(0.9, 1.1)))
        effects = [begun, fence] if number == 0 else [roof, begun]
        model = evaluated(ears, base, effects)
        found = begun.family.ended(View(ears, model, KNOWN), begun)
        effects[number] = found
        assert evaluated(ears, base, effects).energy < 1e-3 * model.energy


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
    best, *_ = elsewhere.copies(ears, rest, Budget.of(60.0))
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
        assert rounds._stands_out(ears, model, ears[0].count, 50) == goes


def test_what_a_field_takes_for_its_own_is_refused_by_the_vault():
    ears = heard(theirs(), 30.0)
    wrong = of("node_position", "n4", 0.0003, -0.0003, 0.0)
    field = Effect(family=BY_NAME["missing_scattering"], owner="place", values=np.zeros(0), choice=0.6)
    model = evaluated(ears, ours(), [wrong, field])
    assert 0 not in foretold._refused(ears, model) and 0 in foretold.refused(ears, model)


@pytest.mark.parametrize(
    ("explains", "shown", "goes"), [(150.0, -2.0, [0]), (150.0, 0.0, []), (150.0, 30.0, []), (400.0, -2.0, [])]
)
def test_a_hundredth_beside_a_field_wants_to_be_shown_by_the_vault(explains, shown, goes, monkeypatch):
    field = Effect(family=BY_NAME["missing_scattering"], owner="place", values=np.zeros(0), choice=0.6)
    model = SimpleNamespace(effects=(of("node_gain", "n4", 1.0), field), energy=1e3, fits=(SimpleNamespace(energy=21e3),))
    monkeypatch.setattr(search, "without_effects", lambda *rest: SimpleNamespace(energy=1e3 + explains))
    monkeypatch.setattr(foretold, "told_nats", lambda *rest: [shown, 500.0])
    assert search._unshown((), [SimpleNamespace(has_responses=True)], model) == goes


def test_a_list_that_tells_nothing_of_what_the_vault_shows_is_not_all_there_is():
    """A fence that is faint in the vault: no more than half of its noise, and still many deviations of it."""
    ears, vault = heard(theirs(max_depth=2), 30.0), fenced()
    faint = np.sqrt(0.1 * vault[0].count / evaluated(vault, replace(ours(), max_depth=2), ()).left_nats(vault[0].count))
    told = vault[0].heard
    vault = [replace(vault[0], heard=replace(told, y=ears[0].heard.y + faint * (told.y - ears[0].heard.y)))]
    plain = evaluated(ears, replace(ours(), max_depth=2), ())
    assert plain.left_nats(ears[0].count) < 4 * ears[0].count ** 0.5
    left = evaluated(vault, plain.base, ()).left_nats(vault[0].count)
    assert 4 * vault[0].count ** 0.5 < left < 0.5 * vault[0].count
    assert foretold.holds(View(ears, plain, KNOWN), ears)
    assert not foretold.holds(View(ears, plain, KNOWN), vault)


def test_numbers_that_only_the_vault_would_tell_foretell_nothing():
    """A fence that no fitted link sees may stand in any phase: that one of them suits the vault's noise is no proof."""
    whole = heard(theirs(), 30.0)
    weight = np.where(np.arange(len(whole[0].heard.links))[:, None, None] < 1, whole[0].heard.weight, 0.0)
    ears = [replace(whole[0], heard=replace(whole[0].heard, weight=weight))]
    unlit = added(sheet((-0.4, -0.2), (0.4, 0.2)), (1.05, 1e-3))  # n1 > n3 and others see it, faintly
    plain, more = (evaluated(ears, ours(), effects) for effects in ((), (unlit,)))
    assert more.energy == pytest.approx(plain.energy)
    assert foretold.foreseen(ears, whole, more) > foretold.foreseen(ears, whole, plain)


def test_what_no_sounding_tells_of_a_number_costs_nothing():
    dark = added(sheet((-2.0, -1.0), (2.0, 1.0)), (1.0, 1e-5))
    ears = heard(theirs(), 30.0)
    model = evaluated(ears, ours(), [dark])
    assert model.energy > ears[0].count * 1.5  # it stands in the way
    assert foretold.foreseen(ears, ears, model) == pytest.approx(model.energy, abs=2.0)


def test_the_walls_that_explain_most_are_begun_first(monkeypatch):
    sheets = [sheet((-k - 1.0, -1.0), (k + 1.0, 1.0)) for k in range(5)]
    ears = fenced()
    view = View(ears, evaluated(ears, replace(ours(), max_depth=2), ()), KNOWN)
    ranks = [0, 1, 2, 3, 1, 2, 3, 3, 0, 4]
    monkeypatch.setattr(View, "gaps", lambda self: sheets)
    monkeypatch.setattr(
        View, "row_by_row", lambda self, starts: [added(sheets[k]) for k in ranks] if len(starts) == 15 else starts
    )
    starts = BY_NAME["missing_object"].starts(view, "place")
    assert [one.choice for one in starts[:3]] == sheets[:3]


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
    model = search._asked_again(ears, both, ears[0].count, 50, {moved.key: [copy]}, Budget.of(60.0), rounds.Barred())
    assert [one.family.name for one in model.effects] == ["missing_object"]
    assert np.abs(np.array(model.effects[0].choice.origin_m) - copy.choice.origin_m).max() < 1e-9


def test_a_box_stands_where_the_vault_has_it_as_far_as_the_soundings_leave_it_open():
    """No fitted link is heard here: of all places beside the box the vault has a say alone."""
    world = theirs()
    world["objects"]["shed"], world["materials"]["shed"] = {"tris": shed()[SIDES], "surface": None}, "metal"
    vault, turn = heard(world, 30.0), np.array([np.cos(0.5), np.sin(0.5), 0.0])
    deaf = [replace(vault[0], heard=replace(vault[0].heard, weight=np.zeros_like(vault[0].heard.weight)))]
    shape = Sheet.about(shed(), turn, 0.02)
    aside_m = ours().wavelength_m * 5 / 32
    box = added(replace(shape, origin_m=tuple(shape.origin_m + aside_m * turn)), (1.0, 1e7))
    model = search._confirmed(deaf, vault, evaluated(deaf, ours(), [box]), KNOWN, Budget.of(60.0), {}, rounds.Barred())
    assert np.array(model.effects[0].choice.origin_m) == pytest.approx(shape.origin_m, abs=1e-9)


@pytest.mark.parametrize("is_clear", [False, True])
def test_energies_of_ends_that_are_remembered_are_those_of_their_responses(is_clear):
    random, base = np.random.default_rng(7), backed(is_clear)
    (ear,), wide = heard(theirs(), 30.0), sheet((-30.0, -20.0), (30.0, 20.0))
    effect = added(sheet((-3.0, -1.0), (4.0, 1.0)))
    here, endless = (applied(base, [one]) for one in (effect, replace(effect, choice=wide)))
    beside = extents._heard_beside(ear, here, endless, endless.mesh.index("missing_2"), effect)
    for _ in range(30):
        low_m = random.uniform(-9, 3, 2) * [1, 0.2]
        for high_m in low_m + random.uniform(0.5, 12, (2, 2)) * [1, 0.3]:
            fit = ear.profiled(beside.response(low_m, high_m))
            assert beside.energy(low_m, high_m) == beside.energy(low_m, high_m) == fit.energy - ear.tempered_nats(fit)
    assert 1 < len(beside.known) < 60


def test_what_the_vault_refuses_for_its_size_alone_is_as_small_as_the_soundings_leave_it(monkeypatch):
    ears, base = fenced(), replace(ours(), max_depth=2)
    model = evaluated(ears, base, [added(sheet((-20.0, -1.15), (20.0, 1.15)))])  # beyond what any path meets
    trimmed, pared = (how(ears, model, 0, KNOWN) for how in (settling.trimmed, settling.pared))
    widths_m = [one.effects[0].choice.high_m[0] - one.effects[0].choice.low_m[0] for one in (model, trimmed, pared)]
    assert max(one.energy for one in (trimmed, pared)) < model.energy + 10 and widths_m[2] < widths_m[1] < widths_m[0]

    def refused(vault, one) -> list[int]:
        return [0] if one.effects[0].choice.high_m[0] > pared.effects[0].choice.high_m[0] + 0.1 else []

    monkeypatch.setattr(search.foretold, "refused", refused)
    other = open_wells.otherwise(ears, ears, trimmed, 0, KNOWN, {}, Budget.of(60.0))
    assert other is not None and not refused(None, other)
