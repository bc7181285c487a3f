# SPDX-License-Identifier: GPL-3.0-or-later
"""Which wall, material, mechanism or node the twin of a place leaves out: evidence, proposals, search, verdict."""

from ...twin.places.document import read as read_case
from .mistakes import of_units as mistakes_of
from .policy import BUDGET_S
from .run import diagnose
from .write import write

__all__ = ["BUDGET_S", "diagnose", "mistakes_of", "read_case", "write"]
