# SPDX-License-Identifier: GPL-3.0-or-later
"""How sure an effect is, and whether a list of effects is the whole truth: every factor with its reason, in one place.

A confidence is a product of factors between 0 and 1, each smooth and monotone in one figure: the evidence, what unseen samples
say, the lead over the runner-up, what larger effects leave over, courses that fit much, what is left unexplained.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .policy import (
    CHANCE_NATS,
    COURSE,
    COURSES,
    HURRIED,
    IMITATION,
    LEAD_NATS,
    LEFT,
    LEFT_BY_FEW,
    OPEN,
    SHARE_POWER,
    SUREST,
    VOTE_AT_ZERO,
    VOTE_NATS,
    WEAKEST,
    WHOLE,
)


@dataclass(frozen=True, kw_only=True)
class Figures:
    """What tells how sure an effect is. Nats of `evidence`, on unseen samples (`held_out`, None where that was not worked out),
    of the `lead` over the runner-up (None without one), of the `largest` effect of its list that has numbers, and what is `left`
    unexplained; the effects in its recording (`causes`), random `courses` there where it is one itself, else 0, and whether its
    family is `flexible`: has the freedom to look like others."""

    evidence: float
    held_out: float | None
    lead: float | None
    largest: float
    causes: int
    courses: int
    left: float
    flexible: bool
    complete: bool
    open: bool


def confidence(figures: Figures) -> float:
    """Probability that an effect is there and has the right name."""
    f, nats = figures, max(figures.evidence, 0.0)
    sure = 1 - (1 - WEAKEST / SUREST) * np.exp(-nats / CHANCE_NATS)
    sure *= SUREST
    if f.held_out is not None:
        sure *= _logistic(np.log(VOTE_AT_ZERO) + f.held_out / VOTE_NATS)
    if f.lead is not None and not f.open:
        sure *= _logistic(f.lead / LEAD_NATS)
    share = min(1.0, max(nats, 1.0) / max(f.largest, 1.0))
    sure *= 1 - min(1.0, IMITATION * max(f.causes - 1, 0)) * (1 - share**SHARE_POWER)
    if f.courses:
        sure *= COURSE * COURSES ** (f.courses - 1)
    if f.left:
        sure *= (LEFT if f.flexible else LEFT_BY_FEW) * nats / (nats + f.left)
    elif not f.complete:
        sure *= HURRIED
    return float(min(sure, OPEN) if f.open else sure)


def is_whole(confidences: Sequence[float]) -> bool:
    """Whether a list of effects, each as sure as told, is likelier the whole truth than not."""
    return float(np.prod(confidences)) >= WHOLE


def _logistic(log_odds: float) -> float:
    return float(1 / (1 + np.exp(-np.clip(log_odds, -50, 50))))
