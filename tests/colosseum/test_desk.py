# SPDX-License-Identifier: GPL-3.0-or-later
"""Random sequences of commands, time and nonsense lead where a small model of the documentation says, in replies of 64 kB."""

import json
import os
import random
import socket
import sys
import threading
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule, run_state_machine_as_test

sys.path.append(str(Path(__file__).parent))
import client
from gr_cast.colosseum import clisocket, desk, maps
from gr_cast.colosseum.desk import Desk, RfScenario, World

SEQUENCES = int(os.environ.get("CAST_SEQUENCES", 200))  # 500 and more by hand
SRNS = 3
RF = {
    7: RfScenario(number=7, title="static", nodes=2, center_frequency_hz=1e9, length_s=None),
    8: RfScenario(number=8, title="moving", nodes=5, center_frequency_hz=None, length_s=30.0),
}
WORLD = World(srns=(1, 2, 3), rf=RF, traffic={0: ("none", 0), 1: ("pair", 2)})


def asked(command: str, **keys) -> dict:
    return {"version": "3.0", "command": command, **keys}


class Documented(RuleBasedStateMachine):
    """The model: what the documentation says of scenario and traffic, in a handful of variables of its own."""

    def __init__(self):
        super().__init__()
        self.desk, self.now = Desk(), 1000.0
        self.rf = None  # [number, status, since, cycle]
        self.traffic = None  # [number, status, since]
        self.plays = self.sends = False  # what the world was told

    def ask(self, request, srn=1) -> dict:
        self.desk, reply, actions = desk.answered(WORLD, self.desk, request, srn, self.now)
        self.heed(actions)
        assert reply["status"] in (100, 200, 400)
        assert len(clisocket.reply_bytes(reply)) <= 65536
        return reply

    def heed(self, actions):
        for action in actions:
            self.plays = {"play": True, "clear": False}.get(action.what, self.plays)
            self.sends = {"begin_traffic": True, "end_traffic": False}.get(action.what, self.sends)

    @rule(seconds=st.sampled_from([0.3, 1.0, 2.0, 10.0, 31.0, 130.0]))
    def time_passes(self, seconds):
        for _ in range(4):  # looked at often, as a box does
            self.now += seconds / 4
            self.desk, actions = desk.passed(WORLD, self.desk, self.now)
            self.heed(actions)
            for _ in range(2):
                if self.rf:
                    number, status, since, cycle = self.rf
                    if status == "SCHEDULED" and self.now - since >= desk.LEAD_S:
                        self.rf = [number, "ACTIVE", since + desk.LEAD_S, cycle]
                        break
                    if status == "ACTIVE" and number == 8 and not cycle and self.now - since >= 30:
                        self.rf[1] = "COMPLETED"
                    elif status == "STOPPING" and self.now - since >= desk.CLEAR_S:
                        self.rf[1] = "CLEARED"
            if self.traffic and self.traffic[1] == "SCHEDULED" and self.now - self.traffic[2] >= 120:
                self.traffic[1] = "ACTIVE"

    @rule(
        number=st.sampled_from([7, 8, 9, "7", None, True]), cycle=st.sampled_from([True, False, "yes"]), srn=st.integers(1, SRNS)
    )
    def starts(self, number, cycle, srn):
        is_running = self.rf is not None and self.rf[1] in ("SCHEDULED", "ACTIVE", "STOPPING")
        is_good = number in (7, 8) and number is not True and cycle in (True, False) and not is_running
        reply = self.ask(asked("rf_scenario_start", scenario_id=number, scenario_cycle=cycle), srn)
        assert reply["status"] == (100 if is_good else 400)
        if is_good:
            self.rf = [number, "SCHEDULED", self.now, cycle]

    @rule(
        srns=st.permutations([1, 2, 3, None, None]),
        left_out=st.booleans(),
        twice=st.booleans(),
        radio=st.sampled_from([0, 1, 2, 3]),
    )
    def starts_with_a_map(self, srns, left_out, twice, radio):
        is_running = self.rf is not None and self.rf[1] in ("SCHEDULED", "ACTIVE", "STOPPING")
        used = [1 if srn and twice else srn for srn in srns]
        radio_map = {f"Node {n}": {"SRN": s, "RadioA": radio, "RadioB": 2} if s else "None" for n, s in enumerate(used, 1)}
        if left_out:
            del radio_map["Node 3"]
        serves = [end["SRN"] for end in radio_map.values() if end != "None"]
        is_good = not is_running and not left_out and radio < 3 and len(set(serves)) == len(serves)
        reply = self.ask(asked("rf_scenario_start", scenario_id=8, scenario_cycle=False, srn_radio_mapping=radio_map))
        assert reply["status"] == (100 if is_good else 400)
        if is_good:
            self.rf = [8, "SCHEDULED", self.now, False]
            told = json.loads(self.ask(asked("rf_scenario_info"))["data"])
            assert told["srn_radio_mapping"] == radio_map
            expected = {s: n for n, s in enumerate(used, 1) if s and radio}
            assert maps.node_of_srn(radio_map) == expected

    @rule()
    def stops(self):
        assert self.ask(asked("rf_scenario_stop"))["status"] == 200
        if self.rf and self.rf[1] in ("SCHEDULED", "ACTIVE"):
            self.rf[1:3] = ["STOPPING", self.now]

    @rule()
    def is_informed(self):
        data = json.loads(self.ask(asked("rf_scenario_info"))["data"])
        if self.rf is None:
            assert data == {}
        else:
            assert [data["scenario_id"], data["scenario_status"], data["scenario_cycle"]] == [*self.rf[:2], self.rf[3]]
            assert data["scenario_start_time"] is not None and len(data["srn_radio_mapping"]) == RF[self.rf[0]].nodes

    @rule(number=st.sampled_from([0, 1, 2, "1"]), node_map=st.sampled_from([None, {"1": 3, "2": 1}, {"1": 1, "2": 1}, {"3": 1}]))
    def starts_traffic(self, number, node_map):
        keys = {"scenario_id": number} | ({} if node_map is None else {"srn_radio_mapping": node_map})
        is_map_good = node_map is None or (number == 1 and node_map == {"1": 3, "2": 1})
        is_good = number in (0, 1) and is_map_good and (self.traffic is None or self.traffic[1] == "STOPPED")
        assert self.ask(asked("tgen_start", **keys))["status"] == (200 if is_good else 400)
        if is_good:
            self.traffic = [number, "SCHEDULED", self.now]

    @rule()
    def stops_traffic(self):
        assert self.ask(asked("tgen_stop"))["status"] == 200
        if self.traffic:
            self.traffic[1] = "STOPPED"

    @precondition(lambda self: self.traffic)
    @rule()
    def is_informed_of_traffic(self):
        data = self.ask(asked("tgen_info"))["data"]
        assert [data["scenario_id"], data["status"]] == self.traffic[:2]

    @rule(name=st.sampled_from(["rf_scenario_list", "tgen_list", "usrp_info", "gps_stop", "gps_scenario_list", "gps_info"]))
    def lists(self, name):
        assert self.ask(asked(name))["status"] == 200

    @rule(
        request=st.recursive(
            st.none() | st.booleans() | st.integers() | st.text(max_size=20),
            lambda inner: (
                st.lists(inner, max_size=3)
                | st.dictionaries(st.sampled_from(["version", "command", "scenario_id", "x"]), inner, max_size=4)
            ),
            max_leaves=8,
        )
    )
    def hears_nonsense(self, request):
        before = self.desk
        assert self.ask(request)["status"] == 400
        assert self.desk == before

    @invariant()
    def nothing_passes_between_scenarios(self):
        assert self.plays == (self.rf is not None and self.rf[1] == "ACTIVE")
        assert self.sends == (self.traffic is not None and self.traffic[1] == "ACTIVE")


def test_random_sequences_of_commands_follow_the_documented_states():
    run_state_machine_as_test(
        Documented,
        settings=settings(
            max_examples=SEQUENCES,
            stateful_step_count=25,
            deadline=None,
            derandomize=True,
            suppress_health_check=list(HealthCheck),
        ),
    )


def words_of(request: dict, folder: Path) -> list[str] | None:
    """The command of Colosseum's own client that sends this request; None where none does."""
    plain = {
        "rf_scenario_stop": "rf stop", "rf_scenario_info": "rf info", "rf_scenario_list": "rf scenario list",
        "tgen_stop": "tg stop", "tgen_info": "tg info", "tgen_list": "tg scenario list", "usrp_info": "usrp info",
        "gps_stop": "gps stop", "gps_info": "gps info",
    }  # fmt: skip
    command = request.get("command") if isinstance(request, dict) else None
    command = command if isinstance(command, str) else None
    if command in plain:
        return plain[command].split()
    number, cycle = (request.get(key, False) for key in ("scenario_id", "scenario_cycle")) if command else (None, None)
    if command not in ("rf_scenario_start", "tgen_start") or type(number) is not int or type(cycle) is not bool:
        return None
    words = [command[:2], "start", str(number)] + ["-c"] * cycle
    if "srn_radio_mapping" in request:
        (folder / "map.json").write_text(json.dumps(request["srn_radio_mapping"]))
        words += ["-m", str(folder / "map.json")]
    return words


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

    commands = client.Client(base)
    try:
        with clisocket.Server({1: base / "socket/clisocket"}, answer):
            several = settings(
                max_examples=SEQUENCES // 10, stateful_step_count=12, deadline=None, derandomize=True,
                suppress_health_check=list(HealthCheck),
            )  # fmt: skip
            run_state_machine_as_test(ThroughTheClient, settings=several)
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


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ([b"{bad"], "not JSON"), ([b"\xff\xfe"], "UTF-8"), ([b"5"], "needs a mapping"), ([b"[]"], "needs a mapping"),
        ([b'{"version": "3.0", "version": "3.0"}'], "given twice"), ([b'{"version": 3.0, "command": "usrp_info"}'], "version"),
        ([b'{"version": "3.0", "command": "rm"}'], "needs one of"), ([b"[" * 60000], "not JSON"), ([b" " * 70000], "limit 65536"),
        ([b'{"x": "' + b"y" * 3_000_000 + b'"}'], "limit 65536"), ([b'{"x": ' + b"1" * 5000 + b"}"], "JSON"),
    ],
)  # fmt: skip
def test_malformed_and_huge_requests_are_refused_and_the_next_is_answered(served, parts, words):
    reply = exchange(served, *parts, ended=parts[0].startswith(b"["))
    assert reply["status"] == 400 and words in reply["message"]
    assert exchange(served, json.dumps(asked("usrp_info")).encode())["status"] == 200


def test_one_that_says_nothing_holds_nobody_up(served):
    with socket.socket(socket.AF_UNIX) as silent:
        silent.connect(str(served))
        silent.sendall(b'{"version"')
        assert exchange(served, json.dumps(asked("usrp_info")).encode())["status"] == 200


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
