# SPDX-License-Identifier: GPL-3.0-or-later
"""The program as it is typed: what it refuses in a line per fault, what it does where boxes cannot be, what its documents say."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))
import team as teams
from gr_cast.colosseum import host, job, storage, timeline, updates
from gr_cast.colosseum.traffic import read, script
from gr_cast.core.errors import CastError
from gr_cast.report.colosseum_page import page

ROOT = Path(__file__).resolve().parents[2]


def colosseum(*words, path: str | None = None) -> subprocess.CompletedProcess:
    environment = os.environ | ({} if path is None else {"PATH": path})
    return subprocess.run(
        [sys.executable, str(ROOT / "apps/cast_colosseum.py"), *map(str, words)], capture_output=True, text=True, env=environment
    )


def test_validate_names_the_faults_of_a_job_and_of_its_images_at_once(tmp_path):
    team = teams.make(tmp_path)
    teams.write_image(team / "images" / "good.tar.gz", teams.radio_api(start="#!/bin/sh\nsleep 360\n"))
    (team / "batch" / "job.json").write_text(json.dumps(teams.job_document() | {"Duration": "long"}))
    done = colosseum("validate", team / "batch" / "job.json")
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.splitlines() == [
        f"error: {team}/batch/job.json: Duration: got 'long', needs an integer of 1 to 604800 (seconds)",
        "error: good.tar.gz: /root/radio_api/start.sh:2: blocks: sleep 360; limit 5 s: end it with &, or be done sooner",
    ]


def test_without_root_or_lxc_each_missing_thing_is_a_line_and_jobs_are_still_checked(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(CastError) as refused:
        host.check_host()
    told = "\n".join(refused.value.faults)
    assert "got no root" in told and "lxc-start: not installed (Debian: apt install lxc)" in told
    team = teams.make(tmp_path)
    assert colosseum("validate", team / "batch" / "job.json", path=str(tmp_path)).returncode == 0
    refused = colosseum("run", team / "batch" / "job.json", "--output", tmp_path / "out", path=str(tmp_path))
    assert refused.returncode == 2 and "lxc" in refused.stderr and not (tmp_path / "out").exists()


def test_up_without_a_team_where_there_is_none_names_the_option(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    line = f"error: --team: not given, and {tmp_path} is no team's storage, which has batch, config and images\n"
    assert colosseum("image", "list").stderr == line
    done = colosseum("up", "--srns", 1)
    assert done.returncode == 2 and (done.stderr == line or "error: box: " in done.stderr)  # the machine comes first


def test_what_a_job_file_has_wrong_is_named_once_and_in_its_own_words(tmp_path):
    team = teams.make(tmp_path)
    for value, words in (
        ("NaN", "got nan, needs"),
        ("1" + "0" * 30, "whole number of 100 bits"),
        ("null", "got null, needs an integer"),
    ):
        text = json.dumps(teams.job_document()).replace('"Duration": 60', f'"Duration": {value}')
        (team / "batch" / "job.json").write_text(text)
        (line,) = colosseum("validate", team / "batch" / "job.json").stderr.splitlines()
        assert "Duration: " in line and words in line
    (team / "batch" / "job.json").write_text(text.replace("null", "9" * 10_000))
    (line,) = colosseum("validate", team / "batch" / "job.json").stderr.splitlines()
    assert "limit (4300 digits)" in line and "sys." not in line


def test_the_example_of_the_documents_is_a_job_without_a_fault(tmp_path):
    example = ROOT / "docs/examples/colosseum/team"
    team = tmp_path / "team"
    subprocess.run(["cp", "-r", str(example), str(team)], check=True)
    teams.write_image(team / "images" / "cast.tar.gz", teams.radio_api())
    taken = job.read(team / "batch" / "sound_90003.json", storage.Storage(folder=team))
    assert (taken.rf_scenario, len(taken.nodes)) == (90003, 4)


def test_profiles_and_scale_are_those_of_the_documentation():
    for name, ready_s, start_s in (("current", 300, 480), ("older", 600, 780)):
        clock = timeline.Clock(profile=timeline.PROFILES[name], scale=1, duration_s=100)
        assert (clock.ready_s(), clock.start_s, clock.stop_s()) == ((ready_s, ready_s), start_s - ready_s, (120, 120))
        fast = timeline.Clock(profile=timeline.PROFILES[name], scale=60, duration_s=600)
        assert (fast.ready_s()[0], fast.run_s) == (ready_s / 60, 10)


def test_mgen_listens_at_a_flows_id_and_a_dummy_packet_goes_ahead(tmp_path):
    traffic = read(storage.shipped_traffic() / "1.yaml", 10.0)
    address = {"1": "192.168.101.2", "2": "192.168.102.2"}
    lines = script(traffic, "1", address, 15.0).splitlines()
    assert lines[0] == "0.0 LISTEN UDP 5002"
    assert lines[1].startswith("0.1 ON 60000 UDP") and lines[1].endswith("DST 192.168.102.2/5001 PERIODIC [1 256] COUNT 1")
    assert lines[2] == "15 ON 5001 UDP SRC 5001 DST 192.168.102.2/5001 PERIODIC [20 256]" and lines[3] == "25 OFF 5001"


def test_updates_are_read_strictly(tmp_path):
    good = [{"at_s": 5, "environment": {"collab_network_type": "INTERNET"}}, {"at_s": 2, "mandated_outcomes": []}]
    (tmp_path / "u.json").write_text(json.dumps(good))
    assert [u.file for u in updates.read(tmp_path / "u.json", 10)] == ["mandated_outcomes.json", "environment.json"]
    wrong = [{"at_s": 50}, {"at_s": 1, "environment": {"x": 1}}, {"at_s": 1, "mandated_outcomes": [{"goal_type": "T"}]}]
    (tmp_path / "u.json").write_text(json.dumps(wrong))
    with pytest.raises(CastError) as refused:
        updates.read(tmp_path / "u.json", 10)
    told = str(refused.value)
    assert all(words in told for words in ("[0].at_s", "needs one of", "unknown key 'x'", "flow_uid is missing"))


def test_the_page_shows_what_scripts_print_as_text():
    call = {"at_s": 1.0, "script": "start.sh", "seconds": 0.1, "status": None, "printed": "<script>x</script>", "errors": "",
            "faults": ["took more than 5 s: ended"]}  # fmt: skip
    node = {"host": "t-srn001", "rf_node": 1, "traffic_node": 1, "image": "i", "image_sha256": "0" * 64,
            "disk_bytes": 0, "logs": [], "states": [{"at_s": 0.5, "state": "READY", "info": "<b>"}], "calls": [call]}  # fmt: skip
    text = page(
        {"job": "<j>", "outcome": "played", "seconds": 9.0, "rf_scenario": 1009, "traffic_scenario": 0, "duration_s": 5,
         "profile": "current", "time_scale": 60.0, "channel": {"base_loss_db": 57.55, "rate_hz": 1e6}, "faults": ["a < b"],
         "events": [{"at_s": 0.0, "event": "begin"}], "nodes": [node], "emulator": None, "traffic": []}
    )  # fmt: skip
    assert text.count('<rect class="READY"') == 2  # the node's, and the legend's
    assert "<script>" not in text and "&lt;script&gt;" in text and "<b>" not in text and "a &lt; b" in text and "<j>" not in text


def test_a_team_without_images_is_told_what_makes_one(tmp_path):
    (tmp_path / "team").mkdir()
    told = colosseum("image", "list", "--team", tmp_path / "team").stdout
    assert told.startswith("none yet: ") and f"image build {tmp_path / 'team' / 'images' / 'cast.tar.gz'} makes" in told
