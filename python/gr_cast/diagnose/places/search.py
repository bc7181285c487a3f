# SPDX-License-Identifier: GPL-3.0-or-later
"""Which effects explain the soundings of a place: rounds of candidates, each fitted with all found before; then elimination."""

import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ...twin.places.families.base import Effect
from . import elsewhere, policy
from .fit import Ear, Model, evaluated, fitted, replaced, with_effect, without_effects
from .view import View


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Processor time of this thread that a search may take."""

    end_s: float

    @classmethod
    def of(cls, seconds: float) -> "Budget":
        return cls(end_s=time.thread_time() + seconds)

    @property
    def is_spent(self) -> bool:
        return time.thread_time() > self.end_s


def numbers_price_nats(effect: Effect, count: float) -> float:
    """Schwarz's price of the numbers of an effect, and what it names."""
    return 0.5 * len(effect.values) * float(np.log(2 * max(count, 2))) + effect.family.price_nats


def evidence(model: Model, count: float, tried: float) -> float:
    """Nats for a model: −energy less the price of its effects, each out of `tried` owners and families."""
    return -model.energy - sum(numbers_price_nats(e, count) + np.log(max(tried, 1)) for e in model.effects)


def worth(model: Model, before: Model, count: float, tried: float) -> float:
    """Evidence for a model beyond that for the one before it. What edges gain by bending otherwise than the theory has it is no
    reason to let them bend: so free, they would explain anything."""
    freedom = max(0.0, model.loose - before.loose)
    return evidence(model, count, tried) - evidence(before, count, tried) - freedom


def candidates(ears: Sequence[Ear], model: Model, unknown: dict, budget: Budget, barred: Collection) -> tuple[list[Model], int]:
    """Models with one effect more, fitted, the best evidence first; and how many were tried. None where time ran out before
    all had been looked at: the best of a few is no answer."""
    view = View(ears, model, unknown)
    have = {effect.key for effect in model.effects}
    screened, tried = [], 0
    for family in view.families:
        for owner in family.owners(view):
            key = family.name, owner
            if key in barred or key in have and family.level != "place":
                continue
            if budget.is_spent:
                return [], tried
            tried += 1
            starts = family.starts(view, owner)
            if len(starts) > policy.FULL_STARTS and family.ranks_unfitted:
                starts = list({id(one): one for one in (*view.ranked(starts)[: policy.FULL_STARTS], starts[0])}.values())
            screened += [_quick(ears, with_effect(ears, model, start)) for start in starts]
    count = sum(ear.count for ear in ears)
    stiff = [one.energy for one in screened if not one.effects[-1].family.is_flexible]
    if stiff and model.energy - min(stiff) > policy.STIFF_SHARE * (model.energy - count):
        screened = [one for one in screened if not one.effects[-1].family.is_flexible]
    screened.sort(key=lambda one: -worth(one, model, count, tried))
    chosen, crowd = [], {}
    for one in screened:
        name = one.effects[-1].family.name
        if crowd.get(name, 0) < policy.FITTED_PER_FAMILY and len(chosen) < policy.FITTED_AFTER_SCREEN:
            crowd[name] = crowd.get(name, 0) + 1
            chosen.append(one)
    final = [_settled(ears, one) if not budget.is_spent else one for one in chosen]
    return sorted(final, key=lambda one: -worth(one, model, count, tried)), tried


def _settled(ears, model: Model) -> Model:
    """Fitted, and once more from the best of its family's other beginnings."""
    model = fitted(ears, model)
    number = len(model.effects) - 1
    others = [
        replaced(ears, model, number, one) for one in model.effects[number].family.restarts(model.base, model.effects[number])
    ]
    others = sorted(others, key=lambda one: one.energy)[: policy.FULL_STARTS]
    return min((model, *(fitted(ears, one) for one in others)), key=lambda one: one.energy)


def _quick(ears, model: Model) -> Model:
    if not len(model.effects[-1].values):
        return model
    return fitted(ears, model, rounds=policy.SCREEN_ROUNDS, free=[len(model.effects) - 1])


@dataclass(frozen=True, eq=False, kw_only=True)
class Found:
    """The chosen model, what came close to each of its effects, and how sure the counting is."""

    model: Model
    start: Model
    rivals: dict
    tried: int
    count: float
    spent: bool

    @property
    def deviations(self) -> float:
        """Energy above what noise has, in its standard deviations."""
        spread = np.sqrt(max(self.count, 1.0)) + self.model.slack
        return (self.model.whitened - self.model.offset - self.count) / float(spread)


def run(
    ears: Sequence[Ear], base, unknown: dict, budget_s: float, progress=lambda text: None, vault: Sequence[Ear] = ()
) -> Found:
    """Search, elimination, rivals; `budget_s` of processor time, a part of it for the rivals. What the `vault`, which nothing is
    fitted to, refuses is taken out again, and the search goes on without it."""
    budget = Budget.of((1 - policy.RIVALS_SHARE) * budget_s)
    start = model = evaluated(ears, base, ())
    count = sum(ear.count for ear in ears)
    others: dict = {}
    barred: set = set()
    while True:
        model, tried = _grown(ears, model, unknown, budget, others, barred, progress)
        refused = [number for number, nats in enumerate(told_nats(vault, model)) if nats < -policy.REFUSED_NATS]
        if not refused:
            break
        barred |= {model.effects[number].key for number in refused}
        model = fitted(ears, without_effects(ears, model, refused))
        if budget.is_spent:
            break
    spent = budget.is_spent
    others = {key: [one for one in found if one.key not in barred] for key, found in others.items()}
    model, rivals = exchanged(ears, model, others, count, tried, Budget.of(policy.RIVALS_SHARE * budget_s))
    return Found(model=model, start=start, rivals=rivals, tried=tried, count=count, spent=spent)


def _grown(ears, model: Model, unknown: dict, budget: Budget, others: dict, barred: set, progress) -> tuple[Model, int]:
    """The model with effect after effect as long as they pay, none of them `barred`; what came next to each goes to `others`."""
    count, tried = sum(ear.count for ear in ears), 1
    while len(model.effects) < policy.MOST_EFFECTS and not budget.is_spent:
        progress(f"looking for effect {len(model.effects) + 1}")
        better, tried = candidates(ears, model, unknown, budget, barred)
        least = max(policy.LEAST_EVIDENCE_NATS, model.slack)
        if not better or worth(better[0], model, count, tried) < least:
            break
        better = sorted([*better, *elsewhere.instead(ears, model, budget)], key=lambda one: -worth(one, model, count, tried))
        best = better[0]
        others[best.effects[-1].key] = [one.effects[-1] for one in better[1:]]
        model = pruned(ears, best, count, tried)
    return model, tried


def told_nats(vault: Sequence[Ear], model: Model) -> list[float]:
    """Nats by which each effect predicts soundings that it was not fitted to; 0 of what does not last from one to the next."""
    if not vault or not model.effects:
        return [0.0] * len(model.effects)
    told = evaluated(vault, model.base, model.effects)
    return [
        without_effects(vault, told, [number]).energy - told.energy if effect.family.lasts else 0.0
        for number, effect in enumerate(model.effects)
    ]


def exchanged(ears, model: Model, others: dict, count: float, tried: float, budget: Budget):
    """What came close when an effect was found, in its place now: the better one stays, the other is a rival."""
    rivals: dict = {}
    for number, effect in enumerate(model.effects):
        trials = []
        for other in others.get(effect.key, ()):
            if other.key not in {e.key for e in model.effects} and not budget.is_spent:
                trials.append(fitted(ears, replaced(ears, model, number, other), rounds=4))
        trials.sort(key=lambda one: -worth(one, model, count, tried))
        if trials and worth(trials[0], model, count, tried) > 1.0:
            trials[0], model = model, trials[0]
        own = model.effects[number]
        rivals[own.key] = sorted(
            ((one.effects[number], behind_nats(one, model, number)) for one in trials), key=lambda pair: pair[1]
        )
    return model, rivals


def behind_nats(rival: Model, model: Model, number: int) -> float:
    """How far a rival of one effect is behind, by what the soundings say and one nat (Akaike) per number: that it is less simple
    does not rule it out."""
    one, other = rival.effects[number], model.effects[number]
    more = len(one.values) - len(other.values) + one.family.price_nats - other.family.price_nats
    return rival.energy - model.energy + more


def pruned(ears, model: Model, count: float, tried: float) -> Model:
    """Without effects that no longer pay."""
    number = 0
    while number < len(model.effects) - 1:
        less = fitted(ears, without_effects(ears, model, [number]), rounds=4)
        if evidence(less, count, tried) > evidence(model, count, tried) - policy.LEAST_EVIDENCE_NATS / 2:
            model = less
        else:
            number += 1
    return model
