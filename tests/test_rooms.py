# SPDX-License-Identifier: GPL-3.0-or-later
"""The rooms follow the data flow: none imports a later one, and each loads without what it must not need."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "python" / "gr_cast"
ORDER = "core signals scenario emulation sounding comparing twin diagnose experiments colosseum pipeline report blocks".split()


def rooms_imported(path: Path):
    """(line, room) of every import of gr_cast in a file."""
    here = path.relative_to(PACKAGE).parent.parts
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.ImportFrom):
            continue
        if node.level:
            base = here[: len(here) - node.level + 1]
            names = [*base, *(node.module or "").split(".")] if node.module else [*base]
            found = names[:1] or [a.name for a in node.names]
            yield from ((node.lineno, room) for room in found if room in ORDER)


def test_no_room_imports_a_later_one():
    wrong = []
    for path in sorted(PACKAGE.glob("*/**/*.py")):
        room = path.relative_to(PACKAGE).parts[0]
        wrong += [
            f"{path.relative_to(PACKAGE)}:{line} imports {other}"
            for line, other in rooms_imported(path)
            if ORDER.index(other) > ORDER.index(room)
        ]
    assert wrong == []


def test_every_module_lies_in_a_room():
    assert {p.name for p in PACKAGE.iterdir() if p.is_dir() and p.name != "__pycache__"} == {*ORDER, "bindings"}
    assert [p.name for p in PACKAGE.glob("*.py")] == ["__init__.py"]


GNU_RADIO = ("gnuradio", "gr_cast.blocks", "pmt", "uhd")
PICTURES = ("matplotlib",)
LATER_THAN_TWIN = ("gr_cast.diagnose", "gr_cast.experiments", "gr_cast.report", *GNU_RADIO, *PICTURES)


@pytest.mark.parametrize(
    ("module", "blocked"),
    [
        ("gr_cast.twin.playback", LATER_THAN_TWIN),
        ("gr_cast.diagnose", (*GNU_RADIO, *PICTURES)),
        ("gr_cast.scenario", ("gr_cast.sounding", "gr_cast.diagnose", *GNU_RADIO, *PICTURES)),
        ("gr_cast.sounding.cir", ("gr_cast.comparing", *GNU_RADIO, *PICTURES)),
        ("gr_cast.comparing.similarity", ("gr_cast.diagnose", *GNU_RADIO, *PICTURES)),
        ("gr_cast.experiments.jamming", ("gr_cast.report", *GNU_RADIO, *PICTURES)),
        ("gr_cast.colosseum.check", ("gr_cast.report", *GNU_RADIO, *PICTURES)),
        ("gr_cast.report.plot", ("gr_cast.diagnose", "scipy.stats", *GNU_RADIO)),  # what programs wait for that only draw
        ("gr_cast.report.place.planning", ("gr_cast.diagnose", *GNU_RADIO)),
        ("gr_cast.report.link.page", GNU_RADIO),
        ("gr_cast.report.place.page", GNU_RADIO),
    ],
)
def test_a_room_loads_without_what_it_must_not_need(module, blocked):
    code = f"import sys; sys.modules.update(dict.fromkeys({blocked!r})); import {module}"
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
