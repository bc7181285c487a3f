# SPDX-License-Identifier: GPL-3.0-or-later
"""What was computed and may be asked for again: the least recently used is forgotten."""

from collections import OrderedDict
from collections.abc import Sequence

_KEPT = 4000  # in one memory


def remembered(memory: OrderedDict, keys: Sequence, make, kept: int = _KEPT) -> list:
    """Values by keys, so many of which are `kept`; `make(numbers of the missing ones)` gives those that the memory lacks, all at
    once."""
    found = [memory.get(key) for key in keys]  # before `make`, which may remember more in the same place, and forget these
    missing = [number for number, value in enumerate(found) if value is None]
    if not missing:
        for key in keys:
            memory.move_to_end(key)
        return found
    for number, value in zip(missing, make(missing), strict=True):
        found[number] = value
    for key, value in zip(keys, found, strict=True):
        memory[key] = value
        memory.move_to_end(key)
    while len(memory) > kept:
        memory.popitem(last=False)
    return found
