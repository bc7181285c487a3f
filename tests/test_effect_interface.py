# SPDX-License-Identifier: GPL-3.0-or-later
"""What the engine asks of a family of physics is declared in one place, and the engine knows no family by its name."""

import ast
import inspect
import re
from pathlib import Path

import pytest
from gr_cast.twin.effects import FAMILIES, Family, Role, with_role
from gr_cast.twin.effects.base import AUX

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


def _declared() -> dict:
    return {name: value for name, value in inspect.getmembers(Family) if not name.startswith("_")}


@pytest.mark.parametrize("name", list(FAMILIES))
def test_a_family_has_no_public_name_that_the_interface_does_not_declare(name):
    assert {a for a in dir(FAMILIES[name]) if not a.startswith("_")} - set(_declared()) == set()


@pytest.mark.parametrize("name", list(FAMILIES))
def test_a_family_is_asked_as_the_interface_says(name):
    """A number, a name or a truth of the interface is one in the family, and a question has the same arguments."""
    family, asked = FAMILIES[name], Family()
    for attribute, declared in _declared().items():
        if inspect.isfunction(declared):
            own, said = (list(inspect.signature(getattr(f, attribute)).parameters) for f in (family, asked))
            assert own == said, attribute
        elif isinstance(declared, bool | str | float | tuple | dict):
            assert isinstance(getattr(family, attribute), type(declared)), attribute


def test_everything_that_is_declared_says_what_it_is():
    """A question in its docstring, an attribute in the comment behind it."""
    source = inspect.getsource(Family).splitlines()
    for name, declared in _declared().items():
        if inspect.isfunction(declared):
            assert declared.__doc__, name
            arguments = set(inspect.signature(declared).parameters) - {"self", "view", "rng"}
            assert set(declared.__annotations__) >= {"return", *arguments}, name
    attributes = [line for line in source if re.match(r"    (?!def )[a-z_]+(: .*)? = ", line)]
    plain = ("name", "role", "stage", "multiplicity")
    assert [line for line in attributes if "#" not in line and not line.strip().startswith(plain)] == []


def test_the_engine_asks_nothing_of_an_effect_beside_its_numbers_that_is_not_declared():
    asked = set()
    for path in [*PACKAGE.glob("diagnose/*.py"), *PACKAGE.glob("report/*.py"), *PACKAGE.glob("twin/*.py")]:
        text = path.read_text(encoding="utf-8")
        asked |= {m.group(1) for m in re.finditer(r'aux(?:\.get\(|\[)"(\w+)"', text)}
        asked |= {m.group(1) for m in re.finditer(r'"(\w+)" (?:not )?in [\w.\[\]]*\.aux', text)}
    assert asked and asked <= set(AUX)


def test_the_engine_loads_no_family_by_its_module():
    families = {path.stem for path in (PACKAGE / "twin" / "effects").glob("*.py")} - {"__init__", "base", "noise_family"}
    loaded = []
    for path in sorted([*PACKAGE.glob("diagnose/*.py"), *PACKAGE.glob("report/*.py"), *PACKAGE.glob("twin/*.py")]):
        imports = [n for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.ImportFrom)]
        loaded += [f"{path.name}: {n.module}" for n in imports if (n.module or "").split(".")[-1] in families]
    assert loaded == []


def test_nothing_of_a_family_is_looked_for_that_is_not_declared():
    """`hasattr` and `getattr` with a name would ask a family for what the interface does not say."""
    probes = []
    for path in sorted([*PACKAGE.glob("diagnose/*.py"), *PACKAGE.glob("twin/**/*.py")]):
        calls = [n for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.Call)]
        probes += [f"{path.name}:{c.lineno}" for c in calls if getattr(c.func, "id", "") in ("hasattr", "getattr")]
    assert probes == []
