# SPDX-License-Identifier: GPL-3.0-or-later
"""What soundings that nothing was fitted to say of what was found: which effects they refuse, and whether they are predicted."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import eigh

from . import policy
from .fit import Ear, Model, evaluated, fitted, normal_equations, without_effects
from .view import View

_LEAST_KNOWN = 1e-8  # of what is known of a number with the vault, the part without: what is known is no wider than the place


def refused(vault: Sequence[Ear], model: Model) -> list[int]:
    """Numbers of effects that make the vault less likely, by more than what the model leaves there can account for; beside random
    fields, or without these, which take what is wrong for their own."""
    stiff = [number for number, effect in enumerate(model.effects) if not effect.family.is_flexible]
    alone = evaluated(vault, model.base, [model.effects[number] for number in stiff]) if len(stiff) < len(model.effects) else None
    return sorted({*_refused(vault, model), *(stiff[number] for number in (_refused(vault, alone) if alone else ()))})


def _refused(vault: Sequence[Ear], model: Model) -> list[int]:
    nats = told_nats(vault, model)
    if min(nats, default=0.0) > -policy.REFUSED_NATS:
        return []
    told = evaluated(vault, model.base, model.effects)
    left = max(0.0, told.left_nats(sum(ear.count for ear in vault)))
    return [number for number, one in enumerate(nats) if one < -policy.REFUSED_NATS - policy.REFUSED_SHARE * left]


def told_nats(vault: Sequence[Ear], model: Model) -> list[float]:
    """Nats by which each effect predicts soundings that it was not fitted to; 0 of what does not last from one to the next."""
    if not vault or not model.effects:
        return [0.0] * len(model.effects)
    told = evaluated(vault, model.base, model.effects)
    return [
        without_effects(vault, told, [number]).energy - told.energy if effect.family.lasts else 0.0
        for number, effect in enumerate(model.effects)
    ]


def holds(view: View, vault: Sequence[Ear], at_best: bool = False) -> bool:
    """Whether the responses of the vault are predicted as well as their noise lets one know, with or without what may have been
    there for once, and wherever what was added ends: that the soundings of one campaign do not show; and no effect is refused.
    `at_best`: or as well as the doubt of the numbers lets one know."""
    vault = [one for one in vault if one.has_responses]
    if not vault:
        return True
    if refused(vault, view.model):
        return False
    model, count = view.model, sum(one.count for one in vault)
    lasting = [one for one in model.effects if one.family.lasts]
    told, other, twin = (evaluated(vault, model.base, effects) for effects in (model.effects, lasting, ()))
    sizes = zip(*(one.family.sizes(view, one) for one in model.effects), strict=True)
    resized = [evaluated(vault, model.base, effects) for effects in sizes]
    ended = sum(
        float((one.row_nats(fits[0]) - np.minimum.reduce([one.row_nats(fit) for fit in fits])).sum())
        for one, *fits in zip(vault, told.fits, *(each.fits for each in resized), strict=True)
    )
    after, before = min(told.left_nats(count) - ended, other.left_nats(count)), twin.left_nats(count)
    is_flexible = any(one.family.is_flexible for one in model.effects)
    if not is_flexible and before > policy.SEEN_DEVIATIONS * np.sqrt(count) and after > policy.UNTOLD_MOST * before:
        return False  # the vault shows something, and it is not this
    share = policy.UNTOLD_BY_FIELDS if is_flexible else policy.UNTOLD_SHARE
    most = max(policy.UNTOLD_NOISE * count, share * before)
    if not at_best or is_flexible:
        return after < most or at_best and _left_at_best(view, vault)[0] < most
    # With its numbers at their best a list leaves no more than noise of the vault, and of both together.
    there, both = min((after + ended, after + ended + model.left_nats(view.count)), _left_at_best(view, vault))
    return all(
        left - ended < max(policy.CLEAN_DEVIATIONS * np.sqrt(of), share * before)
        for left, of in ((there, count), (both, count + view.count))
    )


def _left_at_best(view: View, vault: Sequence[Ear]) -> tuple[float, float]:
    """Nats that numbers leave there which explain the vault too, and of all; infinite if these leave something of what was
    fitted, or lose much of what an effect explains of it."""
    ears, model = view.ears, view.model
    together, count, there = (*ears, *vault), *(sum(one.count for one in some) for some in (ears, vault))
    if model.deviations(count) > policy.CLEAN_DEVIATIONS:
        return np.inf, np.inf
    effects = fitted(together, evaluated(together, model.base, model.effects)).effects
    here = evaluated(ears, model.base, effects)
    least = min((without_effects(ears, model, [k]).energy - model.energy for k in range(len(effects))), default=0.0)
    if here.energy - model.energy > policy.RESETTLED_SHARE * least or here.deviations(count) > policy.CLEAN_DEVIATIONS:
        return np.inf, np.inf
    lasting = [one for one in effects if one.family.lasts]
    left = min(evaluated(vault, model.base, some).left_nats(there) for some in (effects, lasting))
    return left, left + here.left_nats(count)


def foreseen(ears: Sequence[Ear], vault: Sequence[Ear], model: Model) -> float:
    """Energy of the vault as it is predicted by all that lasts, whose numbers are as open as the fitted soundings leave them: of
    the mean likelihood over them, where it is a Gaussian's."""
    effects = tuple(effect for effect in model.effects if effect.family.lasts)
    told, fitted_to = (evaluated(some, model.base, effects) for some in (vault, ears))
    numbers = np.arange(sum(len(effect.values) for effect in effects))
    if not len(numbers):
        return told.energy
    (there, side), (here, _) = normal_equations(vault, told, numbers), normal_equations(ears, fitted_to, numbers)
    scale = 1 / np.sqrt(np.diag(here + there) + 1e-300)
    both, here = ((one * scale[:, None] * scale) for one in (here + there, here))
    ridge = _LEAST_KNOWN * np.eye(len(both))  # what neither tells is as it was
    known = eigh(here + ridge, both + ridge, eigvals_only=True)
    step = np.linalg.lstsq(both, side * scale, rcond=1e-10)[0]
    return told.energy - float(step @ (side * scale)) - 0.5 * float(np.log(np.clip(known, _LEAST_KNOWN, 1.0)).sum())
