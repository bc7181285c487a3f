# SPDX-License-Identifier: GPL-3.0-or-later
"""The blocks' own tests once more, in the build with AddressSanitizer and UndefinedBehaviorSanitizer."""

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build-sanitize"


@pytest.mark.timeout(900)
@pytest.mark.parametrize("tests", ["test_glfsr_source.py", "test_bpsk_correlator.py", "test_channel_emulator.py"])
def test_blocks_hold_their_laws_under_sanitizers(tests):
    if "CAST_BUILD" in os.environ:
        pytest.skip("this is the run under sanitizers")
    if not (BUILD / "python").is_dir():
        pytest.skip("NO SANITIZED BUILD: run tests/run.sh once")
    libraries = [
        subprocess.run(["g++", f"-print-file-name={name}"], capture_output=True, text=True, check=True).stdout.strip()
        for name in ("libasan.so", "libstdc++.so")  # libstdc++ too, or exceptions from C++ are not caught
    ]
    environment = os.environ | {
        "CAST_BUILD": str(BUILD),
        "LD_PRELOAD": ":".join(libraries),
        "ASAN_OPTIONS": "detect_leaks=0",  # Python itself leaks
        "UBSAN_OPTIONS": "print_stacktrace=1",
    }
    told = subprocess.run(
        ["/usr/bin/python3", "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", ROOT / "tests/blocks" / tests],
        capture_output=True, text=True, env=environment, cwd=ROOT,
    )  # fmt: skip
    assert told.returncode == 0, told.stdout[-4000:] + told.stderr[-4000:]
    assert " passed" in told.stdout
