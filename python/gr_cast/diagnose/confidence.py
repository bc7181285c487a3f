# SPDX-License-Identifier: GPL-3.0-or-later
"""How sure an effect is, and whether a list of effects is the whole truth: every factor with its reason, in one place.

A confidence is a product of factors between 0 and 1, each smooth and monotone in one figure: the evidence, what unseen samples
say, the lead over the runner-up, what larger effects leave over, courses that fit much, what is left unexplained.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SUREST = 0.98  # of an effect for which all figures speak: families that nobody thought of remain
WEAKEST, CHANCE_NATS = 0.60, 20.0  # an effect that only just pays its price; nats by which chance is forgotten (bank: .60 to .98)
VOTE_NATS, VOTE_AT_ZERO = (
    3.0,
    10.0,
)  # models are not exact: three nats on unseen samples count as one; odds at none
LEAD_NATS = 4.0  # of a runner-up, whose nearest form was fitted but not all its forms: odds by e for each four nats
# Each further effect of a list may be what the largest one leaves over where its form is not quite right. Such a rest has a small
# share of its nats; the share enters with its fourth root, for forms that are right leave nothing.
IMITATION, SHARE_POWER = 0.12, 0.25
COURSE = 0.9  # a random course fits much of what is not it
COURSES = 0.5  # for every further course in one recording: two of them imitate almost anything
OPEN = 0.5  # at most, where another family fits alike
LEFT = 0.6  # at most, where something is left that nothing explains; less where that is as loud as the effect
HURRIED = 0.9  # where the time ended the search
WHOLE = 0.5  # probability of a list from which on it is called the whole truth: likelier right than not


@dataclass(frozen=True, kw_only=True)
class Figures:
    """What tells how sure an effect is. Nats of `evidence`, on unseen samples (`held_out`, None where that was not worked out),
    of the `lead` over the runner-up (None without one), of the `largest` effect of its list that has numbers, and what is `left`
    unexplained; the effects in its recording (`causes`), and random `courses` there where it is one itself, else 0."""

    evidence: float
    held_out: float | None
    lead: float | None
    largest: float
    causes: int
    courses: int
    left: float
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
        sure *= LEFT * nats / (nats + f.left)
    elif not f.complete:
        sure *= HURRIED
    return float(min(sure, OPEN) if f.open else sure)


def is_whole(confidences: Sequence[float]) -> bool:
    """Whether a list of effects, each as sure as told, is likelier the whole truth than not."""
    return float(np.prod(confidences)) >= WHOLE


def _logistic(log_odds: float) -> float:
    return float(1 / (1 + np.exp(-np.clip(log_odds, -50, 50))))
