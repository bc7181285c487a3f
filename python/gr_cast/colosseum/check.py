# SPDX-License-Identifier: GPL-3.0-or-later
"""An image's radio API, looked at without running it: a line for each fault, with file and line.

What a program does cannot be told from its text in general: what is named here is certain to fail or to wait, or waits for
something that its text does not bound.
"""

import posixpath
import re
import stat
from pathlib import Path

from ..core.documents import short
from . import image as images
from .blocking import waits
from .image import RADIO_API, Image
from .paths import cannot_run, unwritten
from .printed import no_json

SCRIPTS = ("start.sh", "stop.sh", "status.sh", "update_environment.sh", "update_outcomes.sh", "scenario_discontinuity.sh")
STATES = ("OFF", "BOOTING", "READY", "ACTIVE", "STOPPING", "FINISHED", "ERROR")
_STATE = re.compile(r"STATUS\\?[\"']\s*:\s*\\?[\"']([A-Za-z_]+)\\?[\"']")


def faults_of(path: Path) -> list[str]:
    """Every fault of an image: `IMAGE: FILE:LINE: what, got, limit`. CastError where it is no image at all."""
    image = images.read(path)
    found = [f"{images.METADATA}: {fault}" for fault in image.metadata_faults]
    for name in SCRIPTS:
        place = image.resolved(f"{RADIO_API}/{name}")
        entry = image.entries.get(place)
        if entry is None:
            found.append(f"{RADIO_API}/{name}: missing: Colosseum calls it")
            continue
        found += [f"{RADIO_API}/{name}:{line}: {text}" for line, text in _script_faults(image, place, entry)]
    return [f"{path.name}: {line}" for line in found]


def _script_faults(image: Image, place: str, entry: images.Entry) -> list[tuple[int, str]]:
    if not stat.S_ISREG(entry.mode):
        return [(1, "not a file")]
    found = []
    if not entry.mode & 0o111:
        found.append((1, f"mode {stat.S_IMODE(entry.mode):04o}: no run bit: chmod 755"))
    text = image.texts.get(place)
    if text is None:
        return found  # a program, not a script
    found += _interpreter_faults(image, text)
    found += waits(image, place)
    found += cannot_run(image, place)
    found += unwritten(image, place)
    if place.endswith("/status.sh"):
        found += no_json(image, place)
        for number, line in enumerate(text.splitlines(), 1):
            found += [
                (number, f"status {short(state)}: needs one of {', '.join(STATES)}")
                for state in _STATE.findall(line)
                if state not in STATES
            ]
    return sorted(set(found))


def _interpreter_faults(image: Image, text: str) -> list[tuple[int, str]]:
    """A kernel runs a script by its first line alone: `#!`, then a program that is there."""
    first = text.split("\n", 1)[0]
    if not first.startswith("#!"):
        return [(1, f"got {short(first)}, no interpreter line: needs #! as its first two characters, such as #!/bin/sh")]
    if first.endswith("\r"):
        return [(1, "lines end in CR LF: the kernel looks for an interpreter whose name ends in CR")]
    words = first[2:].split()
    program = words[0] if words else ""
    if not program.startswith("/"):
        return [(1, f"got {short(first)}, needs the interpreter's whole path, such as #!/bin/sh")]
    entry = image.entry(program)
    if entry is None or not entry.mode & 0o111:
        return [(1, f"interpreter {program}: not in the image, or without a run bit")]
    if posixpath.basename(program) == "env" and len(words) > 1:
        name = next((w for w in words[1:] if not w.startswith("-") and "=" not in w), "")
        folders = ("/usr/local/sbin", "/usr/local/bin", "/usr/sbin", "/usr/bin", "/sbin", "/bin")
        if not any(image.entry(f"{folder}/{name}") for folder in folders):
            return [(1, f"interpreter {name}: not in the image's {', '.join(folders)}")]
    return []
