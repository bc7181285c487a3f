# SPDX-License-Identifier: GPL-3.0-or-later
"""A board behind a fence, which no link sees, or another like it: what stands before the fence, nobody can tell."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gr_cast.diagnose.places import elsewhere, run
from gr_cast.diagnose.places.budget import Budget
from gr_cast.diagnose.places.ears import ResponseEar
from gr_cast.diagnose.places.fit import evaluated, fitted
from gr_cast.diagnose.places.search import Found
from gr_cast.scenario.create.fields import surface_of
from gr_cast.scenario.create.geometry import Solid
from gr_cast.scenario.create.media import Medium
from gr_cast.twin.places.families.base import Effect
from gr_cast.twin.places.families.objects import ObjectMoved
from gr_cast.twin.places.predict import Predictor
from gr_cast.twin.places.world import Mesh, Radio

sys.path.insert(0, str(Path(__file__).parent))
from test_place_edges import CARRIER_HZ, MADE, NODES, SIDES, heard, ours

SHIFT_M = 1.43
BEHIND = {"e": [-1.0, -6.0, 1.5], "f": [10.0, -6.0, 1.5]}  # of the fence, to either side of a board that is thick


def _yard(is_fenced: bool):
    """The yard with a board 0.6 m behind its fence; without the fence some links see it."""
    world = replace(ours(), diffraction=False)
    fence, board = (
        Solid(name=name, vertices_m=np.array([(a, y, 0.1), (b, y, 0.1), (b, y, 4.0), (a, y, 4.0)]), faces=[[0, 1, 2], [0, 2, 3]])
        for name, a, b, y in (("fence", -3.0, 12.0, -4.0), ("board", 0.5, 8.5, -4.6))
    )
    solids = [fence if solid.name == "fence" else solid for solid in world.mesh.solids]
    mesh = Mesh.of((*solids, board), np.array(list(NODES.values())))
    media = {**world.media, "board": Medium(material="glass")}
    surface = surface_of([media[name] for name in mesh.names], CARRIER_HZ)
    world = replace(world, mesh=mesh, media=media, surface=surface)
    return world if is_fenced else world.with_surface([mesh.index("fence")], present=False)


def _sounded(world, shift_m: float):
    moved = replace(world, mesh=world.mesh.moved("board", np.array([0.0, shift_m, 0.0])))
    there, here = (heard(np.zeros(1), 1.0).predictor.response(one) for one in (moved, world))
    return [heard(there, 0.002 * (np.abs(there - here) ** 2).mean())]


def _moved(shift_m: float) -> Effect:
    return Effect(family=ObjectMoved(), owner="board", values=np.array([shift_m]), choice=(0.0, 1.0, 0.0))


def test_what_seems_new_is_looked_for_among_what_no_link_sees():
    world = _yard(True)
    ears = _sounded(world, SHIFT_M)
    rest = evaluated(ears, world, ())
    assert elsewhere.hidden(rest, ears) == ["board"]
    best, *others = elsewhere.moves(ears, rest, Budget.of(60.0))
    assert others and all(one.choice != best.choice or abs(one.values[0] - best.values[0]) > 0.01 for one in others)
    assert best.owner == "board" and best.values[0] * best.choice[1] == pytest.approx(SHIFT_M, abs=0.02)
    assert fitted(ears, evaluated(ears, world, (best,))).energy < 1.2 * ears[0].count < 0.2 * rest.energy


@pytest.mark.parametrize(
    "is_fenced, shift_m, families", [(True, SHIFT_M, {"object_moved", "missing_object"}), (False, -SHIFT_M, {"object_moved"})]
)
def test_an_object_from_where_no_link_looks_may_as_well_be_new(is_fenced, shift_m, families):
    world = _yard(is_fenced)
    ears = _sounded(world, shift_m)
    model = evaluated(ears, world, (_moved(shift_m),))
    found = Found(model=model, start=model, rivals={}, tried=1, count=ears[0].count, spent=False)
    assert {name for name, *_ in run._alike(found, 0, ears, (), world)} == families
    both = elsewhere.one_more(ears, world, model.effects, 0)
    assert set(both.mesh.names) == {*MADE, "board", "new_board"}


def test_an_object_a_hand_from_its_place_is_no_second_one():
    world = _yard(True)
    assert elsewhere.one_more(_sounded(world, SHIFT_M), world, (_moved(0.1),), 0) is None


def _thick(world):
    """The yard with a board that is 3 m thick."""
    board = world.mesh.solids[world.mesh.index("board")]
    deep = replace(board, vertices_m=np.vstack([board.vertices_m, board.vertices_m - [0.0, 3.0, 0.0]]), faces=SIDES)
    solids = [deep if solid is board else solid for solid in world.mesh.solids]
    return replace(world, mesh=Mesh.of(tuple(solids), np.array(list(NODES.values()))))


@pytest.mark.parametrize("is_fenced", [True, False])
def test_of_an_object_that_no_link_saw_nobody_knows_whether_a_new_one_would_stand_in_it(is_fenced):
    world = _yard(is_fenced)
    both = elsewhere.one_more(_sounded(world, SHIFT_M), _thick(world), (_moved(0.9),), 0)
    assert (both is not None) == is_fenced


def test_a_vault_that_is_blocked_by_either_does_not_tell_a_moved_object_from_a_new_one_in_it():
    world = _thick(_yard(True))
    told = world.radios["a"].node
    behind = {name: replace(told, name=name, waypoints_m=np.array([at_m])) for name, at_m in BEHIND.items()}
    world = replace(world, radios=world.radios | {name: Radio(node=node) for name, node in behind.items()})
    model = evaluated(ears := _sounded(world, 0.9), world, (_moved(0.9),))
    link, frequency_hz = tuple(BEHIND), ears[0].heard.frequency_hz
    predictor = Predictor(link[:1], link[1:], np.zeros(1), frequency_hz)
    gone = world.with_surface([world.mesh.index("board")], present=False)
    past = np.abs(predictor.response(gone)).mean()
    y = predictor.response(model.world)
    heard = replace(ears[0].heard, links=(link,), y=y, weight=np.full(y.shape, 1e4 / past**2))
    vault = [ResponseEar(predictor, heard)]
    assert elsewhere.apart_nats(vault, world, gone) > 100  # the vault looks at its old place
    found = Found(model=model, start=model, rivals={}, tried=1, count=ears[0].count, spent=False)
    assert {name for name, *_ in run._alike(found, 0, ears, vault, world)} == {"object_moved", "missing_object"}
