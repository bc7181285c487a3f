# SPDX-License-Identifier: GPL-3.0-or-later
"""What an entry of a twin's `effects` may hold under a name: declared by each family, checked by `twin.contract`."""

import math
from dataclasses import dataclass

SMALLEST = 1e-30  # of what is above 0


@dataclass(frozen=True, kw_only=True)
class Value:
    """A number from `low` to `high` (limits by its unit are the checker's), many of them in a list, true or false, text, or one
    of `words`. `needed`: nothing can be worked out without it."""

    low: float = -math.inf
    high: float = math.inf
    whole: bool = False
    needed: bool = False
    many: bool = False
    kind: type = float
    words: tuple[str, ...] = ()


NUMBER = Value()
NEEDED = Value(needed=True)
POSITIVE = Value(low=SMALLEST)
NEEDED_POSITIVE = Value(low=SMALLEST, needed=True)
NUMBERS = Value(many=True)
WHOLES = Value(many=True, whole=True, low=-4096, high=4096)  # lags and orders
TRUTH = Value(kind=bool)
SIDE = Value(kind=str, words=("tx", "rx"))


def one_of(*words: str) -> Value:
    return Value(kind=str, words=words)
