# SPDX-License-Identifier: GPL-3.0-or-later
"""The documentation's states of scenario and traffic as a model that draws commands, and what of them Colosseum's client says."""

import json
from pathlib import Path

from gr_cast.colosseum import clisocket, desk, maps
from gr_cast.colosseum.desk import Desk, RfScenario, World
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule, run_state_machine_as_test

SRNS = 3
MALFORMED = [  # what is sent, a word of the refusal
    ([b"{bad"], "not JSON"), ([b"\xff\xfe"], "UTF-8"), ([b"5"], "needs a mapping"), ([b"[]"], "needs a mapping"),
    ([b'{"version": "3.0", "version": "3.0"}'], "given twice"), ([b'{"version": 3.0, "command": "usrp_info"}'], "version"),
    ([b'{"version": "3.0", "command": "rm"}'], "needs one of"), ([b"[" * 60000], "not JSON"), ([b" " * 70000], "limit 65536"),
    ([b'{"x": "' + b"y" * 3_000_000 + b'"}'], "limit 65536"), ([b'{"x": ' + b"1" * 5000 + b"}"], "JSON"),
]  # fmt: skip
RF = {
    7: RfScenario(number=7, title="static", nodes=2, center_frequency_hz=1e9, length_s=None),
    8: RfScenario(number=8, title="moving", nodes=5, center_frequency_hz=None, length_s=30.0),
}
WORLD = World(srns=(1, 2, 3), rf=RF, traffic={0: ("none", 0), 1: ("pair", 2)})


def asked(command: str, **keys) -> dict:
    return {"version": "3.0", "command": command, **keys}


class Documented(RuleBasedStateMachine):
    """The model: what the documentation says of scenario and traffic, in a handful of variables of its own."""

    nodes = {number: scenario.nodes for number, scenario in RF.items()}

    def __init__(self):
        super().__init__()
        self.desk, self.now = Desk(), 1000.0
        self.rf = None  # [number, status, since, cycle]
        self.traffic = None  # [number, status, since]
        self.plays = self.sends = False  # what the world was told

    def ask(self, request, srn=1) -> dict:
        """The reply to a request from the container of `srn`."""
        self.desk, reply, actions = desk.answered(WORLD, self.desk, request, srn, self.now)
        self.heed(actions)
        assert reply["status"] in (100, 200, 400)
        assert len(clisocket.reply_bytes(reply)) <= 65536
        return reply

    @property
    def is_running(self) -> bool:
        return self.rf is not None and self.rf[1] in desk.RUNNING

    def heed(self, actions):
        for action in actions:
            self.plays = {"play": True, "clear": False}.get(action.what, self.plays)
            self.sends = {"begin_traffic": True, "end_traffic": False}.get(action.what, self.sends)

    @rule(seconds=st.sampled_from([0.3, 1.0, 2.0, 10.0, 31.0, 130.0]))
    def time_passes(self, seconds):
        self.wait(seconds)

    def wait(self, seconds):
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
        reply = self.ask(asked("rf_scenario_start", scenario_id=number, scenario_cycle=cycle), srn)
        is_good = number in (7, 8) and number is not True and cycle in (True, False) and not self.is_running
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
        used = [1 if srn and twice else srn for srn in srns]
        radio_map = {f"Node {n}": {"SRN": s, "RadioA": radio, "RadioB": 2} if s else "None" for n, s in enumerate(used, 1)}
        if left_out:
            del radio_map["Node 3"]
        serves = [end["SRN"] for end in radio_map.values() if end != "None"]
        reply = self.ask(asked("rf_scenario_start", scenario_id=8, scenario_cycle=False, srn_radio_mapping=radio_map))
        is_good = not self.is_running and not left_out and radio < 3 and len(set(serves)) == len(serves)
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
            assert data["scenario_start_time"] is not None and len(data["srn_radio_mapping"]) == self.nodes[self.rf[0]]

    @rule(number=st.sampled_from([0, 1, 2, "1"]), node_map=st.sampled_from([None, {"1": 3, "2": 1}, {"1": 1, "2": 1}, {"3": 1}]))
    def starts_traffic(self, number, node_map):
        keys = {"scenario_id": number} | ({} if node_map is None else {"srn_radio_mapping": node_map})
        is_map_good = node_map is None or (number == 1 and node_map == {"1": 3, "2": 1})
        reply = self.ask(asked("tgen_start", **keys))
        is_good = number in (0, 1) and is_map_good and (self.traffic is None or self.traffic[1] == "STOPPED")
        assert reply["status"] == (200 if is_good else 400)
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


def words_of(request: dict, folder: Path, seen: Path | None = None) -> list[str] | None:
    """The command of Colosseum's own client that sends this request, with maps in `folder`, which the client sees at `seen`;
    None where none does."""
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
        words += ["-m", str((seen or folder) / "map.json")]
    return words


def play(machine: type[Documented], sequences: int, steps: int, **more) -> None:
    """So many sequences of so many steps; the same every time."""
    drawn = settings(
        max_examples=sequences, stateful_step_count=steps, deadline=None, derandomize=True,
        suppress_health_check=list(HealthCheck), **more,
    )  # fmt: skip
    run_state_machine_as_test(machine, settings=drawn)
