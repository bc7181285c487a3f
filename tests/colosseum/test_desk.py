# SPDX-License-Identifier: GPL-3.0-or-later
"""Random sequences of commands, time and nonsense lead where a small model of the documentation says, in replies of 64 kB."""

import json
import os
import random
import socket
import sys
import threading
import time
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))
import client
from documented import MALFORMED, WORLD, Documented, asked, play, words_of
from gr_cast.colosseum import clisocket, desk
from gr_cast.colosseum.desk import Desk, RfScenario, World

SEQUENCES = int(os.environ.get("CAST_SEQUENCES", 200))  # 500 and more by hand


@pytest.mark.timeout(600 + SEQUENCES)
def test_random_sequences_of_commands_follow_the_documented_states():
    play(Documented, SEQUENCES, 25)


@pytest.mark.timeout(600 + SEQUENCES)
def test_the_unmodified_client_tells_of_random_sequences_what_the_documented_states_are(tmp_path_factory):
    base = tmp_path_factory.mktemp("client")
    here = {}

    class ThroughTheClient(Documented):
        """What the client can say goes through it and its socket; it must tell what was answered."""

        def ask(self, request, srn=1):
            words = words_of(request, base)
            if words is None:
                return super().ask(request, srn)
            here["answer"], here["replies"] = super().ask, []
            status, told = commands.run(*words)
            reply = here["replies"][0]
            assert status == 0 and "Traceback" not in told and "ERROR" not in told, (words, told)
            if reply["status"] == 400 and words[1] == "start":
                assert "failed to" in told and reply["message"] in told
            elif words[:2] == ["rf", "start"]:
                assert "Scenario Start Time is" in told
            elif words == ["rf", "info"] and self.rf:
                assert self.rf[1] in told and str(self.rf[0]) in told
            elif words == ["tg", "info"] and self.traffic:
                assert self.traffic[1] in told
            return reply

    def answer(srn, request):
        here["replies"].append(here["answer"](request, srn))
        return here["replies"][-1]

    commands = client.shut_in(base)
    try:
        with clisocket.Server({1: base / "socket/clisocket"}, answer):
            play(ThroughTheClient, SEQUENCES // 10, 12)
    finally:
        commands.close()
        client.tidied()


@pytest.fixture
def served(tmp_path):
    lock, state = threading.Lock(), {"desk": Desk()}

    def answer(srn, request):
        with lock:
            state["desk"], reply, _ = desk.answered(WORLD, state["desk"], request, srn, 0.0)
        return reply

    with clisocket.Server({1: tmp_path / "clisocket"}, answer):
        yield tmp_path / "clisocket"
    assert not (tmp_path / "clisocket").exists()


def exchange(path, *parts: bytes, ended=False) -> dict:
    """What one `recv` gets, as the client reads it."""
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(20)
        client.connect(str(path))
        for part in parts:
            client.sendall(part)
        if ended:
            client.shutdown(socket.SHUT_WR)
        return json.loads(client.recv(3276800))


def test_a_request_in_pieces_is_put_together(served):
    data = json.dumps(asked("rf_scenario_info")).encode()
    assert exchange(served, data[:10], data[10:30], data[30:]) == {"status": 200, "data": "{}"}


@pytest.mark.parametrize(("parts", "words"), MALFORMED)
def test_malformed_and_huge_requests_are_refused_and_the_next_is_answered(served, parts, words):
    reply = exchange(served, *parts, ended=parts[0].startswith(b"["))
    assert reply["status"] == 400 and words in reply["message"]
    assert exchange(served, json.dumps(asked("usrp_info")).encode())["status"] == 200


def test_one_that_says_nothing_holds_nobody_up(served):
    with socket.socket(socket.AF_UNIX) as silent:
        silent.connect(str(served))
        silent.sendall(b'{"version"')
        assert exchange(served, json.dumps(asked("usrp_info")).encode())["status"] == 200


def test_those_who_come_while_an_answer_takes_its_time_are_answered_after_it(tmp_path):
    """An emulator that is slow to clear holds the desk: whoever connects meanwhile waits, and is not turned away."""
    path, free = tmp_path / "clisocket", threading.Event()
    waiting = [socket.socket(socket.AF_UNIX) for _ in range(300)]
    with clisocket.Server({1: path}, lambda srn, request: free.wait(30) and {"status": 200}):
        for one in waiting:
            one.setblocking(False)
            one.connect(str(path))  # EAGAIN where the queue is full
            one.sendall(json.dumps(asked("usrp_info")).encode())
        free.set()
        for one in waiting[-clisocket.MOST_OPEN :]:
            one.settimeout(20)
            assert json.loads(one.recv(65536))["status"] == 200
    for one in waiting:
        one.close()


def test_one_who_opens_many_connections_and_asks_nothing_loses_the_oldest_and_keeps_out_nobody(tmp_path):
    paths = {1: tmp_path / "1", 2: tmp_path / "2"}
    question = json.dumps(asked("usrp_info")).encode()
    with clisocket.Server(paths, lambda srn, request: {"status": 200, "srn": srn}):
        quiet = socket.socket(socket.AF_UNIX)
        quiet.connect(str(paths[2]))
        idle = [socket.socket(socket.AF_UNIX) for _ in range(clisocket.MOST_OPEN + 40)]
        for one in idle:
            one.connect(str(paths[1]))
        began = time.monotonic()
        assert [exchange(paths[srn], question)["srn"] for srn in (1, 2)] == [1, 2]
        quiet.sendall(question)
        assert json.loads(quiet.recv(65536))["srn"] == 2, "of another socket none is closed"
        assert time.monotonic() - began < clisocket.PATIENCE_S - 1, "nobody waits until they have timed out"
        idle[0].settimeout(5)
        assert f"more than {clisocket.MOST_OPEN} connections are open" in json.loads(idle[0].recv(65536))["message"]
        idle[-1].settimeout(0.1)
        with pytest.raises(TimeoutError):
            idle[-1].recv(1)
    for one in (*idle, quiet):
        one.close()


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (None, "request: got null, needs an object"), ({}, "request: version and command are missing"),
        ({"version": "3.0"}, "request: command is missing"),
        ({"version": "3.0", "command": None}, "command: got null, needs one of"),
        (asked("rf_scenario_start", scenario_id=5, scenario_cycle=True), f"scenario_id: got 5, needs one of {min(WORLD.rf)}"),
        (asked("tgen_start", scenario_id=77), "scenario_id: got 77, needs one of 0, 1"),
        (asked("snapshot", filename="a b"), "filename: got 'a b', needs letters, digits and dashes, none of them first or last"),
        (asked("tgen_start", scenario_id=1, srn_radio_mapping={"1": 12}), "needs one of the reservation's SRNs: 1, 2, 3"),
    ],
)  # fmt: skip
def test_what_is_refused_says_what_is_known_in_the_words_of_json(request_, words):
    _, reply, _ = desk.answered(WORLD, Desk(), request_, 1, 0.0)
    assert reply["status"] == 400 and words in reply["message"] and "None" not in reply["message"]


IMAGES = "/share/nas/team/images"


@pytest.mark.parametrize(
    ("path", "name"),
    [(None, "mine"), ("", "mine"), (IMAGES, "mine"), (f"{IMAGES}/", "mine"), (f"{IMAGES}/of/monday", "of/monday/mine")],
)  # fmt: skip
def test_a_snapshot_goes_to_the_teams_images_or_to_a_folder_of_theirs(path, name):
    request = asked("snapshot", filename="mine", **({} if path is None else {"path": path}))
    taken, reply, actions = desk.answered(WORLD, Desk(), request, 1, 0.0)
    assert reply["status"] == 200 and [action.name for action in actions] == [name]
    _, again, actions = desk.answered(WORLD, taken, request, 1, 0.0)
    assert again["status"] == 400 and "has an image of that name" in again["message"] and actions == ()


@pytest.mark.parametrize(
    "path",
    ["/etc", f"{IMAGES}/..", f"{IMAGES}/../config", f"{IMAGES}2", "images", f"{IMAGES}//x", f"{IMAGES}/" + 300 * "x", 5, None],
)
def test_a_snapshot_goes_nowhere_else_and_the_rule_is_told(path):
    same, reply, actions = desk.answered(WORLD, Desk(), asked("snapshot", filename="mine", path=path), 1, 0.0)
    assert reply["status"] == 400 and f"needs {IMAGES}, a folder in it, or none" in reply["message"]
    assert same == Desk() and actions == ()


def test_a_list_that_is_too_long_is_cut_and_stays_json():
    rf = {n: RfScenario(number=n, title="t" * 80, nodes=128, center_frequency_hz=1e9, length_s=None) for n in range(1, 400)}
    world = World(srns=(1,), rf=rf, traffic={n: ("d" * 80, 2) for n in range(2000)})
    for command in ("rf_scenario_list", "tgen_list"):
        _, reply, _ = desk.answered(world, Desk(), asked(command), 1, 0.0)
        data = clisocket.reply_bytes(reply)
        assert 30000 < len(data) <= 65536 and len(json.loads(json.loads(data)["data"])) > 10


def test_random_bytes_never_end_the_server(served):
    rng = random.Random(3)
    good = json.dumps(asked("rf_scenario_start", scenario_id=8, scenario_cycle=True)).encode()
    for _ in range(200):
        data = bytearray(good)
        for _ in range(rng.randint(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        assert exchange(served, bytes(data), ended=True)["status"] in (100, 400)
