# SPDX-License-Identifier: GPL-3.0-or-later
"""The GNU Radio blocks of gr-cast: the only door to GNU Radio in this package."""

from .cast_python import *  # noqa: F403
from .home import settle

settle()
