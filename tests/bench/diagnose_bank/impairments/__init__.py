# SPDX-License-Identifier: GPL-3.0-or-later
"""The contract's families as GNU Radio makes them, one file per group.

`strength` (s) is an amplitude, 0 = absent: λ grows with its square; `draw` (d) holds all else that is random.
Signals are streams whose sample `c.first` is t = 0; `c` is the `Context` of one recording.
"""

from . import converters, environment, filters, gains, noise, offsets, oscillators, paths, sampling
from .family import Context, Family

_GROUPS = (oscillators, offsets, converters, gains, filters, paths, environment, noise, sampling)


def _key(family):
    """Name, and the side where one name has two."""
    return f"{family.name}:{family.level}" if family.name == "iq_imbalance" else family.name


FAMILIES = {_key(family): family for group in _GROUPS for family in group.FAMILIES}

__all__ = ["FAMILIES", "Context", "Family"]
