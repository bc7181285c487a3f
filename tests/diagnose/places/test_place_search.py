# SPDX-License-Identifier: GPL-3.0-or-later
"""Causes concealed in a small room by another tracer (tests/bench/places) are found, and nothing is where nothing is."""

import copy
import itertools
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast.diagnose.places import exchange, open_wells, rounds, search, settling, weighing
from gr_cast.diagnose.places.budget import Budget
from gr_cast.diagnose.places.ears import ResponseEar
from gr_cast.diagnose.places.fit import evaluated, fitted
from gr_cast.diagnose.places.likelihood import Heard, profiled
from gr_cast.diagnose.places.power import PowerEar
from gr_cast.diagnose.places.run import residual_over_received
from gr_cast.diagnose.places.view import View
from gr_cast.scenario.create.fields import surface_of
from gr_cast.scenario.create.geometry import Solid
from gr_cast.scenario.create.media import Medium
from gr_cast.scenario.create.nodes import Node
from gr_cast.twin.places.families import FAMILIES, mechanisms
from gr_cast.twin.places.families.base import Effect
from gr_cast.twin.places.families.nodes import TrackTiming
from gr_cast.twin.places.predict import Predictor
from gr_cast.twin.places.world import Mesh, Radio, World

sys.path.insert(0, str(Path(__file__).parents[2] / "bench" / "places"))
from world import new_world, response

CARRIER_HZ, FREQUENCY_HZ, TIME_S = 3e9, np.linspace(-1e8, 1e8, 20), np.array([0.0, 0.4, 0.8])
LINKS = [("a", "c"), ("a", "d"), ("b", "c"), ("b", "d"), ("a", "walker")]
BY_NAME = {family.name: family for family in FAMILIES}
UNKNOWN = {"phase": "snapshot", "delay": "none", "gain": "none"}
SPEC = {
    "a": ([[0.7, 0.8, 1.2]], 0.0, "dipole"),
    "b": ([[4.1, 0.6, 1.9]], 0.0, "iso"),
    "c": ([[1.1, 3.2, 0.9]], 0.0, "hw_dipole"),
    "d": ([[4.4, 2.9, 1.4]], 0.0, "tr38901"),
    "walker": ([[2.0, 1.0, 1.1], [3.0, 3.0, 1.1]], 1.1, "iso"),
}
WALLS = {
    "floor": ([(0, 0, 0), (5, 0, 0), (5, 4, 0), (0, 4, 0)], "concrete"),
    "south": ([(0, 0, 0), (5, 0, 0), (5, 0, 2.6), (0, 0, 2.6)], "brick"),
    "west": ([(0, 0, 0), (0, 4, 0), (0, 4, 2.6), (0, 0, 2.6)], "glass"),
    "board": ([(2.2, 2.6, 0.3), (3.1, 2.4, 0.3), (3.1, 2.4, 2.0), (2.2, 2.6, 2.0)], "metal"),
}


def theirs() -> dict:
    """The room for the bench's tracer."""
    corners = {name: np.array(points, float) for name, (points, _) in WALLS.items()}
    return new_world() | {
        "objects": {n: {"tris": np.array([p[[0, 1, 2]], p[[0, 2, 3]]]), "surface": None} for n, p in corners.items()},
        "materials": {name: material for name, (_, material) in WALLS.items()},
        "nodes": {
            name: {"waypoints_m": track, "speed_m_per_s": speed, "antenna": antenna, "orientation_rad": [0.3, 0.0, 0.0]}
            for name, (track, speed, antenna) in SPEC.items()
        },
        "carrier_hz": CARRIER_HZ,
        "bandwidth_hz": 2e8,
        "max_depth": 2,
    }


def ours() -> World:
    solids = tuple(Solid(name=n, vertices_m=np.array(p, float), faces=[[0, 1, 2], [0, 2, 3]]) for n, (p, _) in WALLS.items())
    media = {name: Medium(material=material) for name, (_, material) in WALLS.items()}
    mesh = Mesh.of(solids, np.array([track[0] for track, _, _ in SPEC.values()]))
    radios = {
        name: Radio(
            node=Node(name=name, waypoints_m=track, speed_m_per_s=speed, antenna=antenna, orientation_rad=(0.3, 0.0, 0.0))
        )  # fmt: skip
        for name, (track, speed, antenna) in SPEC.items()
    }
    surface = surface_of([media[name] for name in mesh.names], CARRIER_HZ)
    return World(mesh=mesh, media=media, surface=surface, radios=radios, carrier_hz=CARRIER_HZ, max_depth=2)


def heard(world: dict, snr_db: float, seed: int = 5) -> list[ResponseEar]:
    """Noisy responses of the bench's world, every snapshot turned by a phase of its own."""
    random = np.random.default_rng(seed)
    clean = response(world, LINKS, TIME_S, FREQUENCY_HZ)
    noise = (np.abs(clean) ** 2).mean() * 10 ** (-snr_db / 10)
    turned = clean * np.exp(2j * np.pi * random.random((len(LINKS), len(TIME_S), 1)))
    y = turned + np.sqrt(noise / 2) * (random.normal(size=clean.shape) + 1j * random.normal(size=clean.shape))
    told = Heard(links=tuple(LINKS), y=y, weight=np.full(y.shape, 1 / noise), frequency_hz=FREQUENCY_HZ, **UNKNOWN)
    return [ResponseEar(Predictor(*zip(*LINKS, strict=True), TIME_S, FREQUENCY_HZ), told)]


def only(monkeypatch, *names: str) -> None:
    """Nothing but these families is looked for."""
    monkeypatch.setattr(View, "families", [BY_NAME[name] for name in names])


def test_both_tracers_give_the_same_responses():
    predictor = Predictor(*zip(*LINKS, strict=True), TIME_S, FREQUENCY_HZ)
    a, b = predictor.response(ours()), response(theirs(), LINKS, TIME_S, FREQUENCY_HZ)
    assert np.abs(a - b).max() < 1e-6 * np.abs(b).max()


def test_a_lone_pair_follows_friis():
    world = ours()
    world = world.with_surface(slice(None), present=False)
    h = Predictor(["b"], ["walker"], TIME_S[:1], FREQUENCY_HZ).response(world)
    apart_m = np.linalg.norm(np.array(SPEC["b"][0][0]) - SPEC["walker"][0][0])
    assert np.abs(h) == pytest.approx(299_792_458 / CARRIER_HZ / (4 * np.pi * apart_m), rel=1e-6)


@pytest.mark.parametrize("unknown", [{"gain": "node"}, {"gain": "common", "delay": "link"}, {"delay": "node"}])
def test_what_is_unknown_is_fitted_and_never_left_over(unknown):
    h = response(theirs(), LINKS, TIME_S, FREQUENCY_HZ)
    gain = {"node": [1.2, 1.5, 0.96, 1.2, 1.8], "common": [0.7] * 5}.get(unknown.get("gain"), [1.0] * 5)  # products of nodes
    delay_s = {"link": [3e-9, -5e-9, 8e-9, 0.0, 1e-9], "node": [3e-9, 5e-9, 2e-9, 4e-9, -1e-9]}.get(
        unknown.get("delay"), [0.0] * 5
    )
    y = h * np.array(gain)[:, None, None] * np.exp(-2j * np.pi * np.array(delay_s)[:, None, None] * FREQUENCY_HZ)
    told = Heard(
        links=tuple(LINKS), y=y, weight=np.full(y.shape, 1e12), frequency_hz=FREQUENCY_HZ, **(UNKNOWN | unknown)
    )  # fmt: skip
    fit = profiled(told, h)
    assert fit.energy - fit.offset < 1e-6 * (np.abs(y) ** 2 * told.weight).sum()


def test_nothing_is_found_where_nothing_is():
    found = search.run(heard(theirs(), 30.0), ours(), UNKNOWN, 60.0)
    assert not found.model.effects and abs(found.deviations) < 4


def metered(world: dict) -> PowerEar:
    """A meter's readings of one link of the bench's world, without noise."""
    power = (np.abs(response(world, LINKS[:1], TIME_S, FREQUENCY_HZ)) ** 2).mean(axis=2, keepdims=True)
    predictor = Predictor(*zip(*LINKS[:1], strict=True), TIME_S, FREQUENCY_HZ)
    return PowerEar(predictor, 10 * np.log10(power), np.full(power.shape, 2.0), None, "none")


def test_powers_beside_responses_are_heard_with_them():
    ears = [metered(theirs()), *heard(theirs(), 30.0)]
    found = search.run(ears, ours(), UNKNOWN, 60.0)
    assert not found.model.effects
    told = residual_over_received(ears, found.start, found.model, 0, False)
    assert told["corrected_nmse_db"] == pytest.approx(told["noise_floor_db"], abs=0.3)
    assert told["noise_floor_db"] == pytest.approx(-30.0, abs=0.1)


def test_a_node_elsewhere_and_a_board_that_is_not_there_are_both_named():
    world = copy.deepcopy(theirs())
    world["nodes"]["b"]["waypoints_m"] = [[4.25, 0.48, 1.9]]
    del world["objects"]["board"], world["materials"]["board"]
    found = search.run(heard(world, 30.0), ours(), UNKNOWN, 240.0)
    named = {(effect.family.name, effect.owner): effect.values for effect in found.model.effects}
    assert set(named) == {("node_position", "b"), ("extra_object", "board")}
    assert named["node_position", "b"] == pytest.approx([0.15, -0.12, 0.0], abs=0.02)
    assert found.deviations < 4


def test_what_only_stands_in_the_way_is_named_too():
    world = copy.deepcopy(theirs())
    screen = np.array([(0.2, 1.9, 0.2), (1.6, 1.9, 0.2), (1.6, 1.9, 2.2), (0.2, 1.9, 2.2)])
    world["objects"]["screen"] = {"tris": screen[[[0, 1, 2], [0, 2, 3]]], "surface": None}
    world["materials"]["screen"] = "wood"
    world["media"]["screen"] = {"permittivity": 1.0, "conductivity": 1e-9}  # nothing comes back from it
    found = search.run(heard(world, 30.0), ours(), UNKNOWN, 60.0)
    assert [effect.family.name for effect in found.model.effects] == ["missing_object"]
    assert found.deviations < 4


def test_a_track_is_looked_for_far_and_wide_only_where_its_own_links_are_at_odds():
    late, elsewhere = copy.deepcopy(theirs()), copy.deepcopy(theirs())
    late["nodes"]["walker"]["time_offset_s"] = 0.3
    elsewhere["nodes"]["b"]["waypoints_m"] = [[4.25, 0.48, 1.9]]
    starts = []
    for world in (late, elsewhere):
        ears = heard(world, 30.0)
        starts.append(TrackTiming().starts(View(ears, evaluated(ears, ours(), ()), UNKNOWN), "walker"))
    assert min(abs(one.values[0] - 0.3) for one in starts[0]) < 0.05
    assert max(abs(one.values[0]) for one in starts[1]) < 0.05


def test_what_the_vault_refused_is_looked_for_again_where_more_is_known_alone():
    gone, known, more = (Effect(family=TrackTiming(), owner=name, values=np.zeros(1)) for name in ("walker", "a", "b"))
    barred = rounds.Barred()
    assert not barred.bars(gone.key, set())
    for have in ((), (known,)):
        barred.add([gone], SimpleNamespace(effects=have))
    assert barred.bars(gone.key, set()) and barred.bars(gone.key, {known.key})
    assert not barred.bars(gone.key, {more.key}) and not barred.bars(gone.key, {known.key, more.key})
    assert not barred.bars(known.key, set())


def test_a_round_is_made_once_unless_the_vault_refused_something_since(monkeypatch):
    made = []
    monkeypatch.setattr(rounds, "_round", lambda ears, model, *_: made.append(model) or ([], 1))
    ears, barred, gone = heard(theirs(), 30.0), rounds.Barred(), Effect(family=TrackTiming(), owner="walker", values=np.zeros(1))
    model, budget = evaluated(ears, ours(), ()), Budget.of(60.0)
    for _ in range(2):
        rounds.candidates(ears, model, UNKNOWN, budget, barred)
    assert len(made) == 1
    barred.add([gone], model)
    rounds.candidates(ears, model, UNKNOWN, budget, barred)
    assert len(made) == 2
    for _ in range(2):  # what had no time to end is made again
        rounds.candidates(ears, evaluated(ears, ours(), ()), UNKNOWN, Budget.of(0.0), rounds.Barred())
    assert len(made) == 4


@pytest.mark.parametrize(("wrong", "right", "swallows"), [("west", "west", False), ("west", "board", True)])
def test_what_the_vault_refuses_again_and_again_ends_the_search_without_it(monkeypatch, wrong, right, swallows):
    """Two of one kind and owner, one of which is refused; one that explains what another does, which goes, and is refused."""
    refused, kept = (Effect(family=TrackTiming(), owner=name, values=np.zeros(1)) for name in (wrong, right))
    made = []

    def explored(ears, model, unknown, budget, others, barred, progress, brief):
        effects = [*model.effects]
        made.append(effects)
        for one in (refused, kept):
            if one not in effects and not barred.bars(one.key, {e.key for e in effects}):
                effects = [*(e for e in effects if not (swallows and one is refused)), one]
                if one is refused and swallows:
                    break
        if swallows and kept in effects and not barred.bars(refused.key, {kept.key}):
            effects = [refused]
        return of(effects), 1

    def of(effects):
        return SimpleNamespace(effects=tuple(effects), base=None, energy=0.0)

    monkeypatch.setattr(search, "_explored", lambda *a: explored(*a) if len(made) < 9 else pytest.fail("no end"))
    monkeypatch.setattr(search.foretold, "refused", lambda vault, m: [k for k, e in enumerate(m.effects) if e is refused])
    monkeypatch.setattr(search, "fitted", lambda ears, one, **_: one)
    monkeypatch.setattr(search, "evaluated", lambda ears, base, effects: of(effects))
    monkeypatch.setattr(search, "without_effects", lambda _, m, gone: of([e for k, e in enumerate(m.effects) if k not in gone]))
    monkeypatch.setattr(exchange, "exchanged", lambda ears, model, *_: (model, {}))
    monkeypatch.setattr(exchange, "with_images", lambda ears, model, others, *_: others)
    monkeypatch.setattr(open_wells, "otherwise", lambda *_: None)
    for name, told in (("_unshown", []), ("_is_foretold", True)):
        monkeypatch.setattr(search, name, lambda *_, told=told: told)
    found = search.run([], None, {}, 60.0, vault=[None])
    assert found.model.effects == (kept,) and not found.spent


@pytest.mark.parametrize(
    ("noise", "foretold", "stands", "instead"),
    [(True, True, True, False), (False, True, False, False), (True, False, False, False), (True, True, False, True)],
)
def test_a_brief_list_stands_if_it_leaves_nothing_and_nothing_wide_does_as_much(monkeypatch, noise, foretold, stands, instead):
    narrow, wide = (Effect(family=BY_NAME[name], owner="b", values=np.zeros(3)) for name in ("node_gain", "node_position"))
    asked, held_against = [], []

    def explored(ears, model, unknown, budget, others, barred, progress, brief):
        asked.append((brief, len(model.effects), set(barred.briefly)))
        barred.briefly.update({narrow.key} if brief else {})
        return of([narrow if brief else wide]), 1

    def of(effects):
        return SimpleNamespace(effects=tuple(effects), base=None, energy=0.0)

    monkeypatch.setattr(search, "_explored", explored)
    monkeypatch.setattr(search, "evaluated", lambda ears, base, effects: of(effects))
    monkeypatch.setattr(search.foretold, "refused", lambda vault, model: [])
    monkeypatch.setattr(search, "_is_told", lambda *_: noise)
    monkeypatch.setattr(search, "_is_foretold", lambda ears, vault, model, *_: foretold or wide in model.effects)
    monkeypatch.setattr(weighing, "pruned", lambda ears, model, *_: model)
    monkeypatch.setattr(exchange, "wide_instead", lambda *_: [wide] if instead else [])
    monkeypatch.setattr(
        exchange, "with_wide", lambda ears, model, others, briefly, *_: held_against.append(set(briefly)) or others
    )
    monkeypatch.setattr(exchange, "with_images", lambda ears, model, others, *_: others)
    monkeypatch.setattr(exchange, "with_kin", lambda model, others: others)
    monkeypatch.setattr(exchange, "exchanged", lambda ears, model, *_: (model, {}))
    found = search.run([SimpleNamespace(has_responses=True, count=0)], None, {}, 60.0)
    assert not any(family.is_wide and family.shows_in_power for family in FAMILIES)  # without responses no round need be brief
    assert asked == [(True, 0, set()), *([] if stands else [(False, 0, set())])]
    assert found.model.effects == ((narrow,) if stands else (wide,))
    assert held_against == [{narrow.key} if stands else set()]


def test_a_round_fits_nothing_twice_and_what_the_vault_refused_changes_no_other_guess(monkeypatch):
    world = copy.deepcopy(theirs())
    world["nodes"]["walker"]["time_offset_s"] = 0.05
    ears, barred, screened, settled = heard(world, 30.0), rounds.Barred(), [], []
    model, look_at, settle = evaluated(ears, ours(), ()), rounds.screened, settling.settled
    monkeypatch.setattr(rounds, "screened", lambda *a: screened.append(a) or look_at(*a))
    monkeypatch.setattr(settling, "settled", lambda ears, one, *a: settled.append(one.effects[-1]) or settle(ears, one, *a))
    first, _ = rounds.candidates(ears, model, UNKNOWN, Budget.of(200.0), barred)
    plain = [one for one in first if not one.effects[-1].family.shape_axes]
    alike = [(one, other) for one, other in itertools.combinations(plain, 2) if one.effects[-1].key == other.effects[-1].key]
    assert len(plain) > 3 and all(abs(one.energy - other.energy) > 0.1 for one, other in alike)
    count, gone = len(screened), first[0].effects[-1]
    barred.add([gone], model)
    second, _ = rounds.candidates(ears, model, UNKNOWN, Budget.of(200.0), barred)
    kept = {one.effects[-1].key: one.energy for one in first if one.effects[-1].key != gone.key}
    assert len({id(one) for one in settled}) == len(settled)  # what was fitted is not fitted again
    assert len(screened) == count and gone.key not in {one.effects[-1].key for one in second}
    assert kept.items() <= {one.effects[-1].key: one.energy for one in second}.items()


@pytest.mark.parametrize("late_s", [0.05, 0.0])
def test_what_may_be_anywhere_is_looked_for_where_nothing_narrow_explains_most(monkeypatch, late_s):
    world = copy.deepcopy(theirs())
    world["nodes"]["walker"]["time_offset_s"] = late_s
    world["nodes"]["b"]["waypoints_m"] = np.array([[4.1, 0.6, 1.9]]) + (0.0 if late_s else 0.3)
    ears, barred, looked = heard(world, 30.0), rounds.Barred(), []
    model, look_at = evaluated(ears, ours(), ()), rounds.screened
    only(monkeypatch, "track_timing", "node_position", "node_gain")
    monkeypatch.setattr(rounds, "screened", lambda *a: looked.append(a[3]) or look_at(*a))
    made = rounds.brief(ears, model, UNKNOWN, Budget.of(200.0), barred)
    assert bool(made) == bool(late_s) and not any(family.is_wide for family in looked) and rounds.was_brief(model, barred)
    narrow = list(looked)
    found, _ = rounds.candidates(ears, model, UNKNOWN, Budget.of(200.0), barred)
    assert looked[: len(narrow)] == narrow and all(family.is_wide for family in looked[len(narrow) :])
    assert not rounds.was_brief(model, barred) and len(looked) > len(narrow)
    assert found[0].effects[-1].key == (("track_timing", "walker") if late_s else ("node_position", "b"))
    assert not made or found[0] is not made[0][0] and made[0][0].effects[-1].key == found[0].effects[-1].key


@pytest.mark.parametrize("briefly", [True, False])
def test_what_was_found_in_a_brief_round_has_rivals_that_may_be_anywhere(monkeypatch, briefly):
    world = copy.deepcopy(theirs())
    world["nodes"]["b"]["waypoints_m"] = np.array([[4.15, 0.68, 1.9]])
    ears, late = heard(world, 30.0), Effect(family=BY_NAME["node_delay"], owner="b", values=np.array([3e-10]))
    model = fitted(ears, evaluated(ears, ours(), [late]))
    asked = {late.key} if briefly else set()
    only(monkeypatch, "node_gain", "node_position", "object_moved")
    heard_on, guess = [], rounds.wide_guesses
    monkeypatch.setattr(rounds, "wide_guesses", lambda ears, *a: heard_on.extend(ears[0].heard.links) or guess(ears, *a))
    others = exchange.with_wide(ears, model, {late.key: [late]}, asked, UNKNOWN, Budget.of(200.0))
    assert [one.key for one in others[late.key]].count(("node_position", "b")) == briefly
    assert set(heard_on) == ({("b", "c"), ("b", "d")} if briefly else set())
    best, _ = exchange.exchanged(ears, model, others, ears[0].count, 50, Budget.of(60.0))
    assert best.effects[0].key == (("node_position", "b") if briefly else late.key)


@pytest.mark.parametrize("shaded", [True, False])
def test_losses_of_links_are_one_thing_that_stands_in_the_way_of_them_or_none(monkeypatch, shaded):
    world, links = copy.deepcopy(theirs()), [("a", "c"), ("a", "d")]
    screen = np.array([(0.9, 1.2, 0.2), (2.4, 1.2, 0.2), (2.4, 1.2, 2.2), (0.9, 1.2, 2.2)])
    if shaded:
        world["objects"]["screen"] = {"tris": screen[[[0, 1, 2], [0, 2, 3]]], "surface": None}
        world["materials"]["screen"] = "wood"
        world["media"]["screen"] = {"permittivity": 1.0, "conductivity": 1e-9}
    else:
        world["link_loss_db"] = {("a", "c"): 6.0, ("b", "d"): 9.0}
        links[1] = ("b", "d")
    ears, family = heard(world, 30.0), mechanisms.ExcessLoss()
    losses = [Effect(family=family, owner=f"{a}>{b}", values=np.array([3.0])) for a, b in links]
    model = fitted(ears, evaluated(ears, ours(), losses))
    only(monkeypatch, "missing_object", "node_position", "node_gain")
    wide = exchange.wide_instead(ears, model, 2, UNKNOWN, Budget.of(200.0))
    assert (("missing_object", "place") in [one.key for one in wide]) == bool(wide) == shaded
    one = fitted(ears, evaluated(ears, ours(), losses[:1]))
    assert not exchange.wide_instead(ears, one, 2, UNKNOWN, Budget.of(200.0))
    assert not exchange.wide_instead(ears, model, 1, UNKNOWN, Budget.of(0.0))


@pytest.mark.parametrize(("name", "asked"), [("missing_diffraction", False), ("ground", True), ("node_gain", True)])
def test_what_is_of_the_place_and_told_by_most_links_has_no_rival_that_stands_somewhere(monkeypatch, name, asked):
    """A level object may look like the ground."""
    owner, own = ("a", [1.0]) if name == "node_gain" else ("place", [] if name == "missing_diffraction" else [0.0, 1.5])
    effect = Effect(family=BY_NAME[name], owner=owner, values=np.array(own))
    ears, looked = heard(theirs(), 30.0), []
    model = SimpleNamespace(effects=(effect,), base=ours(), tempered=0.0)
    monkeypatch.setattr(exchange, "_without", lambda *_: (SimpleNamespace(tempered=500.0, effects=()), ears))
    monkeypatch.setattr(exchange, "_explaining", lambda *a: looked.append(a) or [])
    others = exchange.with_wide(ears, model, {}, {effect.key}, UNKNOWN, Budget.of(60.0))
    assert bool(looked) == asked and others.keys() == ({effect.key} if asked else set())


def test_what_comes_in_anothers_place_predicts_the_vault_as_well_as_what_is_open_of_it(monkeypatch):
    """A rival was better by what its numbers may be, and those that were fitted are others."""
    found, rival, open_ = (Effect(family=TrackTiming(), owner=name, values=np.zeros(1)) for name in ("walker", "a", "b"))

    def of(effects):
        return SimpleNamespace(effects=tuple(effects), base=None, energy=0.0)

    monkeypatch.setattr(search, "_explored", lambda *_: (of([found]), 1))
    monkeypatch.setattr(search.foretold, "refused", lambda vault, model: [0] if model.effects == (rival,) else [])
    monkeypatch.setattr(exchange, "exchanged", lambda *_: (of([rival]), {}))
    monkeypatch.setattr(open_wells, "in_its_well", lambda ears, vault, model, *_: of([open_]))
    monkeypatch.setattr(search, "evaluated", lambda ears, base, effects: of(effects))
    monkeypatch.setattr(exchange, "with_images", lambda ears, model, others, *_: others)
    for name, told in (("_unshown", []), ("_is_foretold", True)):
        monkeypatch.setattr(search, name, lambda *_, told=told: told)
    assert search.run([], None, {}, 60.0, vault=[None]).model.effects == (open_,)
