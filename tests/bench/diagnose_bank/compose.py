# SPDX-License-Identifier: GPL-3.0-or-later
"""Which case comes at which index of a bank."""

import numpy as np

from .kinds import beyond, network, null, single
from .scenes import Retry
from .undecidable import ambiguous

# Share of a bank, and what makes such a case.
PLAN = (
    (0.20, null),
    (0.24, lambda rng: single(rng, 1, bool(rng.random() < 0.7))),
    (0.16, lambda rng: single(rng, 2, bool(rng.random() < 0.8))),
    (0.10, lambda rng: single(rng, 3, True)),
    (0.12, lambda rng: network(rng, int(rng.integers(1, 3)), True)),
    (0.09, beyond),
    (0.09, ambiguous),
)


def draw(seed, index, total):
    """Case `index` of `total`: kinds follow the plan's shares in order, and all else the seed; those beyond `total` are nulls."""
    kind = int(np.searchsorted(np.cumsum([share for share, _ in PLAN]), (index + 0.5) / total))
    make = null if index >= total else PLAN[min(kind, len(PLAN) - 1)][1]
    for attempt in range(200):
        rng = np.random.default_rng([seed, index, attempt])
        try:
            return make(rng)
        except Retry:
            continue
    raise RuntimeError(f"seed {seed}, case {index}: no fair case in 200 draws")
