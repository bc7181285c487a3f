# SPDX-License-Identifier: GPL-3.0-or-later
"""Edges of a yard bend as those of another tracer (tests/bench/places), and nobody is accused of how strongly they do."""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast.diagnose.places import search, weighing
from gr_cast.diagnose.places.ears import ResponseEar
from gr_cast.diagnose.places.fit import evaluated
from gr_cast.diagnose.places.likelihood import Heard
from gr_cast.scenario.create.fields import surface_of
from gr_cast.scenario.create.geometry import Solid
from gr_cast.scenario.create.media import Medium
from gr_cast.scenario.create.nodes import Node
from gr_cast.twin.places.families.base import Effect
from gr_cast.twin.places.families.mechanisms import MissingScattering
from gr_cast.twin.places.predict import Predictor
from gr_cast.twin.places.world import Mesh, Radio, World

sys.path.insert(0, str(Path(__file__).parents[2] / "bench" / "places"))
from world import new_world, response

CARRIER_HZ, FREQUENCY_HZ, TIME_S = 2e9, np.linspace(-5e7, 5e7, 24), np.array([0.0, 1.0])
NODES = {"a": [-3.1, 0.4, 1.7], "b": [6.2, 5.3, 1.1], "c": [7.3, -2.2, 2.6]}
MADE = {"ground": "concrete", "fence": "wood", "shed": "brick"}
LINKS = [("a", "b"), ("a", "c"), ("b", "c")]
SIDES = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]
SIDES += [[a, b, c] for a in range(4) for b, c in (((a + 1) % 4, (a + 1) % 4 + 4), ((a + 1) % 4 + 4, a + 4))]
YARD = {
    "ground": [(-9, -9, 0), (12, -9, 0), (12, 9, 0), (-9, 9, 0)],
    "fence": [(-1, -4, 0), (9, -4, 0), (9, -4, 2.2), (-1, -4, 2.2)],
}


def box(low, high, turn_rad: float) -> np.ndarray:
    """Corners (8, 3) at places that no grid of decimals holds."""
    ring = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    corners = np.array([[x, y, z] for z in (low[2], high[2]) for x, y in ring])
    turn = np.array([[np.cos(turn_rad), -np.sin(turn_rad), 0], [np.sin(turn_rad), np.cos(turn_rad), 0], [0, 0, 1]])
    return corners @ turn.T


SHED = box((0.31, 0.17, -0.05), (np.pi, np.e, 2.1234567), 0.2345)


def theirs(diffraction: bool) -> dict:
    flat = {name: np.array(points, float)[[[0, 1, 2], [0, 2, 3]]] for name, points in YARD.items()}
    node = {"speed_m_per_s": 0.0, "antenna": "dipole", "orientation_rad": [0.1, 0.0, 0.0]}
    return new_world() | {
        "objects": {name: {"tris": tris, "surface": None} for name, tris in (flat | {"shed": SHED[SIDES]}).items()},
        "materials": MADE,
        "nodes": {name: node | {"waypoints_m": [at_m]} for name, at_m in NODES.items()},
        "carrier_hz": CARRIER_HZ,
        "bandwidth_hz": 1e8,
        "max_depth": 1,
        "diffraction": diffraction,
    }


def ours() -> World:
    solids = [Solid(name=n, vertices_m=np.array(points, float), faces=[[0, 1, 2], [0, 2, 3]]) for n, points in YARD.items()]
    solids.append(Solid(name="shed", vertices_m=SHED, faces=SIDES))
    media = {name: Medium(material=material) for name, material in MADE.items()}
    mesh = Mesh.of(tuple(solids), np.array(list(NODES.values())))
    told = {"speed_m_per_s": 0.0, "antenna": "dipole", "orientation_rad": (0.1, 0.0, 0.0)}
    radios = {name: Radio(node=Node(name=name, waypoints_m=[at_m], **told)) for name, at_m in NODES.items()}
    surface = surface_of([media[name] for name in mesh.names], CARRIER_HZ)
    return World(mesh=mesh, media=media, surface=surface, radios=radios, carrier_hz=CARRIER_HZ, max_depth=1, diffraction=True)


def heard(clean: np.ndarray, noise: float) -> ResponseEar:
    random = np.random.default_rng(8)
    y = clean + np.sqrt(noise / 2) * (random.normal(size=clean.shape) + 1j * random.normal(size=clean.shape))
    unknown = {"phase": "none", "delay": "none", "gain": "none"}
    told = Heard(links=tuple(LINKS), y=y, weight=np.full(y.shape, 1 / noise), frequency_hz=FREQUENCY_HZ, **unknown)
    return ResponseEar(Predictor(*zip(*LINKS, strict=True), TIME_S, FREQUENCY_HZ), told)


def test_edges_bend_what_another_tracer_bends():
    predictor = Predictor(*zip(*LINKS, strict=True), TIME_S, FREQUENCY_HZ)
    bent = predictor.response(ours()) - predictor.response(replace(ours(), diffraction=False))
    wanted = response(theirs(True), LINKS, TIME_S, FREQUENCY_HZ) - response(theirs(False), LINKS, TIME_S, FREQUENCY_HZ)
    assert (np.abs(wanted) ** 2).sum(axis=(1, 2)).min() > 0
    # Where a ray grazes a face, one takes the angle of the nearer of both rays, the other that of each: some per cent.
    assert (np.abs(bent - wanted) ** 2).sum() < 0.03 * (np.abs(wanted) ** 2).sum()


@pytest.mark.parametrize("gone", [None, "shed"])
def test_an_edge_on_another_things_face_bends_where_that_is_not_there(gone):
    along, up = SHED[1] - SHED[0], SHED[4] - SHED[0]
    sheets = {
        "hatch": np.array([SHED[0] + v * up + u * along for u, v in ((0.2, 0.3), (0.8, 0.3), (0.8, 0.9), (0.2, 0.9))]),
        "awning": np.array([(1.0, -4.0, 0.4), (5.0, -4.0, 0.4), (5.0, -2.8, 2.0), (1.0, -2.8, 2.0)]),  # on the fence
    }
    numbers = {key: values[0] for key, values in surface_of([Medium(material="metal")], CARRIER_HZ).numbers.items()}
    mine, bench = ours(), [theirs(on) for on in (True, False)]
    for name, corners in sheets.items():
        mine = mine.with_object(Solid(name=name, vertices_m=corners, faces=[[0, 1, 2], [0, 2, 3]]), **numbers)
        for one in bench:
            one["objects"][name] = {"tris": corners[[[0, 1, 2], [0, 2, 3]]], "surface": None}
            one["materials"] = one["materials"] | {name: "metal"}
    if gone:
        mine = mine.with_surface(mine.mesh.index(gone), present=False)
        for one in bench:
            del one["objects"][gone]
    predictor = Predictor(*zip(*LINKS, strict=True), TIME_S, FREQUENCY_HZ)
    bent = predictor.response(mine) - predictor.response(replace(mine, diffraction=False))
    whole, plain = (response(one, LINKS, TIME_S, FREQUENCY_HZ) for one in bench)
    assert (np.abs(bent - whole + plain) ** 2).sum() < 0.03 * (np.abs(whole - plain) ** 2).sum()


@pytest.mark.parametrize("share", [0.7, 1.0, 1.4])
def test_how_strongly_edges_bend_is_nobodys_fault(share):
    plain, whole = (response(theirs(on), LINKS, TIME_S, FREQUENCY_HZ) for on in (False, True))
    ear = heard(plain + share * (whole - plain), 0.003 * (np.abs(whole - plain) ** 2).mean())
    left = [evaluated([ear], replace(ours(), diffraction=on), ()) for on in (True, False)]
    above = [(one.whitened - one.offset - ear.count) / np.sqrt(ear.count) for one in left]
    assert above[0] < 4 < 100 < above[1]


@pytest.mark.parametrize("scattering", [0.0, 0.15])
def test_that_edges_could_explain_a_node_elsewhere_is_no_reason_to_let_them_bend(scattering):
    moved = theirs(False)
    moved["nodes"]["b"]["waypoints_m"] = [[6.2, 5.3, 1.14]]
    clean = response(moved, LINKS, TIME_S, FREQUENCY_HZ)
    ears = [heard(clean, 1e-4 * (np.abs(clean) ** 2).mean())]
    field = Effect(family=MissingScattering(), owner="fence", values=np.zeros(0), choice=scattering)
    effects = [field] if scattering else []
    before, bent = (evaluated(ears, replace(ours(), diffraction=on), effects) for on in (False, True))
    assert before.energy - bent.energy > 1e4 and weighing.worth(bent, before, ears[0].count, 1) < 0


def test_what_edges_gain_of_what_another_cause_spoils_speaks_no_louder_against_them_than_for_them():
    plain, whole = (response(theirs(on), LINKS, TIME_S, FREQUENCY_HZ) for on in (False, True))
    spoilt = whole.copy()
    late = np.exp(-2j * np.pi * FREQUENCY_HZ * np.linalg.norm(np.subtract(NODES["b"], NODES["c"])) * 1.2 / 3e8)
    spoilt[LINKS.index(("b", "c"))] += 0.5 * np.abs(whole).max() * late  # an echo that no path of the twin has
    noise = 0.003 * (np.abs(whole - plain) ** 2).mean()
    for clean in (whole, spoilt):
        ears = [heard(clean, noise)]
        before, bent = (evaluated(ears, replace(ours(), diffraction=on), ()) for on in (False, True))
        assert weighing.worth(bent, before, ears[0].count, 1) > 100


@pytest.mark.parametrize("diffraction", [False, True])
def test_a_small_effect_beside_edges_wants_more_than_the_noise_would_have_it(diffraction):
    moved = theirs(diffraction)
    moved["nodes"]["b"]["waypoints_m"] = [[6.2, 5.3, 1.12]]
    still, clean = (response(one, LINKS, TIME_S, FREQUENCY_HZ) for one in (theirs(diffraction), moved))
    ear = heard(clean, (np.abs(clean - still) ** 2).sum() / 32.0)  # nats
    world = replace(ours(), diffraction=diffraction)
    found = search.run([ear], world, {"phase": "none", "delay": "none", "gain": "none"}, 60.0).model
    assert bool(found.effects) == (not diffraction)


def test_what_makes_edges_bend_as_the_theory_has_it_need_not_outdo_how_else_they_might(monkeypatch):
    monkeypatch.setitem(NODES, "b", [5.3, -5.6, 1.6])
    still, clean = (response(theirs(True) | {"refraction": on}, LINKS, TIME_S, FREQUENCY_HZ) for on in (False, True))
    ear = heard(clean, (np.abs(clean - still) ** 2).sum() / 100.0)  # nats
    assert evaluated([ear], ours(), ()).loose[1] > 8
    found = search.run([ear], ours(), {"phase": "none", "delay": "none", "gain": "none"}, 60.0).model
    assert [effect.key for effect in found.effects] == [("missing_transmission", "place")]


@pytest.mark.parametrize(
    ("before", "after", "nats"),
    [((40.0, 35.0), (-1.0, -2.0), 0.0), ((40.0, 10.0), (-1.0, -2.0), 20.0), ((40.0, 35.0), (20.0, 5.0), 30.0)]
    + [((40.0, 35.0), (0.0, 0.0), 30.0), ((-1.0, -2.0), (-1.0, -2.0), 30.0), ((0.0, 0.0), (0.0, 0.0), 0.0)],
)  # fmt: skip
def test_an_effect_beside_edges_needs_less_by_what_they_gained_unless_it_hides_them(before, after, nats):
    """(0, 0): no edge is heard."""
    model, one = (SimpleNamespace(loose=loose, effects=()) for loose in (before, after))
    assert weighing.beside_rough(model, one) == nats


def test_the_edges_of_a_thing_that_stands_elsewhere_are_its_edges_there():
    shed, by_m = Solid(name="shed", vertices_m=SHED, faces=SIDES), np.array([0.31234567, -1.7, 0.05])
    moved = Solid(name="other", vertices_m=SHED + by_m, faces=SIDES)
    here, there = (Mesh.of((solid,), np.zeros((1, 3))).edges for solid in (shed, moved))
    assert np.abs(there.begin_m - by_m - here.begin_m).max() < 1e-8
    for name in ("along", "length_m", "face", "normal", "n"):
        assert np.abs(getattr(there, name) - getattr(here, name)).max() < 1e-8
