# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the place case that these tests share."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent))
