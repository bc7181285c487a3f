# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that are whole or not there: written aside, then renamed."""

import json
import os
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_aside(path: str | Path):
    """Gives a path beside `path` to write to; renames it to `path` when all went well, removes it otherwise."""
    path = Path(path)
    aside = path.with_name(f".{os.getpid()}.{path.name}")  # the suffix stays: writers go by it
    try:
        yield aside
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    with written_aside(path) as aside:
        aside.write_text(text, encoding="utf-8")


def write_json(path: str | Path, value) -> None:
    """JSON as the standard has it: NaN and infinities are refused, callers say null."""
    write_text(path, json.dumps(value, indent=1, allow_nan=False) + "\n")
