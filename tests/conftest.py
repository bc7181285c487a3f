# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the built package, and the recordings and cases that live outside the repository."""

import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BUILD = Path(os.environ.get("CAST_BUILD", ROOT / "build"))
sys.path.insert(0, str(BUILD / "python"))
sys.path.append(str(ROOT / "apps"))
os.environ["GR_DONT_LOAD_PREFS"] = "1"
os.environ.setdefault("MPLBACKEND", "Agg")


@pytest.fixture(scope="session")
def cast_data() -> Path:
    """The folder of real recordings and cases: CAST_DATA, or ../shared."""
    folder = Path(os.environ.get("CAST_DATA", ROOT.parent / "shared"))
    if not (folder / "real").is_dir():
        pytest.skip(f"NO REAL RECORDINGS at {folder}: set CAST_DATA to their folder")
    return folder
