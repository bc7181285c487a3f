# SPDX-License-Identifier: GPL-3.0-or-later
"""How sure an effect is, and whether a list of effects is the whole truth: every factor with its reason, in one place.

A confidence is a product of probabilities, each from one figure: that chance did not make the evidence, that the runner-up is not
right instead, that the effect is not a part of what is left unexplained, and that a family of many forms does not stand for
something else. How many effects are told, and how loud the others are, says nothing more: each pays for itself in the evidence.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .policy import FREEDOM, HURRIED, OPEN, SUREST, TEMPER_NATS, UNEXPLAINED_NATS, UNEXPLAINED_SHARE, UNPROVEN, WHOLE


@dataclass(frozen=True, kw_only=True)
class Figures:
    """What tells how sure an effect is. Nats of `evidence`, on unseen samples (`held_out`, None where that was not worked out),
    of the `lead` over the runner-up (None without one), what is `left` unexplained, what all that was found `explains`; whether
    its family is `flexible`: has the freedom to look like others; whether the search was `complete`, and the effect `proven` on
    unseen samples or read off them."""

    evidence: float
    held_out: float | None
    lead: float | None
    left: float
    explains: float
    flexible: bool
    complete: bool
    proven: bool
    open: bool


def confidence(figures: Figures) -> float:
    """Probability that an effect is there and has the right name."""
    f, nats = figures, max(figures.evidence, 0.0)
    sure = SUREST * _tempered(f.evidence + (f.held_out or 0.0))
    if f.lead is not None and not f.open:
        sure *= _tempered(f.lead)
    if f.left:
        sure *= nats / (nats + f.left)
    if f.flexible:
        sure *= 1 - FREEDOM * unseen_rest(nats)
    if not f.complete:
        # What was not explained any more may be what this explains: no test of the residual sees so little.
        unseen = max(UNEXPLAINED_NATS, UNEXPLAINED_SHARE * f.explains)
        sure *= HURRIED if f.proven else UNPROVEN * nats / (nats + unseen)
    return float(min(sure, OPEN) if f.open else sure)


def unseen_rest(nats: float) -> float:
    """Probability that what explains `nats` of something else leaves a rest that no test of the residual sees. The share of it
    that is explained is not known: Jeffreys' prior of a share, the arcsine law."""
    return float(2 / np.pi * np.arcsin(np.sqrt(UNEXPLAINED_NATS / (UNEXPLAINED_NATS + nats))))


def _tempered(nats: float) -> float:
    """Probability of the likelier of two by evidence of models that are not exact (Miller and Dunson, JASA 2019)."""
    return float(1 / (1 + np.exp(-np.clip(nats / TEMPER_NATS, -50, 50))))


def is_whole(confidences: Sequence[float]) -> bool:
    """Whether a list of effects, each as sure as told, is likelier the whole truth than not."""
    return float(np.prod(confidences)) >= WHOLE
