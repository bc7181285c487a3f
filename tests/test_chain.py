# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of the chain: every command as it stands there, each fed with what the one before it wrote.

The place is traced by mirror images: the ray tracer need not be installed."""

import importlib
import json
import os
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from gr_cast.scenario.create import pipeline

DOCS = Path(__file__).resolve().parents[1] / "docs"
C_M_PER_S = 299_792_458.0
WALL_M = 103.8601


def reflected() -> float:
    """Share of the amplitude that 10 cm of P.2040's concrete reflect at 2.4 GHz, the field along the wall (Fresnel, a slab)."""
    eta = 5.24 - 1j * 0.0462 * 2.4**0.7822 / (2 * np.pi * 2.4e9 * 8.8541878128e-12)
    cos_in = WALL_M / np.hypot(WALL_M, 15)
    root = np.sqrt(eta - (1 - cos_in**2))
    once, thick = (cos_in - root) / (cos_in + root), np.exp(-4j * np.pi * 0.1 * 2.4e9 / C_M_PER_S * root)
    return float(abs(once * (1 - thick) / (1 - once**2 * thick)))


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """The folder in which every command of the page was typed."""
    folder = tmp_path_factory.mktemp("chain")
    shutil.copytree(DOCS / "examples/chain", folder, dirs_exist_ok=True)
    blocks = re.findall(r"```sh\n(.*?)```", (DOCS / "chain.md").read_text(), re.S)
    before, tasks_run = os.getcwd(), pipeline.tasks.run
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAST_CATALOGUE", str(folder / "catalogue"))
        patch.setenv("CAST_RAYTRACER", str(folder / "none"))
        patch.setattr(pipeline.tasks, "run", lambda *work, **about: tasks_run(*work, **about | {"processes": 1}))
        os.chdir(folder)
        try:
            for line in (line for block in blocks[1:] for line in block.splitlines()):
                program, *arguments = shlex.split(line, comments=True)
                assert not importlib.import_module(program.removesuffix(".py")).main(arguments), line
        finally:
            os.chdir(before)
    return folder


def of(path):
    return json.loads(path.read_text())


def test_the_twin_lacks_the_echo_of_the_wall_and_nothing_else(walked):
    compared = of(walked / "compared/comparison.json")
    assert [tap["delay_s"] - 100e-9 for tap in compared["only_a"]] == pytest.approx([600e-9], abs=1e-9)
    assert compared["only_b"] == [] and len(compared["taps"]) == 1


def test_the_diagnosis_names_the_echo_with_its_delay(walked):
    found = of(walked / "diagnosis/case/diagnosis.json")
    assert found["verdict"] == "identified" and [e["family"] for e in found["effects"]] == ["extra_path"]
    assert found["effects"][0]["parameters"]["delay_s"]["value"] == pytest.approx(700e-9, abs=1e-9)


def test_the_corrected_scenario_is_what_was_sounded(walked):
    again = of(walked / "compared-again/comparison.json")
    assert again["only_a"] == again["only_b"] == [] and len(again["taps"]) == 2
    assert max(abs(tap["gain_error_db"]) for tap in again["taps"]) < 0.3
    assert max(abs(tap["delay_error_s"]) for tap in again["taps"]) < 1e-9


def test_colosseum_gets_both_taps_and_the_maps(walked):
    taps = scipy.io.loadmat(walked / "corrected.mat", struct_as_record=False, squeeze_me=True)["chMatrix"][0, 1, 0]
    used = np.abs(taps.iq) > 1e-3
    assert sorted(taps.delay[used]) == pytest.approx([100e-9, 700e-9], abs=5e-9)
    wanted = reflected() * 30 / (30 + 600e-9 * C_M_PER_S)  # longer way, and what the wall reflects
    assert np.abs(taps.iq[used]).min() / np.abs(taps.iq[used]).max() == pytest.approx(wanted, rel=0.03)
    assert of(walked / "radio.json") == {
        "Node 1": {"SRN": 12, "RadioA": 1, "RadioB": 2},
        "Node 2": {"SRN": 45, "RadioA": 1, "RadioB": 2},
    }
    assert of(walked / "node.json") == {"1": 12, "2": 45}
