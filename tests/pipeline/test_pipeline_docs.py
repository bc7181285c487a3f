# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/pipeline.md, by its own commands: what it says they print is what they print."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_the_first_two_looks_at_a_stack_print_what_the_page_says(tmp_path):
    for tool in ("git", "gcc", "make"):
        if shutil.which(tool) is None:
            pytest.skip(f"NO {tool.upper()}: the stack is not built")
    first, second = re.findall(r"```sh\n(.*?)```", (ROOT / "docs" / "pipeline.md").read_text(), flags=re.S)[:2]
    done = []
    for block in (first, second):
        script = block.replace("/tmp/stack", str(tmp_path / "stack"))
        done.append(subprocess.run(["bash", "-e"], input=script, cwd=ROOT, capture_output=True, text=True, timeout=900))
        assert done[-1].returncode == 0, done[-1].stderr
    assert "same on both" in done[0].stdout
    assert "pa nonlinearity (testbed's radio)" in done[1].stdout and "1.5" in done[1].stdout
    assert (tmp_path / "stack-storage" / "index.html").is_file()
