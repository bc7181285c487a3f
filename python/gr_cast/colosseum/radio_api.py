# SPDX-License-Identifier: GPL-3.0-or-later
"""A call of a radio API script: what it printed, its exit status, how long it took, and what is wrong with it."""

import os
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

from ..core.documents import json_text, short
from ..core.errors import CastError
from .blocking import LIMIT_S
from .check import STATES

MOST_PRINTED = 64 * 1024  # bytes of a call that are kept, and that a script may print
_LOOK_S = 0.02


@dataclass(frozen=True, kw_only=True)
class Call:
    """One call. `status` is None where it was ended at the limit; `state` what `status.sh` said, "" where it said none."""

    srn: int
    script: str
    at_s: float
    seconds: float
    status: int | None
    printed: str
    errors: str
    state: str = ""
    info: str = ""
    faults: tuple[str, ...] = ()


def call(words: list[str], *, srn: int, script: str, at_s: float, folder: Path) -> Call:
    """Run `words`, which call a script, and wait for LIMIT_S at most. What it starts in the background goes on, and may keep its
    output open: nobody waits for that."""
    out, err = folder / "out", folder / "err"
    began = time.monotonic()
    with open(out, "wb") as to_out, open(err, "wb") as to_err:
        process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=to_out, stderr=to_err, start_new_session=True)
    try:
        status = process.wait(LIMIT_S)
    except subprocess.TimeoutExpired:
        status = None
        _end(process)
    seconds = time.monotonic() - began
    size = out.stat().st_size
    printed, errors = (_text(path) for path in (out, err))
    out.unlink()
    err.unlink()
    faults = []
    if status is None:
        faults.append(f"took more than {LIMIT_S:g} s: ended")
    elif status:
        faults.append(f"exit status {status}, needs 0" + (f": {errors.strip().splitlines()[-1][:200]}" if errors.strip() else ""))
    if size > MOST_PRINTED:
        faults.append(f"printed {size} bytes, limit {MOST_PRINTED} bytes")
    state = info = ""
    if script == "status.sh" and status is not None:
        state, info, fault = state_of(printed)
        faults += [fault] if fault else []
    return Call(
        srn=srn, script=script, at_s=at_s, seconds=seconds, status=status, printed=printed, errors=errors, state=state, info=info,
        faults=tuple(faults),
    )  # fmt: skip


def _text(path: Path) -> str:
    with open(path, "rb") as file:
        return file.read(MOST_PRINTED).decode("utf-8", errors="replace")


def state_of(printed: str) -> tuple[str, str, str]:
    """(state, information, what is wrong) of what `status.sh` printed."""
    try:
        document = json_text(printed, "status.sh", kind=(dict, list)).document
    except CastError:
        return "", "", f"printed {short(printed.strip())}, needs JSON with STATUS and INFO"
    if not isinstance(document, dict) or document.get("STATUS") not in STATES:
        got = document.get("STATUS") if isinstance(document, dict) else document
        return "", "", f"STATUS: got {short(got)}, needs one of {', '.join(STATES)}"
    return document["STATUS"], str(document.get("INFO", ""))[:1000], ""


def _end(process: subprocess.Popen) -> None:
    """End a script that is waited for, with what it waits for itself; what has left it (nohup, setsid, &) goes on."""
    for pid in [*reversed(_descendants(process.pid)), process.pid]:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
    process.wait()


def _descendants(pid: int) -> list[int]:
    """Children, and theirs, as this machine numbers them."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except (OSError, UnicodeDecodeError):
            continue
        parents.setdefault(int(fields[1]), []).append(int(path.parent.name))
    found, waiting = [], [pid]
    while waiting:
        waiting += (children := parents.get(waiting.pop(), []))
        found += children
    return found
