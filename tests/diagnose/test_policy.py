# SPDX-License-Identifier: GPL-3.0-or-later
"""Every threshold of the engine stands in one file, each with its reason."""

import ast
import re
from pathlib import Path

import gr_cast.diagnose as diagnose

FOLDER = Path(diagnose.__file__).parent
POLICY = FOLDER / "policy.py"


def _constants(path: Path) -> list[ast.Assign]:
    """Assignments of numbers to upper-case names at the top of a module."""
    return [
        node
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.Assign)
        and any(isinstance(n, ast.Name) and n.id.isupper() for target in node.targets for n in ast.walk(target))
        and any(isinstance(n, ast.Constant) and type(n.value) in (int, float) for n in ast.walk(node.value))
    ]


def test_no_threshold_stands_outside_the_policy():
    scattered = {f.name: ast.unparse(c) for f in FOLDER.glob("*.py") if f != POLICY for c in _constants(f)}
    assert not scattered


def test_no_threshold_is_set_twice_and_none_is_idle():
    names = [n.id for c in _constants(POLICY) for t in c.targets for n in ast.walk(t) if isinstance(n, ast.Name)]
    assert len(names) == len(set(names)) > 150
    used = "\n".join(f.read_text() for f in FOLDER.glob("*.py") if f != POLICY)
    own = POLICY.read_text()
    idle = [n for n in names if not re.search(rf"\b{n}\b", used) and len(re.findall(rf"\b{n}\b", own)) < 2]
    assert not idle
