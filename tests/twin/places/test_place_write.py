# SPDX-License-Identifier: GPL-3.0-or-later
"""A corrected place is read back as it was written."""

from dataclasses import replace

import numpy as np
import place_case
import pytest
import yaml
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError
from gr_cast.scenario.create import materials, model, spec
from gr_cast.scenario.create.geometry import Solid
from gr_cast.scenario.create.media import Medium
from gr_cast.twin.places import correct, document, write
from gr_cast.twin.places.believed import believed

EFFECTS = (
    {
        "family": "node_gain", "owner": {"level": "node", "name": "a"}, "confidence": np.float64(0.97),
        "sentence": "Its cable: −3 dB.",
        "parameters": {"error_db": {"value": np.float32(-3.0), "std": 0.1}}, "where": {"links": ["a>b"], "position_m": None},
    },
    {
        "family": "moving_scatterer", "owner": {"level": "place", "name": "place"}, "confidence": 0.9, "sentence": "x",
        "parameters": {"position_m": {"value": np.array([1.0, 2.0, 0.0]), "std": [0.1, 0.1, 1]}},
    },
)  # fmt: skip


def read(path):
    made = spec.read(path)
    return made, materials.assign(model.read(made)[0], made.materials, made.carrier_hz)


def same(some, others):
    assert [solid.name for solid in some] == [solid.name for solid in others]
    for one, other in zip(some, others, strict=True):
        assert one.medium == other.medium
        np.testing.assert_array_equal(one.vertices_m[one.faces], other.vertices_m[other.faces])


def test_a_corrected_place_is_read_back_as_it_was_written(tmp_path):
    place = document.read(place_case.write(tmp_path / "case"))
    panel = Solid(
        name="found wall [1]", vertices_m=np.array([[1 / 3, 2, 0], [4, 2, 0], [4, np.pi, 1e-7]]), faces=[[0, 1, 2]],
        medium=Medium(own_permittivity=1 / 7 + 3, own_conductivity_s_per_m=1e-3, height_rms_m=0.002),
    )  # fmt: skip
    solids = [replace(place.solids[0], medium=Medium(material="wood")), place.solids[1], panel]
    nodes = tuple(replace(node, waypoints_m=node.waypoints_m + 0.1) for node in place.spec.nodes)
    corrected = replace(place.spec, nodes=nodes, max_depth=2, diffraction=True)
    path = write.write_spec(tmp_path, write.document(corrected), solids, EFFECTS)
    assert path == tmp_path / "spec_corrected.yaml"
    back, objects = read(path)
    same(objects, solids)
    for one, other in zip(back.nodes, corrected.nodes, strict=True):
        np.testing.assert_array_equal(one.waypoints_m, other.waypoints_m)
        assert {k: v for k, v in vars(one).items() if k != "waypoints_m"} == {
            k: v for k, v in vars(other).items() if k != "waypoints_m"
        }
    fixed = (
        "id",
        "carrier_hz",
        "bandwidth_hz",
        "duration_s",
        "step_s",
        "max_depth",
        "diffraction",
        "refraction",
        "rays",
        "method",
    )
    assert [getattr(back, key) for key in fixed] == [getattr(corrected, key) for key in fixed]
    assert [entry["parameters"] for entry in back.effects] == [{"error_db": -3.0}, {"position_m": (1.0, 2.0, 0.0)}]
    assert yaml.safe_load(path.read_text())["effects"][0]["sentence"] == "Its cable: −3 dB."


@pytest.mark.parametrize(
    ("name", "corrected"),
    [
        ("room", "room-corrected"),
        ("room-corrected", "room-corrected-2"),
        ("room-corrected-9", "room-corrected-10"),
        ("r" * 64, "r" * 54 + "-corrected"),
    ],
)
def test_a_corrected_place_stands_beside_its_twin_in_a_catalogue(tmp_path, name, corrected):
    place = document.read(place_case.write(tmp_path / "case", spec=place_case.SPEC.replace("id: room", f"id: {name}")))
    made = correct.corrected_spec(place.spec, believed(place))
    assert read(write.write_spec(tmp_path, write.document(made), place.solids, ()))[0].id == corrected


def test_the_twins_own_document_may_be_written_too(tmp_path):
    place = document.read(place_case.write(tmp_path / "case"))
    own = yaml.safe_load(place_case.SPEC)
    back, objects = read(write.write_spec(tmp_path, own, place.solids, ()))
    same(objects, place.solids)
    assert back.effects == () and [node.name for node in back.nodes] == ["a", "b", "c"]


def test_a_street_from_a_map_is_written_in_metres(tmp_path):
    street, solids = read(sc.examples_folder() / "street.yaml")
    back, objects = read(write.write_spec(tmp_path, write.document(street), solids, ()))
    same(objects, solids)
    assert [node.power_dbm for node in back.nodes] == [43, 23, 23]


def test_what_a_mesh_cannot_hold_is_refused_and_nothing_is_written(tmp_path):
    place = document.read(place_case.write(tmp_path / "case"))
    floor = place.solids[0]
    wrong = [floor, floor, replace(floor, name="a # b"), replace(floor, name="bare", medium=None)]
    with pytest.raises(CastError) as error:
        write.write_spec(tmp_path, yaml.safe_load(place_case.SPEC), wrong, ())
    assert len(error.value.faults) == 3 and not list(tmp_path.glob("spec_corrected*"))
