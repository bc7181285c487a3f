# SPDX-License-Identifier: GPL-3.0-or-later
"""Traffic of a job: real MGEN behind tr0 of every SRN, as Colosseum sends it: port = flow id, a dummy packet ahead, .drc logs."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

from ..core.files import write_text
from ..experiments.traffic import flows, log
from ..experiments.traffic.flows import LEAD_S, Traffic
from ..experiments.traffic.namespaces import Namespace
from ..experiments.traffic.run import command

FIRST_ID = 5001
DUMMY_LEAD_S = 15.0
_DUMMY_ID = 60000  # of no flow that is counted


def is_installed() -> bool:
    return shutil.which("mgen") is not None


def read(path: Path, duration_s: float) -> Traffic:
    """A traffic scenario over `duration_s`, flows numbered by their ids."""
    traffic = flows.stretched(flows.read(path), duration_s)
    return replace(traffic, flows=tuple(replace(flow, number=FIRST_ID - 1 + flow.number) for flow in traffic.flows))


def script(traffic: Traffic, node: str, address: dict[str, str], lead_s: float) -> str:
    """What MGEN does at a node: a port for every flow that ends there, a dummy packet at once, its flows from `lead_s` on."""
    lines = [f"0.0 LISTEN UDP {flow.number}" for flow in traffic.flows if flow.destination == node]
    for flow in (flow for flow in traffic.flows if flow.source == node):
        where = f"SRC {flow.number} DST {address[flow.destination]}/{flow.number}"
        pattern = f"{'POISSON' if flow.pattern == 'poisson' else 'PERIODIC'} [{flow.rate_pps:g} {flow.size_bytes}]"
        if flow.pattern == "burst":
            pattern = f"BURST [REGULAR {flow.every_s:g} {pattern} FIXED {flow.length_s:g}]"
        dummy = _DUMMY_ID + flow.number - FIRST_ID
        lines += [
            f"0.1 ON {dummy} UDP {where.replace(f'SRC {flow.number}', f'SRC {dummy}')} PERIODIC [1 {flow.size_bytes}] COUNT 1",
            f"{lead_s + flow.start_s:g} ON {flow.number} UDP {where} {pattern}",
            f"{lead_s + flow.stop_s:g} OFF {flow.number}",
        ]
    return "\n".join(lines) + "\n"


class Generators:
    """MGEN at every node of a traffic scenario; `ends` maps a node's number to the network behind its SRN's tr0."""

    def __init__(self, traffic: Traffic, ends: dict[str, Namespace], folder: Path, time_scale: float = 1.0):
        folder.mkdir(parents=True, exist_ok=True)
        self.lead_s = max(LEAD_S, DUMMY_LEAD_S / time_scale)
        here = [flow for flow in traffic.flows if flow.source in ends and flow.destination in ends]
        self.traffic, self.left_out = replace(traffic, flows=tuple(here)), len(traffic.flows) - len(here)
        self._logs, self._running = {}, {}
        address = {node: end.address for node, end in ends.items()}
        for node in self.traffic.nodes:
            path = folder / f"{ends[node].name}.mgn"
            write_text(path, script(self.traffic, node, address, self.lead_s))
            self._logs[node] = folder / f"{ends[node].name}.drc"
            words = ends[node].command(*command(path, self._logs[node]))
            self._running[node] = subprocess.Popen(
                ["setpriv", "--pdeathsig", "KILL", *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )

    def stop(self) -> None:
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._running = {}

    def results(self) -> list[dict]:
        """A row for every flow."""
        if not self.traffic.flows:
            return []
        return [log.row(result) for result in log.evaluate(self.traffic, self._logs)]
