# SPDX-License-Identifier: GPL-3.0-or-later
"""pipeline.yaml and inventories: what is wrong is named with its place, all at once."""

import shutil
from pathlib import Path

import pytest
from gr_cast.core.documents import yaml_file, yaml_text
from gr_cast.core.errors import CastError
from gr_cast.pipeline import document, site

STACK = Path(__file__).resolve().parents[2] / "docs" / "examples" / "stack"

# Where → what stands there, and how the fault begins.
WRONG = {
    "name": ("a/b", "name: got 'a/b', needs a name"),
    "cast_pipeline": (7, "cast_pipeline: got 7, needs 1"),
    "nobody": (1, "unknown key 'nobody'"),
    "sample_rate_hz": ("fast", "sample_rate_hz: got 'fast', needs a finite number of Hz"),
    "build": ("make", "build: got 'make', needs a list"),
    "test": ([None], "test[0]: got null, needs text"),
    "image": (["../bin"], "image[0]: got '../bin', needs a name inside the folder"),
    "sites": (["twin", "twin"], "sites: two are named 'twin'"),
    "environment": ({"system": "debian-12", "packages": [3.5]}, "environment: compiler is missing"),
    "experiments[0].scenario": ("nowhere.yaml", "experiments[0].scenario: nowhere.yaml"),
    "experiments[0].nodes": (
        {"1": {"transmit": "x"}, "9": {"receive": "y"}},
        "experiments[0].nodes: got '9', the scenario has 1, 2",
    ),
    "experiments[0].repeats": (1, "experiments[0].repeats: got 1, needs a whole number of repeats in 2 to 1000"),
    "experiments[0].duration_s": (-1, "experiments[0].duration_s: got -1, needs a finite number of s"),
    "experiments[0].traffic": ("flows/none.yaml", "experiments[0].traffic: "),
    "experiments[1].name": ("short frames", "experiments: two are named 'short frames'"),
    "experiments[1].nodes": ({"1": {"transmit": "x"}, "2": {}}, "experiments[1].nodes.2: needs transmit, receive or both"),
    "limits": ({"command_s": 0, "test_s": 5}, "limits.command_s: got 0"),
    "metrics": ({"loss": {"tolerance": -1, "better": "smaller"}}, "metrics.loss.tolerance: got -1"),
}


@pytest.fixture
def folder(tmp_path):
    return shutil.copytree(STACK, tmp_path / "stack")


def changed(folder: Path, changes: dict) -> Path:
    told = yaml_file(STACK / document.FILE).document
    for place, value in changes.items():
        box = told
        if place.startswith("experiments["):
            box, place = told["experiments"][int(place[12])], place[15:]
        box[place] = value
    (folder / document.FILE).write_text(yaml_text(told))
    return folder


def test_the_shipped_pipeline_and_its_sites_are_read(folder):
    pipeline = document.read(folder)
    sites, faults = site.read_all(folder / "sites", pipeline, folder)
    assert [one.name for one in sites] == ["twin", "testbed"] and not faults
    assert pipeline.metrics["loss"].tolerance == 0.1 and pipeline.metrics[document.RESIDUAL].better == "neither"


@pytest.mark.parametrize("place", WRONG)
def test_a_fault_is_named_with_its_place(folder, place):
    value, said = WRONG[place]
    with pytest.raises(CastError) as error:
        document.read(changed(folder, {place: value}))
    assert any(said in fault for fault in error.value.faults), error.value


def test_all_faults_of_a_pipeline_come_at_once(folder):
    apart = {place: value for place, (value, _) in WRONG.items() if place not in ("experiments[1].name", "experiments[0].nodes")}
    with pytest.raises(CastError) as error:
        document.read(changed(folder, apart))
    missed = [place for place in apart if not any(WRONG[place][1] in fault for fault in error.value.faults)]
    assert missed == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("cast_site: 1\n", "needs noise_power_db (the embedded emulator), or a program"),
        ("cast_site: 1\nprogram: x\nnoise_power_db: -3\n", "program: noise_power_db and effects are the embedded emulator's"),
        ("cast_site: 1\nnoise_power_db: loud\n", "noise_power_db: got 'loud', needs a finite number of dB"),
        ("cast_site: 1\nnoise_power_db: 1\nnodes: {a: {port: 1}}\n", "nodes.a: unknown key 'port', knows device, interface"),
        (
            "cast_site: 1\nnoise_power_db: 1\neffects: [{family: magic, owner: {}, parameters: {}}]\n",
            "effects[0].family: got 'magic'",
        ),
    ],
)
def test_a_fault_of_an_inventory_is_named(folder, text, said):
    (folder / "sites" / "testbed.yaml").write_text(text)
    _, faults = site.read_all(folder / "sites", document.read(folder), folder)
    assert any(said in fault for fault in faults) and all("testbed.yaml" in fault for fault in faults), faults
