# SPDX-License-Identifier: GPL-3.0-or-later
"""GNU Radio where HOME cannot be written to."""

import atexit
import os
from contextlib import ExitStack
from pathlib import Path

from ..core.files import passing_folder


def settle() -> None:
    """Give GNU Radio a HOME that it can write to: it keeps notes and locks there, and without them ends its first flowgraph or
    transform with an error. What lies in the user's own data folder is still found there."""
    home = os.environ.get("HOME")
    if not home or _takes_notes(Path(home) / ".gnuradio"):
        return
    kept = ExitStack()
    elsewhere = kept.enter_context(passing_folder())
    atexit.register(kept.close)
    os.environ["XDG_DATA_HOME"] = os.environ.get("XDG_DATA_HOME") or f"{home}/.local/share"
    os.environ["HOME"] = str(elsewhere)


def _takes_notes(folder: Path) -> bool:
    try:
        folder.mkdir(exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK) and os.access(folder.parent, os.W_OK | os.X_OK)
