# SPDX-License-Identifier: GPL-3.0-or-later
"""MGEN's logs (version 5, text) to figures: what was sent, what came, when, and how late. One clock for all is assumed."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.documents import read_text, short
from ...core.errors import CastError, Faults
from .flows import LEAD_S, Flow, Traffic

_DAY_S = 86400.0
MAX_STEPS = 1_000_000  # of a run cut into steps
_LINE = re.compile(r"([01][0-9]|2[0-3]):([0-5][0-9]):([0-6][0-9]\.[0-9]{1,9}) (SEND|RECV|START)\b(.*)")
_FIELD = re.compile(r"\b(flow|seq)>([0-9]{1,10})(?!\S)")  # both are 32 bit


@dataclass(frozen=True, kw_only=True)
class FlowResult:
    """One flow's packets in order of sending: `sent_s` (n,) on the run's clock, `latency_s` (n,), NaN where lost."""

    flow: Flow
    sent_s: np.ndarray
    latency_s: np.ndarray
    duplicates: int

    @property
    def sent(self) -> int:
        return len(self.sent_s)

    @property
    def received(self) -> int:
        return int(np.isfinite(self.latency_s).sum())

    @property
    def loss(self) -> float:
        """Share of packets that did not come; NaN where none was sent."""
        return 1 - self.received / self.sent if self.sent else float("nan")


def _seconds(hours: str, minutes: str, seconds: str) -> float:
    return 3600 * int(hours) + 60 * int(minutes) + float(seconds)


def _events(path: Path) -> list[tuple[float, str, int, int]]:
    """(second of the day, event, flow, packet's number) of every whole line; one that a dying process cut short is left out."""
    text = read_text(path, missing=": MGEN's log of this node")
    events, faults = [], Faults(str(path))
    for number, line in enumerate(text[: text.rfind("\n") + 1].split("\n"), 1):
        match = _LINE.match(line)
        if not match:
            continue
        fields = dict(_FIELD.findall(match[5]))
        if match[4] != "START" and len(fields) < 2:
            faults.add(f"line {number}", f"got {short(line)}, needs flow>NUMBER and seq>NUMBER")
        else:
            at = int(fields.get("flow", 0)), int(fields.get("seq", 0))
            events.append((_seconds(*match.groups()[:3]), match[4], *at))
    if text.strip() and not events:
        faults.add("", "not a text log of MGEN 5: no START, SEND or RECV in it")
    faults.raise_if_any()
    return events


def evaluate(traffic: Traffic, logs: dict[str, Path]) -> list[FlowResult]:
    """Every flow's packets from the logs of all nodes. Second 0 is LEAD_S after the first MGEN was started."""
    events = {node: _events(Path(path)) for node, path in logs.items()}
    missing = [node for node in traffic.nodes if node not in events]
    if missing:
        raise CastError(f"logs: none of node {', '.join(missing)}")
    starts = [when for lines in events.values() for when, event, *_ in lines if event == "START"]
    if not starts:
        raise CastError("logs: no START in any: MGEN did not run")
    zero = min(starts) if np.ptp(starts) < _DAY_S / 2 else min(s for s in starts if s > _DAY_S / 2)  # around midnight

    def clock(second: float) -> float:
        return (second - zero + _DAY_S / 2) % _DAY_S - _DAY_S / 2 - LEAD_S

    results = []
    for flow in traffic.flows:
        sent = {
            packet: clock(when)
            for when, event, number, packet in events[flow.source]
            if event == "SEND" and number == flow.number
        }
        came, duplicates = {}, 0
        for when, event, number, sequence in events[flow.destination]:
            if event == "RECV" and number == flow.number:
                duplicates += sequence in came
                came.setdefault(sequence, clock(when))
        order = sorted(sent)
        sent_s = np.array([sent[sequence] for sequence in order])
        # The log of a dead sender may end before packets that came: they count for what was sent no more than it says.
        latency_s = np.array([came.get(sequence, np.nan) - sent[sequence] for sequence in order])
        results.append(FlowResult(flow=flow, sent_s=sent_s, latency_s=latency_s, duplicates=duplicates))
    return results


def series(result: FlowResult, duration_s: float, step_s: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Per step of `step_s`, (time at its middle, value): throughput_bps by arrival; loss, latency_s by sending, NaN if none."""
    if not duration_s / MAX_STEPS < step_s < np.inf:
        raise CastError(f"step: got {step_s} s, needs more than {duration_s / MAX_STEPS:g} s: a millionth of the duration")
    edges = np.arange(0, duration_s + step_s * (1 - 1e-9), step_s)
    middle = (edges[:-1] + edges[1:]) / 2
    bits = 8 * result.flow.size_bytes
    arrived = np.isfinite(result.latency_s)
    came = np.histogram((result.sent_s + result.latency_s)[arrived], edges)[0]
    sent = np.histogram(result.sent_s, edges)[0]
    whole = np.histogram(result.sent_s[arrived], edges)[0]
    late = np.histogram(result.sent_s[arrived], edges, weights=result.latency_s[arrived])[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        values = {"throughput_bps": came * bits / step_s, "loss": 1 - whole / sent, "latency_s": late / whole}
    return {name: (middle, value) for name, value in values.items()}


def row(result: FlowResult) -> dict:
    """A flow's figures; None where there is nothing to tell."""
    latency_s = result.latency_s[np.isfinite(result.latency_s)]
    span_s = result.flow.stop_s - result.flow.start_s
    quantiles = dict(zip(("latency_s_median", "latency_s_99"), np.quantile(latency_s, [0.5, 0.99]).tolist(), strict=True)) if (
        latency_s.size) else {"latency_s_median": None, "latency_s_99": None}  # fmt: skip
    return {
        "flow": result.flow.name, "from": result.flow.source, "to": result.flow.destination, "sent": result.sent,
        "received": result.received, "duplicates": result.duplicates, "loss": result.loss if result.sent else None,
        "offered_bps": 8 * result.flow.size_bytes * result.sent / span_s,
        "throughput_bps": 8 * result.flow.size_bytes * result.received / span_s,
        "latency_s_mean": float(latency_s.mean()) if latency_s.size else None,
    } | quantiles  # fmt: skip
