# SPDX-License-Identifier: GPL-3.0-or-later
"""Diagnose a twin: where it differs from recordings, what physics it leaves out, and a twin with that
physics in it."""

from ..twin.document import Case, read_case
from .mistakes import of_carriers as mistakes_of
from .policy import BUDGET_S
from .run import Diagnosis, diagnose
from .write import write

__all__ = ["BUDGET_S", "Case", "Diagnosis", "diagnose", "mistakes_of", "read_case", "write"]
