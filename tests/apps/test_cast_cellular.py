# SPDX-License-Identifier: GPL-3.0-or-later
"""The cellular program from the command line: what it writes, refuses, and keeps."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from gr_cast import series

PROGRAM = Path(__file__).resolve().parents[2] / "apps/cast_cellular.py"


def run(*arguments):
    return subprocess.run(
        [sys.executable, str(PROGRAM), *map(str, arguments)], capture_output=True, text=True, timeout=200, check=False
    )


def test_one_command_writes_table_picture_series_and_json(tmp_path):
    done = run("--output", tmp_path, "--duration", 1, "--blocks", 15)
    assert done.returncode == 0, done.stderr
    assert "modelled" in done.stdout
    assert (tmp_path / "cellular.png").read_bytes().startswith(b"\x89PNG")
    document = json.loads((tmp_path / "cellular.json").read_text())
    assert document["modelled"] is True
    assert document["complete"] is True
    assert {row["terminal"] for row in document["terminals"]} == {"s2", "s5", "m1"}
    assert len(document["similarity"]) == 9
    for name in document["series"]:
        assert series.read(name).value.size == 10


def test_a_scenario_of_the_catalogue_is_played_instead(tmp_path):
    done = run("--output", tmp_path, "--duration", 0.3, "--scenario", 1009, "--cells", "1:2,3", "--blocks", 6)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "series/sinr_db_2.csv").is_file()


@pytest.mark.parametrize(
    "arguments",
    [("--cells", "99:1"), ("--scenario", "nowhere"), ("--blocks", "7"), ("--step", "0.5", "--duration", "0.1"),
     ("--offered", "nan"), ("--noise-figure-db", "nan")],
)  # fmt: skip
def test_bad_arguments_leave_a_line_and_nothing_written(tmp_path, arguments):
    done = run("--output", tmp_path / "out", *arguments)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert not (tmp_path / "out").exists()


def test_what_was_sounded_before_an_interrupt_stays(tmp_path):
    with subprocess.Popen(
        [sys.executable, str(PROGRAM), "--output", str(tmp_path), "--blocks", "6", "--full"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        end = time.monotonic() + 60
        while "s sounded" not in process.stderr.read(20) and time.monotonic() < end:
            pass
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
    assert process.returncode == 130
    document = json.loads((tmp_path / "cellular.json").read_text())
    assert document["complete"] is False
    assert all(len(Path(name).read_text().splitlines()) >= 2 for name in document["series"])
