# SPDX-License-Identifier: GPL-3.0-or-later
"""From a case on disk to its diagnosis, and from the corrected twin to nothing left: received power alone."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from gr_cast.diagnose import places
from gr_cast.diagnose.places import policy
from gr_cast.twin.places import document

SPEC = """cast_create: 1
id: place
environment: {place: a yard, carrier_hz: 2.0e9, bandwidth_hz: 2.0e7}
model: {mesh: mesh.obj}
materials: {wall: concrete}
nodes:
  a: {position_m: [0, 0, 5]}
  c: {position_m: [25, 3, 6]}
  d: {position_m: [-8, 20, 4]}
  b: {position_m: [12, 0, 5]}
  e: {position_m: [6, 14, 5]}
sampling: {duration_s: 10, step_s: 0.1, max_depth: 0}
"""
PLACE = """cast_place: 1
twin: {twin}
soundings:
- {{file: first.npz, kind: power}}
- {{file: second.npz, kind: power, use: vault}}
unknown: {{phase: none, delay: none, gain: common}}
"""
FIXED = {"a": [0.0, 0, 5], "c": [25.0, 3, 6], "d": [-8.0, 20, 4], "e": [6.0, 14, 5]}


def _powers(path, seed, lossy_db, silent):
    """Friis, with a link that loses more and others that are not heard; b goes round."""
    random, turn = np.random.default_rng(seed), np.linspace(seed, seed + 2, 24)
    way_m = {"b": np.stack([12 * np.cos(turn), 9 * np.sin(turn), 5 + 0 * turn], 1)}
    way_m |= {name: np.tile(at, (24, 1)) for name, at in FIXED.items()}
    links = [(tx, rx) for tx in "acd" for rx in "be" if (tx, rx) not in silent]
    far_m = np.stack([np.linalg.norm(way_m[tx] - way_m[rx], axis=1) for tx, rx in links])
    power_db = 20 * np.log10(299792458.0 / 2e9 / (4 * np.pi * far_m)) + 1.3 + random.normal(0, 0.5, far_m.shape)
    power_db[links.index(("c", "b"))] -= lossy_db
    tx, rx = (np.array(side) for side in zip(*links, strict=True))
    told = {"time_s": np.linspace(0, 9, 24), "power_db": power_db, "std_db": np.full(len(links), 0.5)}
    np.savez(path, tx=tx, rx=rx, position_b=way_m["b"], **told)


def yard(folder, lossy_db=4.0, silent=()):
    folder.mkdir()
    (folder / "spec.yaml").write_text(SPEC)
    (folder / "place.yaml").write_text(PLACE.format(twin="spec.yaml"))
    corners = "v 0 0 -90\nv 1 0 -90\nv 1 1 -90\nv 0 1 -90\n"
    (folder / "mesh.obj").write_text(f"o wall\n{corners}f 1 2 3\nf 1 3 4\n")
    for seed, name in enumerate(("first.npz", "second.npz")):
        _powers(folder / name, seed, lossy_db, silent)
    return folder


def test_a_lossy_link_is_named_and_the_corrected_twin_misses_nothing(tmp_path):
    case = yard(tmp_path / "yard")
    found = places.diagnose(document.read(case))
    effect = found.document["effects"][0]
    assert found.document["verdict"] == "identified" and len(found.document["effects"]) == 1
    assert effect["family"] == "excess_loss" and effect["owner"]["name"] == "c>b" and "c>b" in effect["where"]["links"]
    loss = effect["parameters"]["loss_db"]
    assert abs(loss["value"] - 4.0) < 4 * loss["std"] < 1.0
    fit = found.document["fit"]
    assert fit["corrected_rmse_db"] < 1.15 * fit["noise_rmse_db"] < fit["twin_rmse_db"]

    corrected = tmp_path / "corrected"
    pieces = replace(found, model=replace(found.model, effects=2 * found.model.effects))  # of one cause, which is told once
    places.write(pieces, tmp_path / "pieces", "a page")
    places.write(found, corrected, "a page")
    assert (tmp_path / "pieces" / "spec_corrected.yaml").read_text() == (corrected / "spec_corrected.yaml").read_text()
    for name in ("first.npz", "second.npz"):
        shutil.copy(case / name, corrected / name)
    (corrected / "place.yaml").write_text(PLACE.format(twin="spec_corrected.yaml"))
    again = places.diagnose(document.read(corrected))
    assert again.document["verdict"] == "no_mismatch" and again.document["effects"] == []


def test_what_is_likelier_wrong_than_right_is_neither_claimed_nor_corrected_but_told(tmp_path, monkeypatch):
    monkeypatch.setattr(policy, "LEAST_SURE", 1.0)  # nothing is so sure
    found = places.diagnose(document.read(yard(tmp_path / "yard")))
    told, fit = found.document, found.document["fit"]
    assert told["effects"] == [] and told["verdict"] == "unexplained" and not found.model.effects
    assert any("c>b" in one and one.startswith("Not claimed") for one in told["warnings"])
    assert fit["corrected_rmse_db"] == fit["twin_rmse_db"]


@pytest.mark.parametrize(("taken_nats", "verdict"), [(policy.TAKEN_NATS, "unexplained"), (1e9, "no_mismatch")])
def test_what_something_explained_that_is_not_claimed_is_there(tmp_path, monkeypatch, taken_nats, verdict):
    monkeypatch.setattr(policy, "LEAST_SURE", 1.0)
    monkeypatch.setattr(policy, "CLEAN_DEVIATIONS", 1e9)  # of all that is left nothing is seen
    monkeypatch.setattr(policy, "TAKEN_NATS", taken_nats)
    told = places.diagnose(document.read(yard(tmp_path / "yard"))).document
    assert told["effects"] == [] and told["verdict"] == verdict


def test_two_that_explain_alike_are_told_however_little_each_is_sure(tmp_path, monkeypatch):
    monkeypatch.setattr(policy, "LEAST_SURE", 1.0)
    told = places.diagnose(document.read(yard(tmp_path / "yard", silent=[("c", "e")]))).document  # c has one link
    assert told["verdict"] == "ambiguous" and len(told["effects"]) == 1
    assert {"excess_loss", "node_gain"} in [set(one["families"]) for one in told["ambiguous"]]


def test_powers_where_the_twin_has_no_path_accuse_nobody_and_are_told(tmp_path):
    case = yard(tmp_path / "yard", lossy_db=0.0)
    corners = "v 20 -90 -90\nv 20 90 -90\nv 20 90 90\nv 20 -90 90\n"  # between c and all others
    (case / "mesh.obj").write_text(f"o wall\n{corners}f 1 2 3\nf 1 3 4\n")
    found = places.diagnose(document.read(case)).document
    assert found["verdict"] == "unexplained" and found["effects"] == []
    assert found["warnings"] == ["48 of 144 powers were read where the twin has no path: they are not explained, and left out."]
