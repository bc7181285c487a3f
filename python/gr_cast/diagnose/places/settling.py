# SPDX-License-Identifier: GPL-3.0-or-later
"""One effect of a model at its best: in which well, shape, choice and way it explains most."""

from collections.abc import Sequence

import numpy as np

from ...twin.places.families.base import Effect
from . import policy
from .budget import Budget
from .ears import thinned_as_fitted
from .fit import Ear, Model, evaluated, fitted, replaced
from .view import View


def span_s(ears: Sequence[Ear]) -> tuple[float, float]:
    """When the first and the last sounding was made."""
    times_s = np.concatenate([ear.predictor.time_s for ear in ears])
    return float(times_s.min()), float(times_s.max())


def settled(ears, model: Model, unknown: dict, budget: Budget) -> Model:
    """Fitted, from the best of its family's other beginnings and in its best shape, turn by turn, as far as there is time."""
    if budget.is_spent:
        return model
    last = len(model.effects) - 1
    model = begun_anew(ears, fitted(ears, model), last)
    for _ in range(policy.RESHAPED):
        shaped = in_best_shape(ears, model, last, unknown, budget)
        if model.energy - shaped.energy < policy.SHAPE_NATS:
            break
        model = begun_anew(ears, shaped, last)
    return trimmed(ears, model, last, unknown)


def seen_again(ears, model: Model, number: int, unknown: dict, budget: Budget, others: dict) -> Model:
    """One effect that has ways on the best of those that explain most once what is unknown is fitted beside it, as long as that
    gives more: it was found while gains and phases made up for some of it. The `others` that came close stay open."""
    count, family = sum(ear.count for ear in ears), model.effects[number].family
    while family.has_ways and not budget.is_spent and model.deviations(count) > policy.STILL_DEVIATIONS:
        own = model.effects[number]
        found = [replaced(ears, model, number, one) for one in family.again(View(ears, model, unknown), own)]
        near = [fitted(ears, one, rounds=policy.SCREEN_ROUNDS, free=[number]) for one in found]
        near = [with_best_choice(ears, one, number) for one in _of_each_way(ears, near, number)[: policy.CHOSEN_AGAIN]]
        near = [fitted(ears, one) for one in _of_each_way(ears, near, number)[: policy.FULL_STARTS]]
        best = min((begun_anew(ears, one, number) for one in near), key=lambda one: one.energy, default=model)
        others.setdefault(own.key, []).extend(one.effects[number] for one in (model, *near))
        if model.energy - best.energy < policy.SHAPE_NATS:
            break
        model = best
    return model


def _of_each_way(ears, models: list[Model], number: int) -> list[Model]:
    """The best of those whose effect goes one way, the best first."""
    out: list[Model] = []
    for one in sorted(models, key=lambda one: one.energy):
        own = one.effects[number]
        if not any(own.family.is_same_way(one.base, own, other.effects[number], span_s(ears)) for other in out):
            out.append(one)
    return out


def pared(ears, model: Model, number: int, unknown: dict) -> Model:
    """As small as the soundings leave it."""
    return trimmed(ears, model, number, unknown, None)


def trimmed(ears, model: Model, number: int, unknown: dict, most: int | None = 1) -> Model:
    """No larger than the soundings need it, and what a wall may be beyond: what they do not see is not told to be there. With at
    `most` so many turns of less along each axis, as long as the soundings do not mind."""
    family, view = model.effects[number].family, View(ears, model, unknown)
    for axis in range(family.shape_axes):
        least = model.energy + policy.TRIMMED_NATS
        for one in family.smaller(view, model.effects[number], axis)[:most]:
            if one is model.effects[number]:  # no smaller
                continue
            less = replaced(ears, model, number, one)
            if less.energy > least:
                break
            model = less
    return model


def begun_anew(ears, model: Model, number: int) -> Model:
    """From the best of its family's other beginnings, and of those that the family has from there, until none gives more."""
    for _ in range(policy.RESHAPED):
        before = model
        model = with_best_choice(ears, model, number)
        model = min((model, *(fitted(ears, one) for one in restarted(ears, model, number))), key=lambda one: one.energy)
        if before.energy - model.energy < policy.SHAPE_NATS:
            break
    return model


def with_best_choice(ears, model: Model, number: int) -> Model:
    """With one effect as it is by the best of its choices."""
    others = model.effects[number].family.choices(model.base, model.effects[number])
    best = min((replaced(ears, model, number, one) for one in others), key=lambda one: one.energy, default=model)
    return fitted(ears, best) if best.energy < model.energy else model


def as_strong(ears, model: Model) -> Model:
    """With random fields as strong as suits what is left beside all others: each was found for all that was not known yet."""
    for number, effect in enumerate(model.effects):
        model = with_best_choice(ears, model, number) if effect.family.is_flexible else model
    return model


def restarted(ears, model: Model, number: int, most: int = policy.FULL_STARTS) -> list[Model]:
    """The most promising of other beginnings; of many, those that lead to the least energy in thinned soundings."""
    others = model.effects[number].family.restarts(model.base, model.effects[number])
    if len(others) <= policy.MANY_RESTARTS:
        return sorted((replaced(ears, model, number, one) for one in others), key=lambda one: one.energy)[:most]
    thin = thinned_as_fitted(ears, model.fits)
    known = evaluated(thin, model.base, model.effects)
    ranked = sorted((replaced(thin, known, number, one) for one in others), key=lambda one: one.energy)
    near = [fitted(thin, one, rounds=policy.SCREEN_ROUNDS, free=[number]) for one in ranked[: 4 * most]]
    near.sort(key=lambda one: one.energy)
    best = distinct(model.base, [one.effects[number] for one in near])[:most]
    return [replaced(ears, model, number, one) for one in best]


def refitted(ears, model: Model, number: int, most: int) -> list[Model]:
    """From each of these beginnings, one effect fitted beside all others as they are."""
    begun = restarted(ears, model, number, most)
    return [fitted(ears, one, rounds=policy.SCREEN_ROUNDS, free=[number]) for one in begun]


def distinct(base, effects: list[Effect]) -> list[Effect]:
    """One of those that fell into the same minimum, the first."""
    out: list[Effect] = []
    for one in effects:
        near = policy.SAME_STEPS * one.family.steps(base, one)
        if not any(one.choice is other.choice and np.all(np.abs(one.values - other.values) < near) for other in out):
            out.append(one)
    return out


def in_best_shape(ears, model: Model, number: int, unknown: dict, budget: Budget) -> Model:
    """One effect in the shape that explains best: with its ends, along one axis after the other, until none gives more."""
    before, own = model, model.effects[number]
    family = own.family
    if not family.shape_axes:
        return model
    if (other := own if budget.is_spent else family.ended(View(ears, model, unknown), own)) is not own:
        model = min(model, replaced(ears, model, number, other), key=lambda one: one.energy)
    for _ in range(policy.RESHAPED):
        for axis in range(family.shape_axes if not budget.is_spent else 0):
            trials = [replaced(ears, model, number, one) for one in family.reshaped(model.base, model.effects[number], axis)]
            model = min((model, *trials), key=lambda one: one.energy)
        if before.energy - model.energy < policy.SHAPE_NATS:
            break
        before = model = fitted(ears, model, rounds=policy.SCREEN_ROUNDS, free=[number])
    return model


def quick(ears, model: Model) -> Model:
    """With its last effect alone fitted, in few steps."""
    if not len(model.effects[-1].values):
        return model
    return fitted(ears, model, rounds=policy.SCREEN_ROUNDS, free=[len(model.effects) - 1])
