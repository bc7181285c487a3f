# SPDX-License-Identifier: GPL-3.0-or-later
"""What a model is worth: evidence, the price of numbers, and by how much more an effect must pay beside fields and edges."""

import numpy as np

from ...twin.places.families.base import Effect
from . import policy
from .fit import Model, fitted, without_effects


def number_price_nats(count: float) -> float:
    """Schwarz's price of a number."""
    return 0.5 * float(np.log(2 * max(count, 2)))


def numbers_price_nats(effect: Effect, count: float) -> float:
    """Of the numbers of an effect, and of what it names."""
    return effect.family.told_numbers(effect) * number_price_nats(count) + effect.family.price_nats


def evidence(model: Model, count: float, tried: float) -> float:
    """Nats for a model: its ln p less the price of its effects, each out of `tried` owners and families."""
    return -model.tempered - sum(numbers_price_nats(e, count) + np.log(max(tried, 1)) for e in model.effects)


def worth(model: Model, before: Model, count: float, tried: float) -> float:
    """Evidence for a model beyond that for the one before it. What edges gain by bending otherwise than the theory has it is no
    reason to let them bend: so free, they would explain anything."""
    return evidence(model, count, tried) - evidence(before, count, tried) - freedom(model, before)


def freedom(model: Model, before: Model) -> float:
    """What edges gain beyond what they gained before, in nats as the evidence of both has them."""
    is_flexible = any(effect.family.is_flexible for effect in (*model.effects, *before.effects))
    part = 0 if is_flexible else 1
    return max(0.0, model.loose[part] - before.loose[part])


def is_negligible(model: Model, number: int) -> bool:
    """Whether an effect is none to speak of."""
    return model.effects[number].family.is_negligible(model.effects[number])


def has_shape(model) -> bool:
    """Whether the last effect of a model, or of what is guessed, has a shape to choose."""
    return model.effects[-1].family.shape_axes > 0


def is_plain(model: Model) -> bool:
    """Whether the last effect is no random field and has no shape."""
    return not model.effects[-1].family.is_flexible and not has_shape(model)


def explains_most(one: Model, model: Model, count: float) -> bool:
    """Whether `one` explains most of what a model leaves above noise."""
    return model.energy - one.energy >= policy.MOST_SHARE * (model.energy - model.offset - count)


def tells_most(one, model: Model, count: float) -> bool:
    """Whether what is neither random field nor shape explains most of what may be left, which noise may hide a part of."""
    left = max(model.energy - model.offset - count, 0.0) + policy.QUIET_DEVIATIONS * (np.sqrt(max(count, 1.0)) + model.slack)
    return is_plain(one) and model.energy - one.energy >= policy.MOST_SHARE * left


def behind_nats(rival: Model, model: Model, number: int, count: float) -> float:
    """How far a rival of one effect is behind, by what the soundings say and one nat (Akaike) per number: that it is less simple
    does not rule it out. But that something moves wants to be shown: a way that fits what stands still is one of many."""
    one, other = rival.effects[number], model.effects[number]
    more = one.family.price_nats - other.family.price_nats
    each = 1.0 if one.family.lasts == other.family.lasts else number_price_nats(count)
    return rival.energy - model.energy + more + each * (one.family.told_numbers(one) - other.family.told_numbers(other))


def beside_fields(model: Model) -> float:
    """Nats that any effect may gain from what few patches of a random field send alike."""
    return policy.BESIDE_ROUGH_NATS if any(effect.family.is_flexible for effect in model.effects) else 0.0


def beside_rough(before: Model, one: Model) -> float:
    """Nats that any effect may gain so, or, where edges are heard, from edges that bend in no phase of the theory's: less by what
    these gained, if with this effect they are heard and need not bend otherwise any more."""
    eased = max(before.loose[1], 0.0) if any(one.loose) and one.loose[1] <= 0 else 0.0
    edges = policy.BESIDE_ROUGH_NATS - eased if any(before.loose) else 0.0
    return max(beside_fields(before), edges)


def beside_edges(model: Model) -> float:
    """Nats that any effect may gain from edges that bend otherwise than the theory has it."""
    return policy.LOOSE_SHARE * model.loose[1]


def at_once(ears, one: Model, before: Model) -> bool:
    """Whether, beside something that passes, an effect that lasts explains one response alone, and no powers: where a shadow
    begins no law knows so well. What random fields explain is in no response's residual."""
    family = one.effects[-1].family
    if not family.lasts or family.is_flexible or not any(effect.family.has_ways for effect in before.effects):
        return False
    told, powers = [0.0], 0.0
    for ear, old, new in zip(ears, before.fits, one.fits, strict=True):
        if ear.has_responses:
            told += (ear.row_nats(old) - ear.row_nats(new)).ravel().tolist()
        else:
            powers += old.energy - new.energy
    return powers < policy.LEAST_EVIDENCE_NATS and sum(told) - max(told) < policy.LEAST_EVIDENCE_NATS


def pruned(ears, model: Model, count: float, tried: float) -> Model:
    """Without effects that no longer pay, or are none to speak of."""
    number = 0
    while number < len(model.effects) > 1:
        less = fitted(ears, without_effects(ears, model, [number]), rounds=4)
        least = max(policy.LEAST_EVIDENCE_NATS / 2, model.slack, beside_rough(less, model), beside_edges(model))
        if is_negligible(model, number) or evidence(less, count, tried) > evidence(model, count, tried) - least:
            model = less
        else:
            number += 1
    return model
