# SPDX-License-Identifier: GPL-3.0-or-later
"""Colosseum's own command line, unmodified, inside the containers of a box: random sequences of commands lead where the model of
the documentation says, by the machine's own clock."""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
import zmq
from hypothesis import Phase
from hypothesis import strategies as st
from hypothesis.stateful import invariant, rule

sys.path.append(str(Path(__file__).parent))
import client
import team as teams
from documented import MALFORMED, SRNS, Documented, play, words_of
from gr_cast.colosseum import box, desk

COLOSSEUM = [sys.executable, str(Path(__file__).resolve().parents[2] / "apps/cast_colosseum.py")]
SEQUENCES = int(os.environ.get("CAST_SEQUENCES", 4))  # 500 by hand
NUMBERS = {7: 90003, 8: 90001}  # the model's scenarios among the catalogue's: all of them play until they are stopped
MODEL = {str(number): n for n, number in NUMBERS.items()}
SAID = {"rf_scenario_start": NUMBERS, "tgen_start": {2: 77}}  # 2 is none of the model's
SCALE = 60  # traffic begins two seconds after its start, as scenarios do
AFTER_S = {"SCHEDULED": desk.LEAD_S, "STOPPING": desk.CLEAR_S}
NEXT = {"SCHEDULED": "ACTIVE", "STOPPING": "CLEARED"}
PATIENCE_S = 60.0  # on a machine that does other things too
CLIENT_SLEEPS_S = 1.0  # after a start was taken
LONGEST = 65536


class Box:
    """A reservation with a client in every container, and what its emulator plays."""

    def __init__(self, folder: Path):
        self.team = teams.make(folder)
        teams.write_system(self.team / "images" / "python.tar", teams.radio_api() | teams.python())
        client.put_on_share(self.team / "client")
        self.clients: list[client.Client] = []

    def __enter__(self):
        words = ["up", "--srns", SRNS, "--scenario", 90003, "--image", "python", "--team", self.team, "--name", "inside"]
        self._colosseum(*words, "--time-scale", SCALE)
        self.folder = box.boxes()["inside"]
        for srn in range(1, SRNS + 1):
            words = [*COLOSSEUM, "enter", "inside", f"team-srn{srn:03d}", "/usr/bin/python3", "/share/nas/team/client/many.py"]
            self.clients.append(client.Client(words))
        return self

    def __exit__(self, *_):
        for one in self.clients:
            one.close()
        self._colosseum("down", "inside")

    def _colosseum(self, *words):
        done = subprocess.run([*COLOSSEUM, *map(str, words)], capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr

    def run(self, srn: int, *words: str) -> str:
        status, told = self.clients[srn - 1].run(*words)
        assert status == 0 and "Traceback" not in told and "ERROR" not in told, (words, told)
        return told

    def rows(self, srn: int, *words: str):
        """What the client tells in a table."""
        told = self.run(srn, *words, "-f", "json")
        return json.loads(told[re.search(r"^[\[{]", told, re.MULTILINE).start() :])

    @property
    def plays(self) -> bool:
        with zmq.Context() as context, context.socket(zmq.REQ) as asking:
            asking.setsockopt(zmq.LINGER, 0)
            asking.connect(f"ipc://{self.folder}/emulator/control")
            asking.send_json({"command": "status"})
            assert asking.poll(int(1000 * PATIENCE_S))
            return asking.recv_json()["status"]["scenario"] != "cleared"


def told_by(of: Box, request: dict, words: list[str], srn: int) -> dict:
    """The reply that the client was given, as far as it tells."""
    if words == ["rf", "info"]:
        info = of.rows(srn, *words)
        if not info["scenario_id"]:
            return {"status": 200, "data": "{}"}
        ends = {
            row["Node"]: "None" if row["SRN"] == "None" else {key: row[key] for key in ("SRN", "RadioA", "RadioB")}
            for row in of.rows(srn, "rf", "radiomap")
        }
        assert int(info["Number of Nodes"]) == len(ends) == 5
        data = info | {"scenario_id": MODEL[info["scenario_id"]], "srn_radio_mapping": ends}
        return {"status": 200, "data": json.dumps(data)}
    if words == ["tg", "info"]:
        info = of.rows(srn, *words)
        told = {"scenario_id": int(info["Scenario id"]), "status": info["Status"]} if info["Status"] else None
        return {"status": 200, "data": told}
    if "list" in words:
        rows = of.rows(srn, *words)
        known = {row["Scenario ID"] for row in rows}
        assert known >= ({90001, 90003, 1009} if words[0] == "rf" else {0, 1, 2})
        return {"status": 200}
    told = of.run(srn, *words)
    if "start" in words:
        is_taken = re.search("^(Scenario Start Time is|Traffic Scenario .* started)", told)
        assert is_taken or "failed to" in told
        return {"status": {"rf": 100, "tg": 200}[words[0]]} if is_taken else {"status": 400, "message": told}
    assert {"rf": "successfully sent", "tg": "Stopped", "usrp": "IDLE", "gps": "GPS"}[words[0]] in told
    return {"status": 200}


def machine(of: Box) -> type[Documented]:
    class Inside(Documented):
        """The model's commands by the client in a container; nothing happens sooner than documented, and all of it in the end."""

        nodes = dict.fromkeys(NUMBERS, 5)

        def __init__(self):
            super().__init__()
            for words in (("rf", "stop"), ("tg", "stop")):
                of.run(1, *words)
            while (info := of.rows(1, "rf", "info"))["scenario_status"] != "CLEARED":
                time.sleep(0.05)
            self.rf = [MODEL[info["scenario_id"]], "CLEARED", time.time(), info["scenario_cycle"]]

        def ask(self, request, srn=1):
            number = request.get("scenario_id") if isinstance(request, dict) else None
            if type(number) is int and (known := SAID.get(str(request.get("command")))):
                request = request | {"scenario_id": known.get(number, number)}
            self.now = time.time()
            words = words_of(request, of.team, Path("/share/nas/team"))
            one = of.clients[srn - 1]
            reply = told_by(of, request, words, srn) if words else one.send(json.dumps(request).encode())
            assert one.longest <= LONGEST
            is_taken = bool(words) and words[:2] == ["rf", "start"] and reply["status"] == desk.QUEUED
            self.follow(reply, words or [], time.time() - is_taken * CLIENT_SLEEPS_S)
            return reply

        def follow(self, reply, words, heard_s):
            """What the clock may have brought since, where a reply tells it that was given by `heard_s`; never sooner than
            documented."""
            kind = words[0] if words else None
            if reply["status"] == 400:
                told = re.search(r"(rf|tgen)_(?:scenario_)?start: .*scenario \d+ is (\w+): stop it first", reply["message"])
                kind, status = (told[1][:2], told[2]) if told else (None, None)
            elif words[1:] == ["info"] and kind in ("rf", "tg"):
                data = json.loads(reply["data"]) if kind == "rf" else reply["data"]
                status = data and data.get("scenario_status", data.get("status"))
            else:
                status = "CLEARED" if words[:2] == ["rf", "start"] else None
            state = {"rf": self.rf, "tg": self.traffic}.get(kind)
            if state and state[1] in NEXT and status == NEXT[state[1]]:
                assert heard_s >= state[2] + AFTER_S[state[1]], (state, status)
                state[1:3] = [status, self.now]

        def wait(self, seconds):
            time.sleep(min(seconds / 2, 2.2))
            until_s = time.time() + PATIENCE_S
            for state, words in ((self.rf, ("rf", "info")), (self.traffic, ("tg", "info"))):
                while state and state[1] in NEXT and time.time() >= state[2] + AFTER_S[state[1]]:
                    assert time.time() < until_s, f"still {state[1]}"
                    self.ask({"version": "3.0", "command": {"rf": "rf_scenario_info", "tg": "tgen_info"}[words[0]]})

        @rule(which=st.integers(0, len(MALFORMED) - 1), srn=st.integers(1, SRNS))
        def hears_what_is_malformed(self, which, srn):
            parts, words = MALFORMED[which]
            reply = of.clients[srn - 1].send(*parts)
            assert reply["status"] == 400 and words in reply["message"]
            assert of.clients[srn - 1].longest <= LONGEST

        @invariant()
        def nothing_passes_between_scenarios(self):
            plays, status = of.plays, self.rf[1]
            is_due = status == "SCHEDULED" and time.time() >= self.rf[2] + desk.LEAD_S
            assert plays == (status == "ACTIVE") or is_due

    return Inside


@pytest.mark.timeout(600 + 30 * SEQUENCES)
def test_random_sequences_of_commands_from_inside_the_containers_follow_the_documented_states(boxes):
    with Box(boxes) as made:
        assert "90003" in made.run(2, "rf", "info")  # that `up` began it
        play(machine(made), SEQUENCES, 12, phases=[Phase.generate])  # the clock goes on: no sequence can be played again
        print(f"longest reply: {max(one.longest for one in made.clients)} bytes")
