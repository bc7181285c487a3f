# SPDX-License-Identifier: GPL-3.0-or-later
"""One run of srsRAN 4G over an emulator that is already there: core, stations, terminals in namespaces, iperf3 to each."""

import subprocess
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from ..errors import CastError
from ..processes import Processes
from ..series import Series
from ..traffic.namespaces import Namespace
from . import stack
from .stack import GATEWAY, Member

CORE_S = 2.0  # until the core listens
_LOOK_S = 0.2
_TUNNEL = "tun_srsue"


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What to run: members as `stack.write_configuration` gives them, `offered_bps` of udp or tcp to each terminal."""

    members: list[Member]
    folder: Path
    protocol: str
    offered_bps: float
    duration_s: float
    attach_s: float = 120.0

    def of(self, program: str) -> list[Member]:
        return [member for member in self.members if member.program == program]


def run(plan: Plan, tell: Callable[[str], None]) -> None:
    """Raises CastError where a program dies, or a terminal does not attach in time; logs and metrics stay in the folder."""
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
            processes.start(f"srsue {member.node}", space.command("srsue", str(member.config)))
        _wait_for_all(plan, spaces, processes, tell)
        for member in plan.of("srsue"):
            processes.start(f"iperf3 server {member.node}", spaces[member.node].command("iperf3", "-s"))
        time.sleep(_LOOK_S * 2)
        for member in plan.of("srsue"):
            processes.start(f"iperf3 {member.node}", _client(plan, member), into=_iperf3_log(plan, member))
        waiting, begin = [member.node for member in plan.of("srsue")], time.monotonic()
        while waiting:
            waiting = [node for node in waiting if not processes.has_ended(f"iperf3 {node}")]
            processes.check()
            tell(f"{min(time.monotonic() - begin, plan.duration_s):.1f} of {plan.duration_s:g} s")
            time.sleep(_LOOK_S)


def _wait_for_all(plan: Plan, spaces: dict, processes: Processes, tell: Callable[[str], None]) -> None:
    waiting, end = plan.of("srsue"), time.monotonic() + plan.attach_s
    while waiting:
        processes.check()
        tell(f"waiting for {', '.join(member.node for member in waiting)} to attach")
        if time.monotonic() > end:
            raise CastError(f"{waiting[0].node}: not attached after {plan.attach_s:g} s; see {plan.folder}")
        waiting = [member for member in waiting if not _is_attached(spaces[member.node], member)]
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
    found, missing = {"sinr_db": {}, f"{plan.protocol}_bps": {}, "dl_bps": {}}, []
    for member in plan.of("srsue"):
        for read in (
            lambda member=member: stack.read_terminal_metrics(member.metrics),
            lambda member=member: {f"{plan.protocol}_bps": stack.read_iperf3(_iperf3_log(plan, member))},
        ):
            try:
                for quantity, series in read().items():
                    found[quantity][member.node] = series
            except CastError as error:
                missing += error.faults
    return {quantity: series for quantity, series in found.items() if series}, missing
