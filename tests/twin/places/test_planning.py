# SPDX-License-Identifier: GPL-3.0-or-later
"""Laws of planning where to sound: what no path touches is told, positions only add, and slopes are those of another tracer."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.report.place import planning as pages
from gr_cast.scenario.create import materials, model, spec
from gr_cast.twin.places import planning
from gr_cast.twin.places.planning import Wanted

sys.path.insert(0, str(Path(__file__).parents[2] / "bench" / "places"))
sys.path.insert(0, str(Path(__file__).parents[3] / "apps"))
import cast_scenario
from causes import shifted, with_node
from world import read_spec, response

SPEC = """\
cast_create: 1
id: yard
environment: {place: a yard, carrier_hz: 3.0e9, bandwidth_hz: 2.0e8}
model: {mesh: yard.obj}
materials: {"*": metal}
nodes:
  a: {position_m: [0, 0, 2]}
  b: {position_m: [6, 1, 2]}
sampling: {max_depth: 1}
"""
WALLS = {  # two corners along the ground, 5 m high: a mirror 2 m wide, a screen, and a wall in its shadow
    "mirror": ((2.0, 8.0), (4.0, 8.0)),
    "screen": ((-3.0, -4.0), (9.0, -4.0)),
    "north": ((-1.0, -6.0), (7.0, -6.0)),
}
CAMPAIGN = Wanted(links=("a>b",), region_m=(1, 1, 11, 3), height_m=2.0, step_m=1.0, count=1)


@pytest.fixture
def yard(tmp_path):
    lines, count = [], 0
    for name, ((x0, y0), (x1, y1)) in WALLS.items():
        lines += [f"o {name}", *(f"v {x} {y} {z}" for x, y, z in ((x0, y0, 0), (x1, y1, 0), (x1, y1, 5), (x0, y0, 5)))]
        lines.append(f"f {count + 1} {count + 2} {count + 3} {count + 4}")
        count += 4
    (tmp_path / "yard.obj").write_text("\n".join(lines) + "\n")
    (tmp_path / "yard.yaml").write_text(SPEC)
    return tmp_path / "yard.yaml"


def planned(path, **changes):
    made = spec.read(path)
    solids = materials.assign(model.read(made)[0], made.materials, made.carrier_hz)
    return planning.of_spec(made, solids, Wanted(**{**vars(CAMPAIGN), **changes}))


def lights(place, anchor, wall) -> bool:
    """Whether the mirror image of an anchor is seen through a wall along x, by hand."""
    (x0, y), (x1, _) = wall
    image = np.array([anchor[0], 2 * y - anchor[1]])
    share = (y - place[1]) / (image[1] - place[1])
    return x0 <= place[0] + share * (image[0] - place[0]) <= x1


def test_a_wall_that_no_path_touches_is_listed_as_unseen(yard):
    _, _, _, plan = planned(yard)
    shaded, dark = pages.unseen(plan, 0)
    assert dark == ["north"] and shaded == []
    assert any("no path of the campaign is reflected by: north" in line for line in pages.table(plan, True))


def test_a_position_chosen_for_a_wall_alone_is_one_that_lights_it(yard):
    _, _, _, plan = planned(yard, links=(), anchors=("a",), region_m=(-4, 1, 14, 3))
    able = {tuple(p[:2]): lights(p, (0.0, 0.0), WALLS["mirror"]) for p in plan.grid_m}
    assert any(able.values()) and not all(able.values())
    assert able[tuple(plan.positions_m[0][:2])]
    assert plan.sights[1].lit >= {"mirror"}


def test_positions_only_add_and_each_adds_less_than_the_one_before(yard):
    _, _, _, plan = planned(yard, count=6)
    for before, after in zip(plan.sights, plan.sights[1:], strict=False):
        more = np.linalg.eigvalsh(after.information - before.information)
        assert more.min() >= -1e-9 * more.max()
        assert before.lit <= after.lit
    assert (np.diff(plan.gains_nats) <= 1e-9).all() and min(plan.gains_nats) > 0
    stages = np.array([plan.deviations(k) for k in range(7)])
    assert (np.diff(stages, axis=0) <= 1e-12).all()
    assert len({tuple(p) for p in plan.positions_m}) == 6


def slope(path, changed, small):
    """Of the response of a>b, by differences of the bench's tracer."""
    world, f = read_spec(path), 2e8 * ((np.arange(planning.TONES) + 0.5) / planning.TONES - 0.5)
    high, low = (response(changed(world, s * small), [("a", "b")], [0.0], f)[0, 0] for s in (0.5, -0.5))
    return (high - low) / small


@pytest.mark.parametrize(
    ("level", "name", "axis", "changed"),
    [
        ("object", "mirror", (0.0, 1.0, 0.0), lambda w, x: shifted(w, "mirror", [0, x, 0])),
        ("node", "b", (1.0, 0.0, 0.0), lambda w, x: with_node(w, "b", offset_m=[x, 0, 0])),
    ],
)
def test_slopes_are_those_of_another_tracer(yard, level, name, axis, changed):
    """With nothing unknown, the information of one number is 2|dH|²/noise."""
    world, links, anchors, plan = planned(yard, unknown=())
    place = next(
        k
        for k, n in enumerate(plan.numbers)
        if (n.level, n.name) == (level, name) and n.axis and np.allclose(np.abs(n.axis), axis)
    )
    theirs = 2 / plan.noise_power * (np.abs(slope(yard, changed, 1e-5)) ** 2).sum()
    assert plan.sights[0].information[place, place] == pytest.approx(theirs, rel=0.02)


def test_what_nobody_knows_of_a_link_tells_nothing(yard):
    """A single path of unknown phase, delay and gain says nothing of any place."""
    h = np.exp(-2j * np.pi * 1e-8 * np.linspace(-1e8, 1e8, 32))
    columns = np.stack([1j * h, 1j * np.linspace(-1, 1, 32) * h, h])
    known = planning.fisher(columns, h, np.linspace(-1e8, 1e8, 32), (), 1.0)
    unknown = planning.fisher(columns, h, np.linspace(-1e8, 1e8, 32), planning.UNKNOWN, 1.0)
    assert np.linalg.eigvalsh(known).min() > 1
    assert np.abs(unknown).max() < 1e-9


def test_every_fault_is_told_at_once(yard):
    wrong = {
        "links": ("a>c", "a>a"),
        "anchors": ("z",),
        "region_m": (3, 0, 1, 5),
        "step_m": 0.0,
        "count": 0,
        "snr_db": float("nan"),
    }
    with pytest.raises(CastError) as error:
        planned(yard, **wrong)
    told = "\n".join(error.value.faults)
    for name in ("'a>c'", "'a>a'", "'z'", "--region", "--step", "--positions", "--snr"):
        assert name in told
    with pytest.raises(CastError, match="--region"):
        planned(yard, region_m=(0.01, 0.01, 0.02, 0.02), step_m=0.01)
    with pytest.raises(CastError, match="limit"):
        planned(yard, region_m=(0, 0, 1000, 1000), step_m=0.1)


def test_the_program_writes_table_document_and_picture(yard, tmp_path, capsys):
    picture, file = tmp_path / "plan.png", tmp_path / "plan.json"
    argv = ["plan", str(yard), "--link", "a>b", "--region", "1", "1", "11", "3", "--positions", "2"]
    assert cast_scenario.main([*argv, "--json", str(file), "--plot", str(picture)]) == 0
    told, made = capsys.readouterr().out, json.loads(file.read_text())
    assert "north" in told and made["cast_plan"] == 1 and made["campaign"]["unseen"] == ["north"]
    assert len(made["positions"]) == 2 and made["unreachable"] == ["north"]
    assert picture.read_bytes()[:4] == b"\x89PNG"


def test_the_tracer_of_the_plan_is_that_of_the_diagnosis(yard):
    """The noise of a plan is so much below the median of what the bench's tracer hears."""
    _, _, _, plan = planned(yard, anchors=("a",), links=(), snr_db=20.0)
    world, f = read_spec(yard), 2e8 * ((np.arange(planning.TONES) + 0.5) / planning.TONES - 0.5)
    powers = []
    for place in plan.grid_m:
        w = with_node(world, "b", waypoints_m=[place.tolist()])
        powers.append((np.abs(response(w, [("b", "a")], [0.0], f)) ** 2).mean())
    assert plan.noise_power == pytest.approx(np.median(powers) / 100, rel=1e-4)
