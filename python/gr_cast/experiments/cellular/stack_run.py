# SPDX-License-Identifier: GPL-3.0-or-later
"""One run of srsRAN 4G over an emulator that is already there: core, stations, terminals in namespaces, traffic to each."""

import subprocess
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from ...comparing.series import Series
from ...core.errors import CastError
from ...core.processes import Processes
from ..traffic import flows, log
from ..traffic import run as mgen
from ..traffic.namespaces import Namespace
from . import stack
from .stack import GATEWAY, Member

CORE_S = 2.0  # until the core listens
ANSWER_S = 30.0  # beyond its duration, for iperf3 to fetch from the terminal what came
_LOOK_S = 0.2
_TUNNEL = "tun_srsue"
_CORE, _PACKET_BYTES, _STEP_S = "epc", 1250, 1.0  # of MGEN: who sends, packets, and steps of its series


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What to run: members as `stack.write_configuration` gives them, `offered_bps` of udp or tcp (iperf3) or mgen to each."""

    members: list[Member]
    folder: Path
    protocol: str
    offered_bps: float
    duration_s: float
    attach_s: float = 120.0

    def of(self, program: str) -> list[Member]:
        return [member for member in self.members if member.program == program]


def run(plan: Plan, tell: Callable[[str], None], attached: Callable[[], None]) -> None:
    """`tell` hears how far it is, `attached` is called when traffic begins. Raises CastError where a program dies, or a terminal
    does not attach in time; logs and metrics stay in the folder."""
    # A user namespace's own network starts with nothing up.
    subprocess.run(["ip", "link", "set", "lo", "up"], capture_output=True, check=False)
    with ExitStack() as context:
        processes = context.enter_context(Processes(plan.folder))
        processes.start("srsepc", ["srsepc", str(plan.folder / "epc.conf")])
        time.sleep(CORE_S)
        processes.check()
        for member in plan.of("srsenb"):
            processes.start(f"srsenb {member.node}", ["srsenb", str(member.config)])
        spaces = {}
        for member in plan.of("srsue"):
            space = spaces[member.node] = Namespace(member.node, member.address)
            context.callback(space.close)
            processes.start(f"srsue {member.node}", space.command("srsue", str(member.config)), at=plan.folder)
        _wait_for_all(plan, spaces, processes, tell)
        lead_s, waiting = (_start_mgen if plan.protocol == "mgen" else _start_iperf3)(plan, spaces, processes)
        attached()
        _wait_for_traffic(plan, processes, waiting, lead_s, tell)
        time.sleep(mgen.SETTLE_S)


def _start_iperf3(plan: Plan, spaces: dict, processes: Processes) -> tuple[float, list[str]]:
    """Seconds until it sends, and the processes that end by themselves when all is sent."""
    for member in plan.of("srsue"):
        processes.start(f"iperf3 server {member.node}", spaces[member.node].command("iperf3", "-s"))
    time.sleep(_LOOK_S * 2)
    for member in plan.of("srsue"):
        processes.start(f"iperf3 {member.node}", _client(plan, member), into=_iperf3_log(plan, member))
    return 0.0, [f"iperf3 {member.node}" for member in plan.of("srsue")]


def _start_mgen(plan: Plan, spaces: dict, processes: Processes) -> tuple[float, list[str]]:
    """As `_start_iperf3`."""
    traffic = _mgen_traffic(plan)
    addresses = {_CORE: GATEWAY} | {member.node: member.address for member in plan.of("srsue")}
    scripts, logs = mgen.write_scripts(traffic, plan.folder, addresses), mgen.logs_in(traffic, plan.folder)
    for node in traffic.nodes:
        words = mgen.command(scripts[node], logs[node])
        processes.start(f"mgen {node}", spaces[node].command(*words) if node in spaces else list(words))
    return flows.LEAD_S, []


def _mgen_traffic(plan: Plan) -> flows.Traffic:
    """Packets of one size at equal gaps from the core to every terminal."""
    return flows.Traffic(duration_s=plan.duration_s, flows=tuple(
        flows.Flow(
            number=number, name=member.node, source=_CORE, destination=member.node, pattern="periodic",
            rate_pps=plan.offered_bps / (8 * _PACKET_BYTES), size_bytes=_PACKET_BYTES, start_s=0.0, stop_s=plan.duration_s,
        )
        for number, member in enumerate(plan.of("srsue"), 1)
    ))  # fmt: skip


def _wait_for_all(plan: Plan, spaces: dict, processes: Processes, tell: Callable[[str], None]) -> None:
    waiting, end = plan.of("srsue"), time.monotonic() + plan.attach_s
    while waiting:
        processes.check()
        tell(f"waiting for {', '.join(member.node for member in waiting)} to attach")
        if time.monotonic() > end:
            raise CastError(*(
                f"{member.node}: not attached after {plan.attach_s:g} s{processes.last_words(f'srsue {member.node}')}; "
                f"see {plan.folder}" for member in waiting
            ))  # fmt: skip
        waiting = [member for member in waiting if not _is_attached(spaces[member.node], member)]
        time.sleep(_LOOK_S)


def _wait_for_traffic(plan: Plan, processes: Processes, waiting: list[str], lead_s: float, tell: Callable[[str], None]) -> None:
    begin = time.monotonic() + lead_s
    for name in waiting:
        processes.may_end(name)  # between two looks too
    while waiting or time.monotonic() - begin < plan.duration_s:
        waiting = [name for name in waiting if not processes.has_ended(name)]
        processes.check()
        passed_s = time.monotonic() - begin
        if passed_s > plan.duration_s + ANSWER_S:  # a link that carries nothing any more: TCP alone would try for many minutes
            raise CastError(*(
                f"{name}: not through {ANSWER_S:g} s after its {plan.duration_s:g} s{processes.last_words(name)}; what was "
                "recorded until then is kept" for name in waiting
            ))  # fmt: skip
        tell(f"{min(max(passed_s, 0.0), plan.duration_s):.1f} of {plan.duration_s:g} s")
        time.sleep(_LOOK_S)


def _is_attached(space: Namespace, member: Member) -> bool:
    words = space.command("ip", "-4", "-oneline", "address", "show", "dev", _TUNNEL)
    shown = subprocess.run(words, capture_output=True, text=True, check=False)
    return f"inet {member.address}/" in shown.stdout


def _client(plan: Plan, member: Member) -> list[str]:
    kind = ["--udp"] if plan.protocol == "udp" else []
    rate = ["--bitrate", f"{plan.offered_bps:.0f}"]
    length = ["--time", f"{plan.duration_s:g}", "--interval", "1"]
    return ["iperf3", "--client", member.address, "--bind", GATEWAY, *kind, *rate, *length, "--json", "--get-server-output"]


def _iperf3_log(plan: Plan, member: Member) -> Path:
    return plan.folder / f"iperf3_{plan.protocol}_{member.node}.json"


def collect(plan: Plan) -> tuple[dict[str, dict[str, Series]], list[str]]:
    """Quantity to terminal to series of all that was recorded, and a line for everything that was not."""
    found, missing = {"sinr_db": {}, f"{plan.protocol}_bps": {}, "dl_bps": {}, "loss": {}, "latency_s": {}}, []
    readers = [lambda member=member: {member.node: stack.read_terminal_metrics(member.metrics)} for member in plan.of("srsue")]
    if plan.protocol == "mgen":
        readers.append(lambda: _read_mgen(plan))
    else:
        readers += [
            lambda member=member: {member.node: {f"{plan.protocol}_bps": stack.read_iperf3(_iperf3_log(plan, member))}}
            for member in plan.of("srsue")
        ]
    for read in readers:
        try:
            for node, quantities in read().items():
                for quantity, series in quantities.items():
                    found[quantity][node] = series
        except CastError as error:
            missing += error.faults
    return {quantity: series for quantity, series in found.items() if series}, missing


def _read_mgen(plan: Plan) -> dict[str, dict[str, Series]]:
    """Terminal to quantity to series of MGEN's logs."""
    traffic = _mgen_traffic(plan)
    found = {}
    for result in log.evaluate(traffic, mgen.logs_in(traffic, plan.folder)):
        series = log.series(result, traffic.duration_s, _STEP_S)
        found[result.flow.name] = {
            "mgen_bps" if quantity == "throughput_bps" else quantity: Series(name=quantity, time_s=time_s, value=value)
            for quantity, (time_s, value) in series.items()
        }
    return found
