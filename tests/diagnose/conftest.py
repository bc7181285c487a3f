# SPDX-License-Identifier: GPL-3.0-or-later
"""A world of closed formulas for every test of the diagnosis."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent))

from conftest_world import world  # noqa: F401
