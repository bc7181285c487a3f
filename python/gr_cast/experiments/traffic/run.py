# SPDX-License-Identifier: GPL-3.0-or-later
"""MGEN at every node, from the first packet to the last, watched."""

import shutil
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from ...core.errors import CastError
from ...core.files import write_text
from ...core.processes import Processes
from .flows import LEAD_S, Traffic, script
from .namespaces import Namespace

SETTLE_S = 0.5  # after the last packet has left: what is on its way arrives
_LOOK_S = 0.1


def check_mgen() -> None:
    """Raises CastError where MGEN is not installed."""
    if shutil.which("mgen") is None:
        raise CastError("mgen: not installed (Debian: apt install mgen)")


def write_scripts(traffic: Traffic, folder: Path, address: dict[str, str] | None = None) -> dict[str, Path]:
    """NODE.mgn for every node; `address` as `flows.script` takes it."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = {node: folder / f"{node}.mgn" for node in traffic.nodes}
    for node, path in paths.items():
        write_text(path, script(traffic, node, address))
    return paths


def generate(
    traffic: Traffic,
    nodes: Sequence[Namespace],
    folder: Path,
    *,
    is_quiet: Callable[[], bool],
    progress: Callable[[float], None],
    patience_s: float = 60.0,
) -> dict[str, Path]:
    """MGEN at every node until the flows have ended and `is_quiet`, at most `patience_s` more; logs by node come out.

    Raises CastError as soon as an MGEN ends by itself, or where it does not grow quiet; the logs are there all the same.
    """
    scripts, logs = write_scripts(traffic, folder), logs_in(traffic, folder)
    with Processes(folder) as processes:
        for node in nodes:
            processes.start(f"mgen of node {node.name}", node.command(*command(scripts[node.name], logs[node.name])))
        begin = time.monotonic() + LEAD_S
        while (passed_s := time.monotonic() - begin) < traffic.duration_s or not is_quiet():
            if passed_s > traffic.duration_s - LEAD_S:  # an MGEN that only sends ends by itself, while packets still wait
                for node in nodes:
                    processes.may_end(f"mgen of node {node.name}")
            processes.check()
            if passed_s > traffic.duration_s + patience_s:
                raise CastError(f"packets still wait {patience_s:g} s after the last flow: the radio is slower than real time")
            progress(min(passed_s, traffic.duration_s))
            time.sleep(_LOOK_S)
        time.sleep(SETTLE_S)
    return logs


def command(script_path: Path, log_path: Path) -> tuple[str, ...]:
    """The words that run MGEN."""
    return ("mgen", "flush", "input", str(script_path), "output", str(log_path), "txlog")


def logs_in(traffic: Traffic, folder: Path) -> dict[str, Path]:
    """Where MGEN's log of every node is."""
    return {node: folder / f"{node}.log" for node in traffic.nodes}
