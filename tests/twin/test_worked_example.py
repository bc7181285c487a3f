# SPDX-License-Identifier: GPL-3.0-or-later
"""The worked example of the documentation runs by its one command and shows what the text says."""

import re
import subprocess
import sys
from pathlib import Path

PROGRAM = Path(__file__).resolve().parents[2] / "docs" / "examples" / "amplifier.py"


def test_a_cause_below_the_noise_is_named_and_foretells_more_power_to_the_noise(tmp_path):
    done = subprocess.run([sys.executable, PROGRAM, tmp_path / "out"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "identified: pa_nonlinearity (tx)" in done.stdout
    rows = re.findall(r"(recorded|foretold).*, (twin|corrected)\s+(\S+) dB\s*(\S+) dB", done.stdout)
    left = {(when, which): float(residual) - float(noise) for when, which, residual, noise in rows}
    assert abs(left["recorded", "twin"]) < 0.1  # dB over the noise: nothing to see
    assert left["foretold", "twin"] > 6 and left["foretold", "corrected"] < 0.3
    assert (tmp_path / "out" / "amplifier.png").stat().st_size > 10_000
