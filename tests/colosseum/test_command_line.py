# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line of Colosseum, unmodified, at our socket: needs its sources (CAST_COLOSSEUMCLI, or ../stacks/colosseumcli)
and a Python that has cliff."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))
import client
import team as teams
from gr_cast.colosseum import clisocket, desk, world
from gr_cast.colosseum.storage import Storage


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """Runs a command of the unmodified client against a box's desk of three SRNs; gives what it prints."""
    base = tmp_path_factory.mktemp("cli")
    team = teams.make(base)
    words_before, environment = client.prepared(base)
    here = world.world_of(Storage(folder=team), 3)
    state = {"desk": desk.Desk()}

    def answer(srn, request):
        now = time.time()
        state["desk"], _ = desk.passed(here, state["desk"], now)
        state["desk"], reply, _ = desk.answered(here, state["desk"], request, srn, now)
        return reply

    def run(*words, cwd=base) -> str:
        command = [*words_before, "-m", "colosseum_cli.cli_app", *words]
        done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment, timeout=60)
        return done.stdout + done.stderr

    with clisocket.Server({1: base / "socket" / "clisocket"}, answer):
        yield run
    client.tidied()


def test_it_lists_scenarios_and_nodes(command):
    listed = command("rf", "scenario", "list")
    assert ["90003", "Channel", "sounding", "test", "3", "5", "1000000000.0", "True"] in [
        row.replace("|", " ").split() for row in listed.splitlines()
    ]
    assert command("rf", "scenario", "nodelist", "90003").count("NODE") == 5
    assert "description" in command("tg", "scenario", "list").lower()


def test_it_starts_informs_maps_and_stops(command, tmp_path):
    radio_map = {f"Node {n}": "None" for n in range(1, 6)} | {"Node 2": {"SRN": 3, "RadioA": 1, "RadioB": 2}}
    (tmp_path / "map.json").write_text(json.dumps(radio_map))
    assert "Scenario Start Time is" in command("rf", "start", "90003", "-c", "-m", str(tmp_path / "map.json"))
    assert "stop it first" in command("rf", "start", "1009")
    info = command("rf", "info")
    assert "90003" in info and "True" in info and "| 5 " in info
    rows = [row.replace("|", " ").split() for row in command("rf", "radiomap").splitlines()]
    assert ["Node", "2", "3", "1", "2"] in rows and ["Node", "1", "None", "0", "0"] in rows
    assert "successfully sent" in command("rf", "stop")
    time.sleep(desk.CLEAR_S + 0.1)
    assert "CLEARED" in command("rf", "info")


def test_a_map_that_leaves_nodes_out_is_refused_with_a_message(command, tmp_path):
    (tmp_path / "map.json").write_text(json.dumps({"Node 1": {"SRN": 77, "RadioA": 1, "RadioB": 2}}))
    told = command("rf", "start", "90003", "-m", str(tmp_path / "map.json"))
    assert "failed to schedule" in told and "Node 2: missing" in told and "SRN: got 77" in told


def test_traffic_snapshots_and_radios_answer(command):
    assert "No traffic" in command("tg", "info") or "Scenario id" in command("tg", "info")
    assert "Traffic Scenario 1 started" in command("tg", "start", "1")
    assert "SCHEDULED" in command("tg", "info") and "| 2 " in command("tg", "nodemap")
    assert "Traffic Scenario Stopped" in command("tg", "stop")
    assert "taking mine.tar.gz" in command("snapshot", "mine")
    assert "has an image of that name" in command("snapshot", "mine")
    assert "IDLE" in command("usrp", "info") and "IDLE" in command("usrp", "flash", "-f", "x.bit")
    assert "not running" in command("gps", "info")
