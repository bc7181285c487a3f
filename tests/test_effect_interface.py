# SPDX-License-Identifier: GPL-3.0-or-later
"""What the engine asks of a family of physics is declared in one place, and the engine knows no family by its name."""

import ast
from pathlib import Path

import pytest
from gr_cast.twin.effects import FAMILIES, Role, with_role

PACKAGE = Path(__file__).resolve().parents[1] / "python" / "gr_cast"
NAMELESS = ("diagnose", "report", "twin")  # rooms, without those below them, in which no family may be named


def _names(path: Path) -> list[str]:
    """Line and name of every family that a source file names."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    words = [n for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    return [f"{path.name}:{n.lineno}: {n.value}" for n in words if n.value in FAMILIES]


@pytest.mark.parametrize("place", NAMELESS)
def test_no_family_is_known_by_its_name(place):
    assert [name for path in sorted((PACKAGE / place).glob("*.py")) for name in _names(path)] == []


def test_every_part_of_a_radio_is_played_by_one_family():
    for role in Role:
        assert [f.name for f in FAMILIES.values() if f.role is role] == [with_role(role).name]


def test_nothing_of_a_family_is_looked_for_that_is_not_declared():
    """`hasattr` and `getattr` with a name would ask a family for what the interface does not say."""
    probes = []
    for path in sorted([*PACKAGE.glob("diagnose/*.py"), *PACKAGE.glob("twin/**/*.py")]):
        calls = [n for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.Call)]
        probes += [f"{path.name}:{c.lineno}" for c in calls if getattr(c.func, "id", "") in ("hasattr", "getattr")]
    assert probes == []
