# SPDX-License-Identifier: GPL-3.0-or-later
"""MGEN at every node, from the first packet to the last, watched."""

import shutil
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from ..errors import CastError
from ..files import write_text
from .flows import LEAD_S, Traffic, script
from .namespaces import Namespace

SETTLE_S = 0.5  # after the last packet has left: what is on its way arrives
_LOOK_S = 0.1


def check_mgen() -> None:
    """Raises CastError where MGEN is not installed."""
    if shutil.which("mgen") is None:
        raise CastError("mgen: not installed (Debian: apt install mgen)")


def write_scripts(traffic: Traffic, folder: Path) -> dict[str, Path]:
    """NODE.mgn for every node."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = {node: folder / f"{node}.mgn" for node in traffic.nodes}
    for node, path in paths.items():
        write_text(path, script(traffic, node))
    return paths


class Generators:
    """The MGEN processes of a run; `logs` maps a node to its log."""

    def __init__(self, traffic: Traffic, nodes: Sequence[Namespace], folder: Path):
        self._duration_s = traffic.duration_s
        scripts = write_scripts(traffic, folder)
        self.logs = {node.name: folder / f"{node.name}.log" for node in nodes}
        self._processes = {}
        for node in nodes:
            # It must not outlive this process, however that ends.
            bound = ("setpriv", "--pdeathsig", "TERM")
            words = ("mgen", "flush", "input", str(scripts[node.name]), "output", str(self.logs[node.name]), "txlog")
            with open(folder / f"{node.name}.out", "wb") as out:
                self._processes[node.name] = subprocess.Popen(
                    node.command(*bound, *words), stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL
                )
        self._folder = folder
        self._begin = time.monotonic()

    def watch(self, is_quiet: Callable[[], bool], progress: Callable[[float], None], patience_s: float = 60.0) -> None:
        """Wait for the end of the flows and until `is_quiet`, at most `patience_s` more.

        Raises CastError as soon as an MGEN ends by itself, or where it does not grow quiet.
        """
        end = self._begin + LEAD_S + self._duration_s
        while (now := time.monotonic()) < end or not is_quiet():
            for node, process in self._processes.items():
                if process.poll() is not None:
                    raise CastError(
                        f"node {node}: mgen ended after {now - self._begin - LEAD_S:.1f} s with status {process.returncode}"
                        f"{self._complaint(node)}; what was logged until then is kept"
                    )
            if now > end + patience_s:
                raise CastError(f"packets still wait {patience_s:g} s after the last flow: the radio is slower than real time")
            progress(min(now - self._begin - LEAD_S, self._duration_s))
            time.sleep(_LOOK_S)
        time.sleep(SETTLE_S)

    def _complaint(self, node: str) -> str:
        lines = (self._folder / f"{node}.out").read_text(errors="replace").splitlines()
        wrong = [line for line in lines if "rror" in line]
        return f" ({wrong[0]})" if wrong else ""

    def stop(self) -> None:
        for process in self._processes.values():
            process.terminate()
        for process in self._processes.values():
            try:
                process.wait(timeout=5)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
