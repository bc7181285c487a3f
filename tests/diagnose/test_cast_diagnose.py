# SPDX-License-Identifier: GPL-3.0-or-later
"""The program: files of the contract, refusals, the same answer for any number of jobs."""

import filecmp
import json
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import place_case
import pytest
import yaml
from gr_cast.core.errors import CastError
from gr_cast.diagnose import places
from gr_cast.diagnose import policy as links
from gr_cast.diagnose.write import check_replaceable
from gr_cast.signals import recording

from tests.diagnose.places.test_place_again import yard

sys.path.append(str(Path(__file__).resolve().parents[2] / "docs"))
import effect_schemas

PROGRAM = Path(__file__).resolve().parents[2] / "apps" / "cast_diagnose.py"
FILES = ["diagnosis.json", "report.html", "residual.npz", "twin_corrected.yaml"]


def call(*arguments):
    return subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, timeout=300)


def test_the_help_states_the_budgets_that_hold():
    assert f"(default {links.BUDGET_S:g}, of a place {places.BUDGET_S:g})" in " ".join(call("--help").stdout.split())


@pytest.fixture
def case(world, tmp_path):
    echo = 0.3 * 0.1 * world.path(30)
    return world.write(tmp_path / "cases" / "echo", world.noisy(world.clean() + echo))


def test_a_diagnosis_is_a_whole_folder_and_its_twin_carries_the_effects(case, tmp_path):
    done = call(case, "--output", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "out" / "echo"
    assert sorted(p.name for p in folder.iterdir()) == FILES
    document = json.loads((folder / "diagnosis.json").read_text())
    twin = yaml.safe_load((folder / "twin_corrected.yaml").read_text())
    assert document["cast_diagnosis"] == 1 and document["verdict"] == "identified"
    assert [e["family"] for e in twin["effects"]] == [e["family"] for e in document["effects"]]
    assert twin["effects"][0]["parameters"] == document["effects"][0]["parameters"]


def test_a_case_is_never_replaced_by_its_diagnosis(case, tmp_path):
    shutil.copytree(case, tmp_path / "before")
    done = call(case, "--output", case.parent)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1 and f"{case}: would be replaced, and it holds recording.sigmf-data" in done.stderr
    same = filecmp.dircmp(case, tmp_path / "before")
    assert same.same_files and not same.diff_files + same.left_only + same.right_only


@pytest.mark.parametrize("others", ["notes.txt", "notes/mine.txt", "field_trip.sigmf-data", "case/twin.yaml"])
def test_what_lies_beside_a_diagnosis_is_never_lost(case, tmp_path, others):
    folder = tmp_path / "out" / "echo"
    (folder / others).parent.mkdir(parents=True)
    (folder / "diagnosis.json").write_text("{}")
    (folder / others).write_text("mine")
    with pytest.raises(CastError, match=f"echo: would be replaced, and it holds {others}, of no diagnosis"):
        check_replaceable(folder)
    (folder / others).unlink()
    check_replaceable(folder)


def test_a_diagnosis_with_its_waveforms_is_replaced_by_the_next(case, tmp_path):
    twin = yaml.safe_load((case / "twin.yaml").read_text())
    recording.write(case / "sent", np.tile([1, -1, 1j], 85).repeat(2), sample_rate_hz=1e6)
    twin["waveforms"]["w2"] = {"file": "sent"}
    (case / "twin.yaml").write_text(yaml.safe_dump(twin))
    for _ in range(2):
        assert call(case, "--output", tmp_path / "out", "--budget", 20).returncode == 0
    assert (tmp_path / "out" / "echo" / "sent.sigmf-data").exists()


def test_a_diagnosis_is_what_its_schema_says(case, tmp_path):
    jsonschema = pytest.importorskip("jsonschema", reason="NO JSONSCHEMA: a diagnosis is not held against its schema")
    assert call(case, "--output", tmp_path / "out").returncode == 0
    document = json.loads((tmp_path / "out" / "echo" / "diagnosis.json").read_text())
    check = jsonschema.Draft202012Validator(effect_schemas.diagnosis())
    assert document["effects"] and not list(check.iter_errors(document))
    assert list(check.iter_errors(document | {"verdict": "guilty"}))


def test_every_fault_of_a_case_is_told_at_once_and_the_others_go_on(case, tmp_path):
    broken = tmp_path / "cases" / "broken"
    broken.mkdir()
    twin = yaml.safe_load((case / "twin.yaml").read_text())
    twin["smaple_rate_hz"] = 1
    twin["nodes"]["tx1"]["transmit"] = "w7"
    twin["links"][0]["taps"][0]["delay_s"] = "late"
    (broken / "twin.yaml").write_text(yaml.safe_dump(twin))
    done = call(broken, case, "--output", tmp_path / "out")
    assert done.returncode == 2
    assert all(word in done.stderr for word in ("smaple_rate_hz", "'w7'", "'late'", "recording.sigmf-meta"))
    assert len(done.stderr.splitlines()) >= 4
    assert not (tmp_path / "out" / "broken").exists() and (tmp_path / "out" / "echo" / "diagnosis.json").exists()


@pytest.mark.parametrize("content", ["", "[]", "cast_twin: 2", "a: [", "cast_twin: 1\nrecordings: 3\n", "x: &a [*a]"])
def test_a_broken_twin_is_refused_in_lines_and_without_a_trace(content, tmp_path):
    case = tmp_path / "case"
    case.mkdir()
    (case / "twin.yaml").write_text(content)
    done = call(case, "--output", tmp_path / "out")
    assert done.returncode == 2 and "error:" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_ctrl_c_leaves_finished_cases_whole_and_of_the_others_nothing(case, world, tmp_path):
    for k in range(3):
        turn = np.exp(2j * np.pi * 7.0 * (k + 1) * world.n / 1e6)
        world.write(tmp_path / "cases" / f"next{k}", world.noisy(world.clean() * turn + 0.02))
    others = sorted((tmp_path / "cases").glob("next*"))
    out = tmp_path / "out"
    process = subprocess.Popen(
        [PROGRAM, case, *others, "--output", out], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline().startswith("[1/4] echo: identified")
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and errors.strip().splitlines()[-1] == "interrupted"
    left = sorted(p.name for p in out.iterdir())
    assert left[0] == "echo" and len(left) < 4 and not [name for name in left if name.startswith(".")]
    assert all(sorted(p.name for p in (out / name).iterdir()) == FILES for name in left)


def test_jobs_change_nothing_but_the_time(case, tmp_path):
    place, texts = yard(tmp_path / "cases" / "yard", lossy_db=0.0), []
    for jobs in (1, 2):
        out = tmp_path / f"out{jobs}"
        assert call(case, place, "--output", out, "--jobs", jobs).returncode == 0
        documents = [json.loads((out / name / "diagnosis.json").read_text()) for name in ("echo", "yard")]
        texts.append([{key: value for key, value in one.items() if key != "seconds"} for one in documents])
    assert texts[0] == texts[1]
    assert [len(one["effects"]) for one in texts[0]] == [1, 0]


def test_the_corrected_twin_leaves_nothing_to_find_in_a_second_recording(case, world, tmp_path):
    assert call(case, "--output", tmp_path / "out").returncode == 0
    second = world.write(tmp_path / "cases" / "second", world.noisy(world.clean() + 0.3 * 0.1 * world.path(30)))
    (second / "twin.yaml").write_text((tmp_path / "out" / "echo" / "twin_corrected.yaml").read_text())
    assert call(second, "--output", tmp_path / "out").returncode == 0
    assert json.loads((tmp_path / "out" / "second" / "diagnosis.json").read_text())["verdict"] == "no_mismatch"
    assert np.load(tmp_path / "out" / "second" / "residual.npz").files


def test_a_link_that_its_time_did_not_hold_says_so_on_the_screen(case, tmp_path):
    done = call(case, "--output", tmp_path / "out", "--budget", 0.2)
    assert "    Out of time after 0.2 s: a larger --budget may find more.\n" in done.stdout
    assert json.loads((tmp_path / "out" / "echo" / "diagnosis.json").read_text())["residual"]["out_of_time"] is True


def test_a_slip_of_units_is_on_the_screen_before_the_search(tmp_path):
    told = place_case.response()
    told["frequency_hz"] = told["frequency_hz"] / 1e6
    folder = place_case.write(tmp_path / "room", monday=told)
    done = call(folder, "--output", tmp_path / "out", "--budget", 5)
    first, *rest = done.stdout.splitlines()
    assert first.startswith("room: ") and first.endswith("is it in kHz or MHz?") and rest[-1]
    assert "MHz" not in "".join(rest)  # and once only
    document = json.loads((tmp_path / "out" / "room" / "diagnosis.json").read_text())
    assert any(first.endswith(line) for line in document["warnings"])


@pytest.mark.parametrize("rate", [".nan", "-1e6", "'100M'", None])
def test_a_sample_rate_that_is_refused_is_held_against_no_recording(rate, case, tmp_path):
    text = (case / "twin.yaml").read_text()
    (case / "twin.yaml").write_text(re.sub("sample_rate_hz: .*\n", f"sample_rate_hz: {rate}\n" if rate else "", text))
    done = call(case, "--output", tmp_path / "out")
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2 and "sample_rate_hz" in line and "the twin says" not in line
