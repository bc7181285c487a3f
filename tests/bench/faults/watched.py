# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs that are watched from outside: what they leave behind, and whether they end."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from gr_cast.core.errors import CastError
from gr_cast.core.files import locked
from gr_cast.signals import recording

ROOT = Path(__file__).resolve().parents[3]
GONE_S = 5.0  # until what a program started has followed it
_MARK = "CAST_BENCH_FAULTS"
_EARLY = re.compile(r"KeyboardInterrupt\s*$")  # of an interpreter that has not come to the program yet, to its `main`


class Wrong(Exception):
    """What must not be: the line says it."""


@dataclass
class Ended:
    """How a program ended: its status, and what it told of errors."""

    status: int
    errors: str


class Watched:
    """A program of apps/ (or another file) in a session of its own, with a folder for what it keeps for a while."""

    def __init__(self, folder: Path, *command):
        self.mark = f"{os.getpid()}-{time.monotonic_ns()}"
        spare = folder / "tmp"
        spare.mkdir(exist_ok=True)
        environment = os.environ | {_MARK: self.mark, "TMPDIR": str(spare), "MPLBACKEND": "Agg", "HOME": str(folder)}
        environment["PYTHONFAULTHANDLER"] = "1"  # see `stuck`
        program, *rest = map(str, command)
        program = str(ROOT / "apps" / program) if not program.startswith("/") else program
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "errors": "replace"}
        self.process = subprocess.Popen(
            [sys.executable, program, *rest], cwd=folder, env=environment, start_new_session=True, **pipes
        )

    def signal(self, number: int) -> bool:
        """Send a signal, unless it has ended already."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.process.returncode is None

    def ended(self, within_s: float) -> Ended:
        """Wait for the end. Raises Wrong where it does not come in time; what the machine made it wait for a processor does
        not count."""
        began_s, before_s = time.monotonic(), self.kept_waiting_s()
        waited_s, errors = before_s, None
        while errors is None:
            waited_s = max(waited_s, self.kept_waiting_s())  # who has ended tells no more
            left_s = within_s + waited_s - before_s - (time.monotonic() - began_s)
            if left_s <= 0:
                where = self.stuck()
                self.end()
                raise Wrong(f"had not ended after {within_s:g} s: {where}")
            with contextlib.suppress(subprocess.TimeoutExpired):
                _, errors = self.process.communicate(timeout=max(left_s, 0.1))
        if "Traceback" in errors and not (_EARLY.search(errors) and ", in main\n" not in errors):
            raise Wrong(f"traceback: {errors.strip()[-1500:]}")
        return Ended(self.process.returncode, errors)

    def kept_waiting_s(self) -> float:
        """How long its thread that waited most was ready to run and had no processor (proc(5), schedstat)."""
        waited_ns = [0]
        for pid in [self.process.pid, *self.alive()]:
            with contextlib.suppress(OSError):  # it has ended
                waited_ns += [int(path.read_text().split()[1]) for path in Path(f"/proc/{pid}/task").glob("*/schedstat")]
        return max(waited_ns) / 1e9

    def stuck(self) -> str:
        """End it, and tell where each of its threads was (Python's faulthandler), or what it had told."""
        self.signal(signal.SIGABRT)
        try:
            told = self.process.communicate(timeout=GONE_S)[1].partition("Extension modules")[0]
            return told[-3000:]
        except subprocess.TimeoutExpired:
            return "not even ended by SIGABRT"

    def end(self) -> None:
        """Kill it and all that it started."""
        for pid in [self.process.pid, *self.alive()]:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
        self.process.communicate()

    def alive(self) -> list[int]:
        """Processes that it started, or that these started."""
        found = []
        for place in Path("/proc").glob("[0-9]*"):
            try:
                if f"{_MARK}={self.mark}".encode() in (place / "environ").read_bytes().split(b"\0"):
                    found.append(int(place.name))
            except OSError:  # another's, or gone
                pass
        return found

    def check_gone(self) -> None:
        """Raises Wrong where a process of it is left."""
        due = time.monotonic() + GONE_S
        while left := self.alive():
            if time.monotonic() > due:
                self.end()
                raise Wrong(f"{len(left)} processes left behind")
            time.sleep(0.05)


def check_tidy(folder: Path) -> None:
    """Raises Wrong where a file for a while, a socket or a lock is left in a folder or in TMPDIR."""
    aside = [path.name for path in folder.rglob(".aside-*")]
    sockets = [path.name for path in folder.rglob("*") if path.is_socket()]
    kept = [path.name for path in (folder / "tmp").glob("*")]
    if aside or sockets or kept:
        raise Wrong(f"left behind: {', '.join([*aside, *sockets, *kept][:5])}")
    for place in [folder, *(path for path in folder.rglob("*") if path.is_dir())]:
        try:
            with locked(place):
                pass
        except CastError as error:
            raise Wrong(f"left locked: {error}") from None


def check_recordings(folder: Path) -> None:
    """Raises Wrong for a recording with samples that is not readable."""
    for meta in folder.rglob("*.sigmf-meta"):
        data = meta.with_suffix(".sigmf-data")
        if not data.exists() or data.stat().st_size == 0:
            continue
        try:
            recording.read(meta)
        except CastError as error:
            raise Wrong(f"unreadable recording: {error.faults[0]}") from None


def namespaces() -> set[str]:
    """Network namespaces that have a name."""
    place = Path("/run/netns")
    return {path.name for path in place.iterdir()} if place.is_dir() else set()
