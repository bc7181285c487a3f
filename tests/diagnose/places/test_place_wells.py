# SPDX-License-Identifier: GPL-3.0-or-later
"""What turns phases is begun in its own well, not in a neighbour: a ground, an object that stands elsewhere."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast.diagnose.places import exchange, open_wells, policy, rounds, scan, search
from gr_cast.diagnose.places.budget import Budget
from gr_cast.diagnose.places.ears import ResponseEar
from gr_cast.diagnose.places.fit import applied, evaluated, fitted, with_effect
from gr_cast.diagnose.places.likelihood import Heard
from gr_cast.diagnose.places.view import View
from gr_cast.scenario.create.fields import surface_of
from gr_cast.scenario.create.geometry import Solid
from gr_cast.scenario.create.media import Medium
from gr_cast.scenario.create.nodes import Node
from gr_cast.twin.places.families import FAMILIES
from gr_cast.twin.places.families.base import Effect
from gr_cast.twin.places.families.nodes import _holds_most
from gr_cast.twin.places.predict import Predictor
from gr_cast.twin.places.world import Mesh, Radio

from tests.diagnose.places.test_place_edges import SIDES, box
from tests.diagnose.places.test_place_search import LINKS, TIME_S, UNKNOWN, ours, response, theirs

CARRIER_HZ = 17e9  # a wavelength of 18 mm
BY_NAME = {family.name: family for family in FAMILIES}


def twin(*without: str):
    """The room without some of its objects, its surfaces at the carrier."""
    world = ours()
    solids = [solid for solid in world.mesh.solids if solid.name not in without]
    mesh = Mesh.of(tuple(solids), np.array([radio.node.waypoints_m[0] for radio in world.radios.values()]))
    media = {name: world.media[name] for name in mesh.names}
    surface = surface_of([media[name] for name in mesh.names], CARRIER_HZ)
    return replace(world, mesh=mesh, media=media, surface=surface, carrier_hz=CARRIER_HZ)


def sounded(name: str, offset_m, band_hz: float, tris=None) -> list[ResponseEar]:
    """The room of the other tracer with one object elsewhere, `tris` if it looks otherwise; 30 dB over the noise."""
    world = theirs()
    own = world["objects"][name]
    world["objects"] = world["objects"] | {name: own | {"tris": (own["tris"] if tris is None else tris) + np.asarray(offset_m)}}
    return of_world(world, band_hz)


def of_world(world: dict, band_hz: float) -> list[ResponseEar]:
    world = world | {"carrier_hz": CARRIER_HZ, "bandwidth_hz": band_hz}
    frequency_hz = np.linspace(-band_hz / 2, band_hz / 2, 20)
    clean, random = response(world, LINKS, TIME_S, frequency_hz), np.random.default_rng(3)
    noise = (np.abs(clean) ** 2).mean() / 1e3
    y = clean + np.sqrt(noise / 2) * (random.normal(size=clean.shape) + 1j * random.normal(size=clean.shape))
    told = Heard(links=tuple(LINKS), y=y, weight=np.full(y.shape, 1 / noise), frequency_hz=frequency_hz, **UNKNOWN)
    return [ResponseEar(Predictor(*zip(*LINKS, strict=True), TIME_S, frequency_hz), told)]


def first(ears, world, family: str, owner: str):
    """The best of those of a family's first guesses that a search fits."""
    view = View(ears, evaluated(ears, world, ()), UNKNOWN)
    best = view.ranked(BY_NAME[family].starts(view, owner))[: policy.FULL_STARTS]
    return min((fitted(ears, with_effect(ears, view.model, one)) for one in best), key=lambda one: one.energy)


def best(ears, world, family: str, owner: str):
    """The best of what a search screens of a family."""
    view = View(ears, evaluated(ears, world, ()), UNKNOWN)
    return min(rounds.screened(view, ears, view.model, BY_NAME[family], owner), key=lambda one: one.energy)


@pytest.mark.parametrize("band_hz", [2e8, 2e7])
@pytest.mark.parametrize("height_m", [0.0, -0.437, -1.913])
def test_a_ground_is_begun_at_its_own_height(height_m, band_hz):
    found = first(sounded("floor", [0, 0, height_m], band_hz), twin("floor"), "ground", "place")
    assert found.effects[0].values[0] == pytest.approx(height_m, abs=1e-3)


@pytest.mark.parametrize("shift_m", [-0.431, -0.253, 0.1234, 0.377])
def test_an_object_is_begun_where_it_stands_though_it_moved_by_many_waves(shift_m):
    world = twin()
    normal = world.axes(world.mesh.index("board"))[0]
    found = first(sounded("board", shift_m * normal, 2e8), world, "object_moved", "board")
    assert found.effects[0].values[0] == pytest.approx(shift_m, abs=1e-3)


def test_a_box_that_moved_along_what_is_seen_of_it_is_found_by_what_its_ends_meet():
    corners_m, along = box((2.2, 2.5, 0.3), (3.1, 2.7, 2.0), 0.0), np.array([1.0, 0.0, 0.0])
    world = twin()
    solid = Solid(name="board", vertices_m=corners_m, faces=SIDES)
    solids = [solid if one.name == "board" else one for one in world.mesh.solids]
    world = replace(world, mesh=Mesh.of(tuple(solids), np.array([radio.node.waypoints_m[0] for radio in world.radios.values()])))
    ears = sounded("board", 0.4 * along, 2e8, corners_m[np.array(SIDES)])
    found = first(ears, world, "object_moved", "board")
    assert np.abs(found.effects[0].choice) == pytest.approx(along)
    assert found.energy - ears[0].count < 5 * np.sqrt(ears[0].count) < evaluated(ears, world, ()).energy - ears[0].count


def test_the_deepest_well_is_told_by_its_bottom():
    random = np.random.default_rng(1)
    rates = 2 * np.pi * random.uniform(0.9, 1.1, (1, 6, 1)).repeat(5, axis=2)
    base = random.normal(size=(6, 5)) + 1j * random.normal(size=(6, 5))
    at = 3.317
    y = (base * np.exp(-1j * at * rates[0])).sum(axis=0)
    row = scan.Row(base=base, rates=rates, rest=np.zeros(5), y=y, weight=np.ones(5), is_free=False)
    grid = np.arange(-6, 6, 1 / 4)
    assert scan.wells([row], grid, 1) == pytest.approx([at], abs=1 / 32)
    assert scan.minima(grid, scan.energy_along([row], grid), 1) != pytest.approx([at], abs=1 / 8)


@pytest.mark.parametrize("is_free", [False, True])
def test_bottoms_of_wells_are_where_every_step_aside_leaves_more(is_free):
    random = np.random.default_rng(4)
    rows, at = [], np.array([0.4, -0.7, 0.2])
    for _ in range(9):
        rates = 2 * np.pi * random.uniform(-1, 1, (3, 4, 1)).repeat(5, axis=2) * np.linspace(0.95, 1.05, 5)
        base, rest = (random.normal(size=(n, 5)) + 1j * random.normal(size=(n, 5)) for n in (4, 1))
        y = (base * np.exp(-1j * np.einsum("a,apk->pk", at, rates))).sum(axis=0) + rest[0]
        y = y * np.exp(0.7j * is_free) + 0.01 * random.normal(size=5)
        rows.append(scan.Row(base=base, rates=rates, rest=rest[0], y=y, weight=np.full(5, 1e4), is_free=is_free))
    places, nats = scan.bottoms(rows, at + 0.04 * random.normal(size=(5, 3)), 0.1, rounds=8)
    assert places == pytest.approx(np.tile(places[0], (5, 1)), abs=1e-5) and places[0] == pytest.approx(at, abs=0.01)

    def energy(place):
        return scan.energy_in_space(rows, place[:1], place[1:2], place[2:]).ravel()

    assert nats[:, 0] == pytest.approx(energy(places[0]), rel=1e-2)  # which is in single precision
    assert all(energy(places[0] + step)[1] > nats[1, 0] + 0.1 for step in 0.01 * np.vstack([np.eye(3), -np.eye(3)]))


@pytest.mark.parametrize("offset_m", [(0.21, -0.17, 0.05), (0.02, 0.03, -0.01)])
def test_a_node_is_begun_where_it_stands_though_it_is_many_waves_off(offset_m):
    world = theirs()
    world["nodes"]["a"]["waypoints_m"] = [(np.array(world["nodes"]["a"]["waypoints_m"][0]) + offset_m).tolist()]
    found = best(of_world(world, 2e8), twin(), "node_position", "a")
    assert found.effects[0].values == pytest.approx(offset_m, abs=2e-3)


def test_a_wall_and_a_node_that_move_images_alike_are_heard_alike_over_that_wall():
    world, ears = twin(), sounded("board", [0, 0, 0], 2e8)
    normal = world.axes(world.mesh.index("west"))[0]
    moved = Effect(family=BY_NAME["object_moved"], owner="west", values=np.array([0.083]), choice=tuple(normal))
    shift_m, view = moved.family.images_moved_m(moved), View(ears, evaluated(ears, world, ()), UNKNOWN)
    nodes = BY_NAME["node_position"].moving_images(view, shift_m)
    assert {one.owner for one in nodes} == set(view.nodes)
    assert all(one.family.images_moved_m(one) == pytest.approx(shift_m) for one in nodes)
    walls = [one for one in BY_NAME["object_moved"].moving_images(view, shift_m) if one.owner == "west"]
    assert [one.values[0] * np.array(one.choice) for one in walls] == [pytest.approx(0.083 * normal)]

    def over_the_wall(effect) -> np.ndarray:
        changed = applied(world, [effect])
        table = ears[0].predictor.path_table(changed, LINKS.index(("a", "c")))
        west = changed.faces.owner[table.paths.faces] == world.mesh.index("west")
        return table.way.length_m[(west & (table.paths.faces >= 0)).sum(axis=1) == (table.paths.faces >= 0).sum(axis=1)]

    for name in ("a", "c"):
        node = next(one for one in nodes if one.owner == name)
        lengths_m = [np.sort(over_the_wall(one))[-1] for one in (moved, node)]
        assert lengths_m[0] == pytest.approx(lengths_m[1], abs=1e-9)


def test_what_moves_images_alike_is_a_rival():
    ears, world = of_world(theirs(), 2e8), twin()
    moved = Effect(family=BY_NAME["object_moved"], owner="west", values=np.array([0.083]), choice=(1.0, 0.0, 0.0))
    others = exchange.with_images(ears, evaluated(ears, world, [moved]), {moved.key: [moved]}, UNKNOWN, Budget.of(60.0))[
        moved.key
    ]
    assert others[0] is moved and any(one.family.name == "node_position" for one in others[1:])
    gain = Effect(family=BY_NAME["node_gain"], owner="a", values=np.array([1.0]))
    assert exchange.with_images(ears, evaluated(ears, world, [gain]), {}, UNKNOWN, Budget.of(60.0)) == {}


@pytest.mark.parametrize("off_m", [0.0, 0.008, -0.013])
def test_a_mirror_is_a_rival_in_its_own_well_of_a_node_that_stands_in_a_wrong_one(off_m):
    ears = sounded("west", [0.083, 0, 0], 2e8)
    node = Effect(family=BY_NAME["node_position"], owner="a", values=np.array([-2 * (0.083 + off_m), 0.0, 0.0]))
    others = exchange.with_images(ears, evaluated(ears, twin(), [node]), {}, UNKNOWN, Budget.of(60.0))[node.key]
    moved = [one.values[0] * one.choice[0] for one in others if one.owner == "west"]
    assert any(abs(shift_m - 0.083) < 1e-3 for shift_m in moved)


def test_what_a_node_spoils_on_links_that_share_delays_and_gains_with_its_own_is_not_theirs():
    world = theirs()
    world["nodes"]["a"]["waypoints_m"] = [(np.array(world["nodes"]["a"]["waypoints_m"][0]) + [0.21, -0.17, 0.05]).tolist()]
    (ear,) = of_world(world, 2e8)
    ear = replace(ear, heard=replace(ear.heard, phase="none", delay="node", gain="common"))
    view = View([ear], evaluated([ear], twin(), ()), UNKNOWN | {"delay": "node", "gain": "common"})
    others = np.array(["a" not in link for link in LINKS])
    shared = ear.left(view.model.fits[0]) - (ear.root > 0).sum(axis=(1, 2))
    alone = np.array([nats for _, nats in view.left_alone])
    assert alone[others].sum() < 4 * np.sqrt(ear.count) < 50 * np.sqrt(ear.count) < shared[others].sum()
    assert _holds_most(view, "a") and not _holds_most(view, "b")


def test_beside_what_nobody_named_a_node_may_be_where_it_was_surveyed_or_as_far_off_as_told():
    offset_m = np.array([0.064, -0.084, -0.109])
    effect = Effect(family=BY_NAME["node_position"], owner="n0", values=offset_m)
    std_m = np.array(effect.family.told(None, effect, effect.family.besides(None, effect))["offset_m"]["std"])
    for direction in np.random.default_rng(5).normal(size=(50, 3)):
        true_m = offset_m + np.linalg.norm(offset_m) * direction / np.linalg.norm(direction)
        assert np.all(np.abs(true_m - offset_m) <= 1.9600 * std_m)


OFFSET_M = np.array([0.03, -0.02, 0.01])


def with_b_elsewhere() -> list[ResponseEar]:
    world = theirs()
    moved = world["nodes"]["b"] | {"waypoints_m": (np.array(world["nodes"]["b"]["waypoints_m"]) + OFFSET_M).tolist()}
    return of_world(world | {"nodes": world["nodes"] | {"b": moved}}, 2e8)


def b_at(ears, offset_m):
    return fitted(ears, evaluated(ears, twin(), [Effect(family=BY_NAME["node_position"], owner="b", values=np.array(offset_m))]))


def is_right(model) -> bool:
    return np.linalg.norm(model.effects[0].values - OFFSET_M) < 2e-3


def test_what_the_vault_refuses_is_looked_for_in_wells_that_are_far_off_too(monkeypatch):
    ears = with_b_elsewhere()
    model = b_at(ears, [0.15, 0.15, 0.0])
    assert np.linalg.norm(model.effects[0].values - OFFSET_M) > 0.1  # 6 wavelengths
    monkeypatch.setattr(search.foretold, "refused", lambda vault, one: [] if is_right(one) else [0])
    assert is_right(open_wells.otherwise(ears, ears, model, 0, UNKNOWN, {}, Budget.of(60.0)))


def test_a_well_that_a_part_of_the_soundings_holds_for_the_deepest_is_not_taken_for_it():
    ears = with_b_elsewhere()
    right, wrong, far = (b_at(ears, offset_m) for offset_m in (OFFSET_M, [0.13, -0.01, -0.02], [0.15, 0.15, 0.0]))
    assert is_right(right) and not is_right(wrong)
    base, wells = evaluated(ears, twin(), ()), {}
    found = [rounds.by_all(ears, base, [wrong, far, right], one, wells) for one in (wrong, far)]
    assert is_right(found[0]) and [one.energy for one in found] == pytest.approx([right.energy, wrong.energy], rel=1e-3)


def test_what_is_looked_for_beside_a_wrong_well_is_looked_for_beside_the_open_one_too(monkeypatch):
    world, shift_m = twin(), 0.1234
    normal = world.axes(world.mesh.index("board"))[0]
    ears, family = sounded("board", shift_m * normal, 2e8), BY_NAME["object_moved"]
    ears = [replace(ears[0], heard=replace(ears[0].heard, weight=ears[0].heard.weight * 1e-2))]  # both wells are open
    away = Effect(family=family, owner="board", values=np.array([shift_m + world.wavelength_m / 2]), choice=tuple(normal))
    wrong = fitted(ears, evaluated(ears, world, (away,)))

    def is_right(model) -> bool:
        return abs(model.effects[0].values[0] - shift_m) < 1e-3

    others = rounds._in_open_wells(ears, wrong, 1.0)
    assert not is_right(wrong) and is_right(others[0])
    assert all(abs(one.energy - wrong.energy) < policy.RIVAL_NATS for one in others)
    view, more = View(ears, wrong, UNKNOWN), BY_NAME["missing_reflections"]
    alone, beside = (rounds.screened(view, ears, wrong, more, "place", some) for some in ((), others))
    assert not any(is_right(one) for one in alone) and is_right(min(beside, key=lambda one: one.energy))
    monkeypatch.setattr(View, "families", [more])
    look = rounds.Look(screen=rounds.Screen.of(view, Budget.of(60.0)))
    rounds._look(look, rounds.Barred(), Budget.of(60.0), wide=False)
    best = min(look.guesses[False], key=lambda one: one.energy)
    assert abs(best.effects[0].values[0] - shift_m) < 1e-3 and look.tried == {(more.name, "place")}


def _over_ground(height_m: float, permittivity: float, unknown: dict):
    """(soundings, twin without the ground): ten still links by the two-ray law with Fresnel's coefficient of a half-space, under
    grazing angles of 9 to 32°, to 40 dB over the noise. Isotropic, vertical: both fields along theta, transverse magnetic. Of one
    link, and of the first and the last instant, there is nothing."""
    random, frequency_hz = np.random.default_rng(2), np.linspace(-4e7, 4e7, 24)
    x_m, angle = np.linspace(9, 40, 10), np.deg2rad(np.linspace(9, 32, 10)[random.permutation(10)])
    far_m = x_m / np.cos(angle)
    z_m = far_m * np.sin(angle) - 1.0 + height_m
    nodes = {"a": (0.0, 0.0, 1.0 + height_m)} | {
        f"b{number}": (x, 0.0, z) for number, (x, z) in enumerate(zip(x_m, z_m, strict=True))
    }
    solid = Solid(name="far", vertices_m=np.array([[0, 0, 900.0], [1, 0, 900], [1, 1, 900]]), faces=[[0, 1, 2]])
    world = replace(
        ours(), mesh=Mesh.of((solid,), np.array(list(nodes.values()))), media={"far": Medium(material="concrete")}, max_depth=1,
        surface=surface_of([Medium(material="concrete")], CARRIER_HZ), carrier_hz=CARRIER_HZ,
        radios={name: Radio(node=Node(name=name, waypoints_m=np.array([at]))) for name, at in nodes.items()},
    )  # fmt: skip
    hz = CARRIER_HZ + frequency_hz
    eta, sine = permittivity - 1j * 0.01 * 17.975 / (CARRIER_HZ / 1e9), np.sin(angle)
    root = np.sqrt(eta - np.cos(angle) ** 2)
    straight_m, reflection = np.hypot(x_m, z_m - 1.0 - height_m), (eta * sine - root) / (eta * sine + root)
    echoes = (straight_m, np.ones(10)), (far_m, reflection)
    clean = sum((gain / far)[:, None] * np.exp(-2j * np.pi * hz * far[:, None] / 299792458.0) for far, gain in echoes)
    clean = (clean * 299792458.0 / CARRIER_HZ / (4 * np.pi))[:, None].repeat(4, axis=1)
    turns, late_s = random.random((10, 4, 1)), random.normal(0, 5e-9, (10, 1, 1)) * (unknown["delay"] == "link")
    turns = {"none": 0.0, "link": turns[:, :1], "snapshot": turns}[unknown["phase"]]
    clean *= np.exp(2j * np.pi * (turns - frequency_hz * late_s))
    noise = (np.abs(clean) ** 2).mean() / 1e4
    y = clean + np.sqrt(noise / 2) * (random.normal(size=clean.shape) + 1j * random.normal(size=clean.shape))
    weight, links = np.full(y.shape, 1 / noise), [("a", f"b{number}") for number in range(10)]
    weight[4] = weight[:, [0, -1]] = 0.0
    told = Heard(links=tuple(links), y=y * (weight > 0), weight=weight, frequency_hz=frequency_hz, **unknown)
    ear = ResponseEar(Predictor(*zip(*links, strict=True), np.arange(4.0), frequency_hz), told)
    return ear, world


@pytest.mark.parametrize(
    ("height_m", "permittivity", "phase", "delay", "gain"),
    [
        (-0.325, 12.9, "snapshot", "link", "common"), (0.21, 9.2, "snapshot", "none", "node"),
        (-0.73, 17.0, "link", "link", "none"), (0.15, 5.0, "none", "link", "common"), (-0.6, 21.0, "none", "none", "none"),
    ],
)  # fmt: skip
def test_a_ground_is_begun_at_its_height_where_echoes_of_another_permittivity_would_be_turned_round(
    height_m, permittivity, phase, delay, gain
):
    unknown = {"phase": phase, "delay": delay, "gain": gain}
    ear, world = _over_ground(height_m, permittivity, unknown)
    view = View([ear], evaluated([ear], world, ()), unknown)
    one = BY_NAME["ground"].starts(view, "place")[0]
    found = fitted([ear], with_effect([ear], view.model, one))
    assert found.effects[0].values == pytest.approx([height_m, np.log(permittivity)], abs=1e-2)
    assert found.deviations(ear.count) < 4 < view.model.deviations(ear.count)


@pytest.mark.parametrize("ratio, missing", [(1.02, ()), (1.11, ()), (1.11, ("floor", "board"))])
def test_a_carrier_is_begun_in_its_own_well_though_nothing_moves_and_much_else_is_missing(ratio, missing):
    still_s, unknown = TIME_S[:1], {"phase": "link", "delay": "none", "gain": "common"}
    world, frequency_hz = theirs() | {"carrier_hz": ratio * CARRIER_HZ, "bandwidth_hz": 1e8}, np.linspace(-5e7, 5e7, 24)
    clean, random = response(world, LINKS, still_s, frequency_hz), np.random.default_rng(3)
    noise = (np.abs(clean) ** 2).mean() / 1e3
    y = clean + np.sqrt(noise / 2) * (random.normal(size=clean.shape) + 1j * random.normal(size=clean.shape))
    told = Heard(links=tuple(LINKS), y=y, weight=np.full(y.shape, 1 / noise), frequency_hz=frequency_hz, **unknown)
    ears = [ResponseEar(Predictor(*zip(*LINKS, strict=True), still_s, frequency_hz), told)]
    view = View(ears, evaluated(ears, twin(*missing), ()), unknown)
    fits = [fitted(ears, with_effect(ears, view.model, one)) for one in BY_NAME["carrier"].starts(view, "place")]
    best = min(fits, key=lambda one: one.energy)
    assert np.exp(best.effects[-1].values[0]) == pytest.approx(ratio * CARRIER_HZ, rel=2e-4)


@pytest.mark.parametrize(
    ("name", "offset_m"),
    [
        ("a", (0.02, -0.01, 0.07)),
        ("c", (-0.03, 0.02, -0.1)),
        ("walker", (0.01, 0.05, 0.13)),
        ("c", (0.2, -0.13, -0.38)),
        ("b", (-0.15, 0.2, 0.42)),
    ],
)
def test_a_node_that_is_higher_by_many_waves_is_begun_there(name, offset_m):
    world = theirs()
    own = world["nodes"][name]
    moved = own | {"waypoints_m": [list(np.add(at_m, offset_m)) for at_m in own["waypoints_m"]]}
    ears = of_world(world | {"nodes": world["nodes"] | {name: moved}}, 2e8)
    view = View(ears, evaluated(ears, twin(), ()), UNKNOWN)
    fits = [fitted(ears, with_effect(ears, view.model, one)) for one in BY_NAME["node_position"].starts(view, name)]
    assert min(fits, key=lambda one: one.energy).effects[-1].values == pytest.approx(offset_m, abs=2e-3)


@pytest.mark.parametrize("name, offset_m", [("a", (0.04, -0.02, 0.05)), ("b", (-0.09, 0.03, -0.06))])
def test_a_node_is_begun_at_its_place_where_phases_are_known_and_delays_are_not(name, offset_m):
    """Delays that nobody knows would make up for phases that are wrong, and hide where these are right."""
    world, random, unknown = theirs(), np.random.default_rng(1), {"phase": "none", "delay": "link", "gain": "common"}
    own = world["nodes"][name]
    moved = own | {"waypoints_m": [list(np.add(at_m, offset_m)) for at_m in own["waypoints_m"]]}
    (ear,) = of_world(world | {"nodes": world["nodes"] | {name: moved}}, 2e8)
    late = np.exp(-2j * np.pi * ear.heard.frequency_hz * random.normal(0, 5e-9, (len(LINKS), 1, 1)))
    ears = [replace(ear, heard=replace(ear.heard, y=ear.heard.y * late, **unknown))]
    view = View(ears, evaluated(ears, twin(), ()), unknown)
    fits = [fitted(ears, with_effect(ears, view.model, one)) for one in BY_NAME["node_position"].starts(view, name)]
    assert min(fits, key=lambda one: one.energy).effects[-1].values == pytest.approx(offset_m, abs=2e-3)


@pytest.mark.parametrize("carrier_hz", [1e9, 7e9, 28e9])
def test_all_about_where_the_mesh_has_it_an_object_that_moved_is_begun(carrier_hz):
    """However far off it was found: a well may be no wider than a 16th of a wave, where what is seen of it changes."""
    wavelength_m = 299_792_458 / carrier_hz
    moved = Effect(
        family=next(one for one in FAMILIES if one.name == "object_moved"),
        owner="box",
        values=np.array([0.6]),
        choice=(1.0, 0.0, 0.0),
    )
    begun = [one.values[0] for one in moved.family.restarts(SimpleNamespace(wavelength_m=wavelength_m), moved)]
    within_m = min(0.24, 9 * wavelength_m)
    at_m = np.random.default_rng(1).uniform(-within_m, within_m, 100)
    assert np.abs(at_m[:, None] - begun).min(axis=1).max() <= 1.01 * wavelength_m / 32


def test_a_node_is_looked_for_in_the_wells_of_floor_and_ceiling_that_are_waves_apart():
    node = Effect(family=BY_NAME["node_position"], owner="a", values=np.array([0.1, -0.2, 0.0]))
    begun = np.array([one.values for one in node.family.wells(SimpleNamespace(wavelength_m=0.04), node)])
    for axis in np.eye(3):
        far_m = np.linspace(0.02, 0.15, 40)[:, None, None] * axis
        assert np.linalg.norm(node.values + far_m - begun, axis=2).min(axis=1).max() <= 0.0051
