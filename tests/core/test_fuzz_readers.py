# SPDX-License-Identifier: GPL-3.0-or-later
"""A fixed portion of tests/bench/fuzz_readers.py: 200 mutations of a valid file for every reader, in little memory."""

import subprocess
import sys
from pathlib import Path

BENCH = Path(__file__).resolve().parents[1] / "bench" / "fuzz_readers.py"


def test_a_damaged_file_ends_in_a_result_or_in_lines():
    done = subprocess.run(
        [sys.executable, str(BENCH), "--count", "1", "--seed", "one of these"],
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0 and done.stdout.splitlines()[-1].split()[-2] == "0", done.stdout + done.stderr
