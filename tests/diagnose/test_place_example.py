# SPDX-License-Identifier: GPL-3.0-or-later
"""The worked example of docs/places.md, by its own commands: an office whose glass partition nobody drew."""

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = re.search(r"## A worked example.*?```sh\n(.*?)```", (ROOT / "docs" / "places.md").read_text(encoding="utf-8"), re.S)[1]


def test_a_partition_that_nobody_drew_is_drawn_and_another_corridor_is_foretold(tmp_path):
    said = []
    for command in COMMANDS.strip().splitlines():
        program, *words = command.split()
        done = subprocess.run([sys.executable, ROOT / program, *words], cwd=tmp_path, capture_output=True, text=True, timeout=400)
        assert done.returncode == 0, f"{command}: {done.stderr}"
        said.append(done.stdout)
    loss_db, rho = (float(re.search(rf"{what}.*?([+-]?\d\.\d+)", said[0])[1]) for what in ("twin less sounding:", "rho ="))
    assert abs(loss_db) < 1.5 and rho > 0.95  # nothing to see
    diagnosis = json.loads((tmp_path / "found" / "office" / "diagnosis.json").read_text())
    assert diagnosis["verdict"] == "identified", said[1]
    (effect,) = diagnosis["effects"]
    point, normal = (effect["parameters"][name]["value"] for name in ("point_m", "normal"))
    assert effect["family"] == "missing_object" and abs(abs(normal[1]) - 1) < 0.004 and abs(point[1] - 6.2) < 0.15
    left = [[float(x) for x in re.findall(r"-?\d+\.\d", text)] for text in said if "never fitted" in text]
    (before, noise), (after, _) = left
    assert before > noise + 6 and after < noise + 1
