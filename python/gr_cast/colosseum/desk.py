# SPDX-License-Identifier: GPL-3.0-or-later
"""What the command line of an interactive reservation asks for, as a state machine without sockets, clocks or containers.

`answered(world, desk, request, ...)` and `passed(world, desk, now_s, ...)` give the next desk and what is to be done in the
world: the emulator plays or is cleared, traffic begins or ends, an image is taken of a container.
"""

import json
from dataclasses import dataclass, field, replace

from ..core.documents import listed, short
from ..core.errors import CastError
from ..core.files import is_inside
from . import maps
from .storage import IMAGE_RULE, is_image_name

VERSION = "3.0"
LEAD_S = 2.0  # from a start's being queued to its scenario's beginning
CLEAR_S = 1.0  # that the emulator takes to clear; Colosseum's may take 15 s
TRAFFIC_LEAD_S = 120.0
QUEUED, DONE, REFUSED = 100, 200, 400
RUNNING = ("SCHEDULED", "ACTIVE", "STOPPING")
LONGEST_PATH = 255


@dataclass(frozen=True, kw_only=True)
class RfScenario:
    """A scenario as the command line lists it; `length_s` None: it does not change, and plays until it is stopped."""

    number: int
    title: str
    nodes: int
    center_frequency_hz: float | None
    length_s: float | None


@dataclass(frozen=True, kw_only=True)
class World:
    """What does not change during a reservation: its SRNs, scenarios, traffic (number to title and nodes), where images go."""

    srns: tuple[int, ...]
    rf: dict[int, RfScenario]
    traffic: dict[int, tuple[str, int]]
    traffic_lead_s: float = TRAFFIC_LEAD_S
    images: str = "/share/nas/team/images"  # as containers see the team's


@dataclass(frozen=True, kw_only=True)
class RfState:
    number: int
    status: str
    start_s: float
    cycle: bool
    radio_map: dict
    clears_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class TrafficState:
    number: int
    status: str
    start_s: float
    node_map: dict


@dataclass(frozen=True, kw_only=True)
class Desk:
    """All that requests have led to so far; `gps` maps an SRN to its scenario and node, `images` are names below the team's."""

    rf: RfState | None = None
    traffic: TrafficState | None = None
    gps: dict[int, tuple[int, int]] = field(default_factory=dict)
    images: frozenset[str] = frozenset()


@dataclass(frozen=True, kw_only=True)
class Action:
    """What is to be done in the world: `what` of play, clear, begin_traffic, end_traffic, snapshot."""

    what: str
    state: RfState | TrafficState | None = None
    srn: int = 0
    name: str = ""


def answered(world: World, desk: Desk, request, srn: int, now_s: float) -> tuple[Desk, dict, tuple[Action, ...]]:
    """The next desk, the reply and what is to be done, of a request from the container of `srn`."""
    try:
        if not isinstance(request, dict):
            raise CastError(f"request: got {short(request)}, needs an object with version and command")
        if missing := [key for key in ("version", "command") if key not in request]:
            raise CastError(f"request: {' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing")
        if request.get("version") != VERSION:
            raise CastError(f"version: got {short(request.get('version'))}, needs {VERSION!r}")
        command = request.get("command")
        if not isinstance(command, str) or command not in _COMMANDS:
            raise CastError(f"command: got {short(command)}, needs one of {', '.join(_COMMANDS)}")
        function, required, optional = _COMMANDS[command]
        faults = [f"unknown key {short(key)}" for key in request if key not in {"version", "command", *required, *optional}]
        faults += [f"{key} is missing" for key in required if key not in request]
        if faults:
            raise CastError(*(f"{command}: {fault}" for fault in faults))
        return function(world, desk, request, srn, now_s)
    except CastError as error:
        return desk, {"status": REFUSED, "message": "; ".join(error.faults)[:2000]}, ()


def passed(world: World, desk: Desk, now_s: float, played_s: float | None = None) -> tuple[Desk, tuple[Action, ...]]:
    """Time goes on: a scenario begins, ends or has been cleared, traffic begins. `played_s`: how much of the scenario the
    emulator has played, where it is not real time."""
    actions = []
    rf, traffic = desk.rf, desk.traffic
    if rf and rf.status == "SCHEDULED" and now_s >= rf.start_s:
        rf = replace(rf, status="ACTIVE")
        actions.append(Action(what="play", state=rf))
    elif rf and rf.status == "ACTIVE" and not rf.cycle:
        length_s = world.rf[rf.number].length_s
        if length_s is not None and (now_s - rf.start_s if played_s is None else played_s) >= length_s:
            rf = replace(rf, status="COMPLETED")
            actions.append(Action(what="clear"))
    elif rf and rf.status == "STOPPING" and now_s >= rf.clears_s:
        rf = replace(rf, status="CLEARED")
    if traffic and traffic.status == "SCHEDULED" and now_s >= traffic.start_s:
        traffic = replace(traffic, status="ACTIVE")
        actions.append(Action(what="begin_traffic", state=traffic))
    return replace(desk, rf=rf, traffic=traffic), tuple(actions)


def _done(desk: Desk, *actions: Action, **reply) -> tuple[Desk, dict, tuple[Action, ...]]:
    return desk, {"status": DONE, **reply}, actions


def _integer(request: dict, key: str, known=None) -> int:
    value = request.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or (known is not None and value not in known):
        raise CastError(
            f"{key}: got {short(value)}, needs {'an integer' if known is None else f'one of {listed(sorted(known))}'}"
        )
    return value


def _rf_start(world, desk, request, srn, now_s):
    number = _integer(request, "scenario_id", world.rf)
    cycle = request["scenario_cycle"]
    if not isinstance(cycle, bool):
        raise CastError(f"scenario_cycle: got {short(cycle)}, needs true or false")
    given = request.get("srn_radio_mapping")
    nodes = world.rf[number].nodes
    radio_map = maps.default_radio_map(nodes, world.srns) if given is None else maps.radio_map(given, nodes, world.srns)
    if desk.rf and desk.rf.status in RUNNING:
        raise CastError(f"rf_scenario_start: scenario {desk.rf.number} is {desk.rf.status}: stop it first")
    rf = RfState(number=number, status="SCHEDULED", start_s=now_s + LEAD_S, cycle=cycle, radio_map=radio_map)
    return replace(desk, rf=rf), {"status": QUEUED, "message": f"scenario {number} is queued"}, ()


def _rf_stop(world, desk, request, srn, now_s):
    if not desk.rf or desk.rf.status not in ("SCHEDULED", "ACTIVE"):
        return _done(desk, message="no scenario is active")
    rf = replace(desk.rf, status="STOPPING", clears_s=now_s + CLEAR_S)
    return _done(replace(desk, rf=rf), Action(what="clear"), message="the emulator is being cleared")


def _rf_info(world, desk, request, srn, now_s):
    rf = desk.rf
    data = {} if rf is None else {
        "scenario_id": rf.number, "scenario_status": rf.status, "scenario_start_time": round(rf.start_s, 3),
        "scenario_cycle": rf.cycle, "srn_radio_mapping": rf.radio_map,
    }  # fmt: skip
    return _done(desk, data=json.dumps(data))


def _rf_list(world, desk, request, srn, now_s):
    listed = [
        {
            "scenario_id": one.number, "title": one.title[:80],
            "radio_resources": {f"NODE {node}": 1 for node in range(1, one.nodes + 1)},
            "center_freq": one.center_frequency_hz, "scenario_cycle_compatible": True,
        }
        for one in world.rf.values()
    ]  # fmt: skip
    return _done(desk, data=json.dumps(listed))


def _traffic_start(world, desk, request, srn, now_s):
    number = _integer(request, "scenario_id", world.traffic)
    given = request.get("srn_radio_mapping")
    nodes = world.traffic[number][1]
    node_map = maps.default_node_map(nodes, world.srns) if given is None else maps.node_map(given, nodes, world.srns)
    if desk.traffic and desk.traffic.status != "STOPPED":
        raise CastError(f"tgen_start: traffic scenario {desk.traffic.number} is {desk.traffic.status}: stop it first")
    start_s = now_s + world.traffic_lead_s
    traffic = TrafficState(number=number, status="SCHEDULED", start_s=start_s, node_map=node_map)
    return _done(replace(desk, traffic=traffic), message=f"traffic begins in {world.traffic_lead_s:g} s")


def _traffic_stop(world, desk, request, srn, now_s):
    if not desk.traffic or desk.traffic.status == "STOPPED":
        return _done(desk, message="no traffic is active")
    was_active = desk.traffic.status == "ACTIVE"
    stopped = replace(desk, traffic=replace(desk.traffic, status="STOPPED"))
    return _done(stopped, *([Action(what="end_traffic")] if was_active else []), message="traffic is stopped")


def _traffic_info(world, desk, request, srn, now_s):
    if desk.traffic is None:
        return _done(desk, message="no traffic session")
    state = desk.traffic
    return _done(desk, data={"scenario_id": state.number, "status": state.status, "node_map": state.node_map})


def _traffic_list(world, desk, request, srn, now_s):
    listed = {
        str(number): {"scenario_id": number, "description": title[:80]} for number, (title, _) in sorted(world.traffic.items())
    }
    return _done(desk, data=json.dumps(listed))


def _usrp_info(world, desk, request, srn, now_s):
    return _done(desk, message="{'status': 'IDLE'}")


def _usrp_flash(world, desk, request, srn, now_s):
    name = request["filename"]
    if not isinstance(name, str) or not 1 <= len(name) <= LONGEST_PATH:
        raise CastError(f"filename: got {short(name)}, needs the name of a file in /share/usrp_images/")
    return _done(desk, message="{'status': 'IDLE'}: a box has no radio that could be flashed")


def _snapshot(world, desk, request, srn, now_s):
    name, path = request["filename"], request.get("path", "")
    if not is_image_name(name):
        raise CastError(f"filename: got {short(name)}, needs {IMAGE_RULE}")
    name = _below(world.images, path) + name
    if name in desk.images:
        raise CastError(f"filename: {name}: the team has an image of that name")
    taken = replace(desk, images=desk.images | {name})
    return _done(taken, Action(what="snapshot", srn=srn, name=name), message=f"taking {name}.tar.gz of this container")


def _below(images: str, path) -> str:
    """The folder of a snapshot below the team's images, "" for these themselves."""
    if isinstance(path, str) and len(path) <= LONGEST_PATH:
        inner = path.rstrip("/").removeprefix(images)
        if path.rstrip("/") in ("", images):
            return ""
        if inner != path.rstrip("/") and inner.startswith("/") and is_inside(inner[1:]):
            return f"{inner[1:]}/"
    raise CastError(f"path: got {short(path)}, needs {images}, a folder in it, or none: images go to the team's")


def _gps_start(world, desk, request, srn, now_s):
    number = _integer(request, "gps_rfid", world.rf)
    node = _integer(request, "gps_nodeid", range(1, world.rf[number].nodes + 1))
    return _done(replace(desk, gps=desk.gps | {srn: (number, node)}), message="GPS started")


def _gps_stop(world, desk, request, srn, now_s):
    gps = {key: value for key, value in desk.gps.items() if key != srn}
    return _done(replace(desk, gps=gps), message="GPS stopped")


def _gps_list(world, desk, request, srn, now_s):
    return _done(desk, data=json.dumps(sorted(world.rf)))


def _gps_info(world, desk, request, srn, now_s):
    number, node = desk.gps.get(srn, (None, None))
    return _done(desk, data={"gps_rfid": number, "gps_nodeid": node})


_COMMANDS = {  # to what answers, the keys that must be there, and those that may be
    "rf_scenario_start": (_rf_start, ("scenario_id", "scenario_cycle"), ("srn_radio_mapping",)),
    "rf_scenario_stop": (_rf_stop, (), ()),
    "rf_scenario_info": (_rf_info, (), ()),
    "rf_scenario_list": (_rf_list, (), ()),
    "tgen_start": (_traffic_start, ("scenario_id",), ("srn_radio_mapping",)),
    "tgen_stop": (_traffic_stop, (), ()),
    "tgen_info": (_traffic_info, (), ()),
    "tgen_list": (_traffic_list, (), ()),
    "usrp_info": (_usrp_info, (), ()),
    "usrp_flash": (_usrp_flash, ("filename",), ()),
    "snapshot": (_snapshot, ("filename",), ("path",)),
    "gps_start": (_gps_start, ("gps_rfid", "gps_nodeid"), ()),
    "gps_stop": (_gps_stop, (), ()),
    "gps_scenario_list": (_gps_list, (), ()),
    "gps_info": (_gps_info, (), ()),
}
