# SPDX-License-Identifier: GPL-3.0-or-later
"""Flows of packets: one YAML file, read strictly, and the MGEN script of every node (MGEN user's guide, version 5)."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

from ...core.documents import Reader, short, yaml_file
from ...core.errors import CastError

VERSION = 1
PATTERNS = ("poisson", "periodic", "burst")
PORT = 5000  # that every node listens to
LEAD_S = 1.0  # between the start of MGEN and second 0 of the flows: all listen by then
SIZE_LIMITS = (28, 1472)  # bytes: MGEN's own header, and UDP in one Ethernet frame
_KEYS = {"cast_traffic", "duration_s", "flows"}
_FLOW_KEYS = {"name", "from", "to", "pattern", "rate_pps", "size_bytes", "start_s", "stop_s", "every_s", "length_s"}


@dataclass(frozen=True, kw_only=True)
class Flow:
    """Packets of `size_bytes` (UDP payload) from one node to another: `rate_pps` of them a second from start to stop.

    `poisson`: exponential gaps; `periodic`: equal ones; `burst`: equal ones for `length_s` at the start of every `every_s`.
    """

    number: int
    name: str
    source: str
    destination: str
    pattern: str
    rate_pps: float
    size_bytes: int
    start_s: float
    stop_s: float
    every_s: float = 0.0
    length_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Traffic:
    """All flows of a run of `duration_s`, and the nodes they join, in order of appearance."""

    duration_s: float
    flows: tuple[Flow, ...]

    @property
    def nodes(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(node for flow in self.flows for node in (flow.source, flow.destination)))


def examples_folder() -> Path:
    return Path(__file__).resolve().parent / "examples"


def read(name_or_path: str | Path) -> Traffic:
    """Read flows from a file or a shipped example; CastError names every fault at once with its place."""
    path = Path(name_or_path)
    shipped = examples_folder() / f"{name_or_path}.yaml"
    if not path.suffix and shipped.is_file():
        path = shipped
    get = yaml_file(path)
    document, faults = get.document, get.faults
    get.keys(document, "", _KEYS)
    get.version("cast_traffic", VERSION)
    duration_s = get.number(document.get("duration_s"), "duration_s", "s", 0.1, 86400)
    entries = get.sequence(document.get("flows"), "flows")
    flows = [_flow(entry, index, duration_s, get) for index, entry in enumerate(entries)]
    if not entries:
        faults.add("flows", "there is none")
    names = [flow.name for flow in flows]
    for name in sorted({name for name in names if names.count(name) > 1}):
        faults.add("flows", f"two are named {name!r}")
    faults.raise_if_any()
    return Traffic(duration_s=duration_s, flows=tuple(flows))


def _flow(entry, index: int, duration_s: float, get: Reader) -> Flow:
    place = f"flows[{index}]"
    entry = get.keys(entry, place, _FLOW_KEYS)
    source, destination = (_node(entry.get(key), f"{place}.{key}", get) for key in ("from", "to"))
    if source == destination:
        get.faults.add(place, f"goes from {source!r} to itself")
    pattern = get.choice(entry.get("pattern"), f"{place}.pattern", PATTERNS)
    start_s = get.number(entry.get("start_s", 0.0), f"{place}.start_s", "s", 0.0, duration_s)
    stop_s = get.number(entry.get("stop_s", duration_s), f"{place}.stop_s", "s", 0.0, duration_s)
    if stop_s <= start_s:
        get.faults.add(place, f"stops at {stop_s} s, needs to be after its start at {start_s} s")
    size_bytes = get.whole(entry.get("size_bytes"), f"{place}.size_bytes", "bytes", *SIZE_LIMITS)
    values = dict(
        rate_pps=get.number(entry.get("rate_pps"), f"{place}.rate_pps", "packets/s", 1e-3, 1e6), start_s=start_s, stop_s=stop_s
    )
    for key in ("every_s", "length_s"):
        if pattern == "burst":
            values[key] = get.number(entry.get(key), f"{place}.{key}", "s", 1e-3, 86400)
        elif key in entry:
            get.faults.add(f"{place}.{key}", "belongs to bursts only")
    if values.get("length_s", 0.0) > values.get("every_s", 0.0):
        get.faults.add(place, f"bursts of {values['length_s']} s every {values['every_s']} s overlap")
    name = get.text(entry.get("name", f"{source}>{destination} {pattern} {index + 1}"), f"{place}.name")
    return Flow(
        number=index + 1, name=name, source=source, destination=destination, pattern=pattern,
        size_bytes=size_bytes, **values,
    )  # fmt: skip


def _node(value, place: str, get: Reader) -> str:
    text = get.text(value, place)
    if text and not re.fullmatch(r"[A-Za-z0-9_-]{1,32}", text):
        get.faults.add(place, f"got {short(value)}, needs a node's name: letters, digits, _ and -, at most 32")
    return text


def stretched(traffic: Traffic, duration_s: float) -> Traffic:
    """The same flows over another duration; bursts keep their lengths."""
    if not 0.1 <= duration_s <= 86400:
        raise CastError(f"duration: got {duration_s} s, needs 0.1 to 86400 s")
    factor = duration_s / traffic.duration_s
    flows = (replace(flow, start_s=factor * flow.start_s, stop_s=factor * flow.stop_s) for flow in traffic.flows)
    return Traffic(duration_s=duration_s, flows=tuple(flows))


def addresses(nodes: tuple[str, ...]) -> dict[str, str]:
    """An IPv4 address for every node."""
    if len(nodes) > 250:
        raise CastError(f"nodes: got {len(nodes)}, limit 250")
    return {node: f"10.45.0.{index}" for index, node in enumerate(nodes, 1)}


def script(traffic: Traffic, node: str, address: dict[str, str] | None = None) -> str:
    """What MGEN at `node` does: listens where a flow ends, and sends its flows from LEAD_S on.

    `address` of every node; without it those of `addresses`.
    """
    address = address or addresses(traffic.nodes)
    lines = [f"# {node}, {address[node]}"]
    if any(flow.destination == node for flow in traffic.flows):
        lines.append(f"0.0 LISTEN UDP {PORT}")
    for flow in traffic.flows:
        if flow.source != node:
            continue
        pattern = f"PERIODIC [{flow.rate_pps:g} {flow.size_bytes}]"
        if flow.pattern == "poisson":
            pattern = f"POISSON [{flow.rate_pps:g} {flow.size_bytes}]"
        elif flow.pattern == "burst":
            pattern = f"BURST [REGULAR {flow.every_s:g} {pattern} FIXED {flow.length_s:g}]"
        where = f"SRC {PORT + flow.number} DST {address[flow.destination]}/{PORT}"
        lines.append(f"{LEAD_S + flow.start_s:g} ON {flow.number} UDP {where} {pattern}")
        lines.append(f"{LEAD_S + flow.stop_s:g} OFF {flow.number}")
    return "\n".join(lines) + "\n"
