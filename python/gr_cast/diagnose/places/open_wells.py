# SPDX-License-Identifier: GPL-3.0-or-later
"""Other fits of an effect that the soundings leave open, of which the vault has the choice."""

from collections.abc import Sequence

import numpy as np

from . import foretold, policy, settling
from .budget import Budget
from .fit import Ear, Model, evaluated, fitted, replaced, without_effects
from .view import View


def otherwise(ears, vault: Sequence[Ear], model: Model, number: int, unknown: dict, others: dict, budget: Budget) -> Model | None:
    """The model with another fit of a refused effect that explains the soundings as well and is not refused: the same wall, as
    small as they leave it, or another, elsewhere, or the same in another well of its phase, next to it or wherever what else is
    known leaves one, or beside where it is as far as they do not tell."""

    def begun():
        yield from [one] if (one := settling.pared(ears, model, number, unknown)) is not model else []
        yield from (*kinds(ears, model, number, others), *settling.restarted(ears, model, number, policy.WELLS))
        if not budget.is_spent:
            yield from _lowest(_begun_beside(ears, model, number, unknown))

    for one in begun():
        other = fitted(ears, one, rounds=4)
        if other.energy < model.energy + policy.RIVAL_NATS and number not in foretold.refused(vault, other):
            return other
    other = moved_beside(ears, vault, model, number, model.energy + policy.RIVAL_NATS)
    return other if number not in foretold.refused(vault, other) else None


def moved_beside(ears, vault: Sequence[Ear], model: Model, number: int, most: float) -> Model:
    """The model with an effect beside where it is, of all places that leave at `most` so much energy the one that predicts the
    vault best."""
    own = model.effects[number]
    beside = [replaced(ears, model, number, one) for one in own.family.beside(model.base, own)]
    open_ = [model, *(one for one in beside if one.energy < most)]
    return min(open_, key=lambda one: evaluated(vault, one.base, one.effects).energy)


def in_its_well(ears, vault: Sequence[Ear], model: Model, number: int, unknown: dict, others: dict, budget: Budget) -> Model:
    """The model with an effect in that well of its phase which predicts the vault best, of all that explain the soundings alike:
    wells are looked for from the lowest that is known, next to next."""
    fits, expanded, own = [model], set(), model.effects[number]
    if not own.family.lasts:
        return model
    begun = [*kinds(ears, model, number, others), *_begun_beside(ears, model, number, unknown)]
    for _ in range(policy.RESHAPED):
        fits += [fitted(ears, one, rounds=4) for one in _lowest(begun)]
        apart = settling.distinct(model.base, [one.effects[number] for one in sorted(fits, key=lambda one: one.energy)])
        lowest = min(one.energy for one in fits)
        open_ = [one for one in fits if one.effects[number] in apart and one.energy < lowest + policy.RIVAL_NATS]
        fresh = [one for one in open_ if id(one.effects[number]) not in expanded]
        if not fresh or budget.is_spent:
            break
        nearest = min(fresh, key=lambda one: one.energy)
        expanded.add(id(nearest.effects[number]))
        begun = [replaced(ears, nearest, number, one) for one in own.family.wells(model.base, nearest.effects[number])]
    return min(open_, key=lambda one: evaluated(vault, one.base, one.effects).energy)


def _begun_beside(ears, model: Model, number: int, unknown: dict) -> list[Model]:
    """The model with an effect that has wells at each of its first guesses, looked for beside all others."""
    own = model.effects[number]
    if not own.family.wells(model.base, own):
        return []
    view = View(ears, without_effects(ears, model, [number]), unknown)
    return [replaced(ears, model, number, one) for one in own.family.starts(view, own.owner)]


def _lowest(begun: list[Model]) -> list[Model]:
    return sorted(begun, key=lambda one: one.energy)[: 2 * policy.WELLS]


def kinds(ears, model: Model, number: int, others: dict) -> list[Model]:
    """The model with each other fit of one family and owner that came close to an effect."""
    key = model.effects[number].key
    return [replaced(ears, model, number, one) for one in others.get(key, ()) if one.key == key]


def wells(ears, vault: Sequence[Ear], model: Model, number: int) -> list[tuple[float, np.ndarray]]:
    """(nats behind, numbers) of an effect in the other wells of its phase that the soundings leave open and the vault does not
    refuse."""
    own = model.effects[number]
    tried = settling.refitted(ears, model, number, policy.WELLS)
    open_ = [
        one
        for one in tried
        if one.effects[number].choice is own.choice
        and one.energy - model.energy < policy.RIVAL_NATS
        and number not in foretold.refused(vault, one)
    ]
    apart = settling.distinct(model.base, [own, *(one.effects[number] for one in open_)])[1:]
    rows = [(one.energy - model.energy, one.effects[number]) for one in open_]
    return [(max(behind, 0.0), effect.values) for behind, effect in rows if effect in apart]
