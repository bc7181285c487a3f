# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a command may take: seconds in which it waits for a processor of a busy machine do not count."""

import subprocess
import time
from pathlib import Path

from ..core.errors import CastError

LONGEST = 10.0  # times its limit that a command may take in all, however busy the machine is
_LOOK_S = 0.5
_PROC = Path("/proc")


class Stopped(CastError):
    """A command had its time. Of what it does nothing is known, so that no stage keeps this."""

    def __init__(self, what: str, key: str):
        super().__init__(f"{what}. The next run does it again; if it needs longer: limits.{key} in pipeline.yaml, or --patience")


def waited(process: subprocess.Popen, limit_s: float) -> int | None:
    """The exit status of a process; None once it has had `limit_s`, or LONGEST times as long with all that it queued for."""
    begun_s = before_s = time.monotonic()
    had_s, queued = 0.0, {}
    while (left_s := min(limit_s - had_s, LONGEST * limit_s - (before_s - begun_s))) > 0:
        try:
            return process.wait(min(_LOOK_S, left_s))
        except subprocess.TimeoutExpired:
            now_s, then, queued = time.monotonic(), queued, _queued_s(process.pid)
            waits = (value - then.get(thread, 0.0) for thread, value in queued.items())
            had_s += max(0.0, now_s - before_s - max(waits, default=0.0))
            before_s = now_s
    return None


def _queued_s(pid: int) -> dict[str, float]:
    """Thread → seconds that it has waited for a processor so far, of a process and all that it has started."""
    parents = {}
    for path in _PROC.glob("[0-9]*/stat"):
        if told := _read(path):
            parents[int(path.parent.name)] = int(told.rpartition(")")[2].split()[1])
    family = {pid}
    while more := {child for child, parent in parents.items() if parent in family} - family:
        family |= more
    tasks = (task for one in family for task in _PROC.glob(f"{one}/task/*"))
    return {task.name: int(told.split()[1]) / 1e9 for task in tasks if (told := _read(task / "schedstat"))}


def _read(path: Path) -> str:
    """Nothing where it has ended meanwhile, or the kernel keeps no such account: then the clock on the wall counts."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
