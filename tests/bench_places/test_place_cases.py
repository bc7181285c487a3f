# SPDX-License-Identifier: GPL-3.0-or-later
"""Laws of the bank of place cases: what a user has obeys the contract, and the sealed world predicts it to the noise."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from gr_cast.twin.places import document

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench" / "places"))

import cases
import grade
import recompute
import world as worlds

import build

PLACES = Path(cases.__file__).parent
SEED = 4


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    """One case with a cause, one without, one of power, one undecidable."""
    folder = tmp_path_factory.mktemp("bank")
    counts = ["--cases", "1", "--nulls", "1", "--power", "1", "--ambiguous", "1", "--seed", str(SEED)]
    subprocess.run(["/usr/bin/python3", str(PLACES / "build.py"), *counts, "--output", str(folder)], check=True, timeout=200)
    return [(json.loads(p.read_text()), folder / "places" / p.stem) for p in sorted((folder / "truth").glob("*.json"))]


def _soundings(case):
    place = yaml.safe_load((case / "place.yaml").read_text())
    for s in place["soundings"]:
        with np.load(case / s["file"]) as z:
            yield s, dict(z), place["unknown"]


def test_a_case_obeys_the_contract(bank):
    for truth, case in bank:
        document.read(case)  # the project's strict reader finds no fault
        spec = yaml.safe_load((case / "spec.yaml").read_text())
        assert spec["cast_create"] == 1 and (case / spec["model"]["mesh"]).exists()
        assert truth["conditions"]["max_depth"] == spec["sampling"]["max_depth"]
        drawn = set(re.findall(r"^o (\S+)", (case / "mesh.obj").read_text(), re.M))
        assert drawn == set(spec["materials"])
        kinds = [s["kind"] for s, _, _ in _soundings(case)]
        assert [s.get("use") for s, _, _ in _soundings(case)] == [None, "vault"]
        assert set(kinds) == ({"power"} if truth["kind"] == "power" else {"response"})
        for s, z, unknown in _soundings(case):
            assert unknown["phase"] in ("none", "link", "snapshot") and unknown["gain"] in ("none", "common", "node")
            assert set(z["tx"]) | set(z["rx"]) <= set(spec["nodes"]) and (np.diff(z["time_s"]) > 0).all()
            links, instants = len(z["tx"]), len(z["time_s"])
            if s["kind"] == "power":
                assert z["power_db"].shape == (links, instants) and z["std_db"].shape == (links,)
                continue
            assert z["response"].dtype == np.complex64 and z["response"].shape == (links, instants, len(z["frequency_hz"]))
            assert z["noise_power"].shape == (links,) and np.allclose(np.diff(z["frequency_hz"], 2), 0, atol=1e-3)


def test_nothing_that_a_user_has_tells_the_truth(bank):
    for truth, case in bank:
        shown = "".join((case / name).read_text() for name in ("place.yaml", "spec.yaml", "mesh.obj"))
        telling = ("truth", "seed", "added", "missing", "moved", "extra", "rough", "offset", "single", "double", "null")
        assert not any(word in shown for word in telling)
        if truth["kind"] in ("single", "double", "triple"):
            w, twin = recompute.world_from(truth["world"]), worlds.read_spec(case / "spec.yaml")
            for e in truth["effects"]:
                if e["family"] == "missing_object":
                    assert set(w["objects"]) > set(twin["objects"])


def test_the_sealed_world_predicts_the_soundings_to_the_noise_and_the_twin_does_not(bank):
    for truth, case in bank:
        for sealed in [truth["world"]] if "world" in truth else truth.get("hypotheses", []):
            w, twin = recompute.world_from(sealed), worlds.read_spec(case / "spec.yaml")
            for s, z, unknown in _soundings(case):
                links, y = list(zip(z["tx"].tolist(), z["rx"].tolist(), strict=True)), z["response"].astype(complex)
                left = [
                    worlds.excess(
                        worlds.response(x, links, z["time_s"], z["frequency_hz"]),
                        y,
                        z["noise_power"],
                        links,
                        z["frequency_hz"],
                        unknown,
                    )[0]
                    for x in (w, twin)
                ]
                count = np.isfinite(y).sum()
                assert abs(left[0] / count - 1) < 5 / np.sqrt(count)
                if truth["effects"] and "use" not in s:
                    strength = max(e["lambda"] for e in truth["effects"])
                    assert truth["kind"] == "triple" or left[1] - left[0] > 0.3 * strength


def test_a_spec_read_again_is_the_twin_that_was_drawn(bank):
    for truth, case in bank:
        if truth["kind"] == "null":
            w, twin = recompute.world_from(truth["world"]), worlds.read_spec(case / "spec.yaml")
            s, z, unknown = next(_soundings(case))
            links = list(zip(z["tx"].tolist(), z["rx"].tolist(), strict=True))
            a, b = (worlds.response(x, links, z["time_s"], z["frequency_hz"]) for x in (w, twin))
            assert worlds.excess(a, b, z["noise_power"], links, z["frequency_hz"], unknown)[0] < 1


def test_a_claimed_cause_is_no_other_single_familys(bank):
    for truth, _ in bank:
        for e in truth["effects"] if truth["kind"] in ("single", "double", "triple") else []:
            assert e["margin_nats"] >= max(cases.MARGIN, cases.SHARE * e["lambda"]) and e["lambda"] >= 49


def test_undecidable_is_undecidable_and_a_place_that_tells_is_there(bank):
    truth, case = next(x for x in bank if x[0]["kind"] == "ambiguous")
    assert truth["ambiguous"]["gap_nats"] <= 0.5 and truth["ambiguous"]["best_nats"] >= 20
    assert recompute.separation(truth, case, "calibrate_gain", ["calibrate_gain"]) == 10


def test_the_truth_said_back_scores_full_marks_and_silence_none(bank, tmp_path):
    truths = tmp_path / "truth"
    truths.mkdir()
    for truth, _ in bank:
        if truth["kind"] in ("ambiguous", "power"):
            continue
        (truths / f"{truth['case']}.json").write_text(json.dumps(truth))
        effects = [
            {"family": e["family"], "owner": e["owner"], "confidence": 0.99, "parameters": e["parameters"]}
            for e in truth["effects"]
        ]
        verdict = "identified" if effects else "no_mismatch"
        folder = tmp_path / "said" / truth["case"]
        folder.mkdir(parents=True)
        (folder / "diagnosis.json").write_text(json.dumps({"verdict": verdict, "effects": effects, "ambiguous": []}))
    said, silent = (grade.grade(tmp_path / name, truths) for name in ("said", "nothing"))
    assert {k: v[:2] for k, v in said["families"].items() if v[0] != v[1]} == {}
    assert {row[0] for row in silent["failures"]} == {p.stem for p in truths.glob("*.json")}


@pytest.mark.parametrize("family", ["ground", "node_delay", "track_timing"])
def test_what_no_key_of_a_spec_holds_is_played_as_the_diagnosis_tells_it(family, tmp_path):
    name, _ = build.make("single", 3, family, tmp_path)
    truth, case = json.loads((tmp_path / "truth" / f"{name}.json").read_text()), tmp_path / "places" / name
    shutil.copy(case / "spec.yaml", case / "spec_corrected.yaml")
    effects = [e for e in truth["effects"] if e["family"] == family]
    assert recompute.excess_removed(truth, case, case, {"effects": effects}) > 0.99
    assert recompute.excess_removed(truth, case, case, {"effects": []}) < 0.01
