# SPDX-License-Identifier: GPL-3.0-or-later
"""What came close to an effect, in its place among all others."""

from collections.abc import Sequence

import numpy as np

from ...twin.places.families.base import Effect
from . import foretold, open_wells, policy, rounds, settling, weighing
from .budget import Budget
from .ears import of_links
from .fit import Ear, Model, evaluated, fitted, replaced, with_effect, without_effects
from .view import View


def is_one_of_many(ears, model: Model, ways: dict, number: int) -> bool:
    """Whether another way than an effect's explains nearly as much: then a third, which nobody found, may be the one."""
    own, span_s = model.effects[number], settling.span_s(ears)
    others = [fitted(ears, replaced(ears, model, number, one), rounds=4) for one in ways.get(own.key, ())]
    return any(
        one.energy < model.energy + policy.WAY_NATS and not own.family.is_same_way(model.base, own, one.effects[number], span_s)
        for one in others
    )


def with_kin(model: Model, others: dict) -> dict:
    """What came close to each effect, and the same of all of its owner's material, or of one of these things alone."""
    out = dict(others)
    for effect in model.effects:
        out[effect.key] = [*out.get(effect.key, ()), *effect.family.kin(model.base, effect)]
    return out


def with_images(ears, model: Model, others: dict, unknown: dict, budget: Budget) -> dict:
    """What came close to each effect, and what moves mirror images as it does: another mirror, or a node."""
    out, have = dict(others), {effect.key for effect in model.effects}
    for number, effect in enumerate(model.effects):
        shift_m = effect.family.images_moved_m(effect)
        if shift_m is None or budget.is_spent:
            continue
        view = View(ears, without_effects(ears, model, [number]), unknown)
        same = [one for family in view.families for one in family.moving_images(view, shift_m) if one.key not in have]
        begun = [low for one in same for low in _lows(ears, model, number, one)]
        begun = sorted(begun, key=lambda one: one.energy)[: 2 * policy.ASKED_AGAIN]
        fits = [fitted(ears, one, rounds=policy.SCREEN_ROUNDS, free=[number]) for one in begun]
        fits.sort(key=lambda one: one.energy)
        out[effect.key] = [*out.get(effect.key, ()), *(one.effects[number] for one in fits[: policy.ASKED_AGAIN])]
    return out


def _lows(ears, model: Model, number: int, one: Effect) -> list[Model]:
    """The model with another effect in the place of one of its own, or, where it is one length, at the bottoms of the wells of
    its phase around that: what it stands for may be in a wrong one."""
    if len(one.values) > 1:
        return [replaced(ears, model, number, one)]
    step_m = model.base.wavelength_m / policy.WELL_STEPS
    along = [one.moved(one.values + step_m * k) for k in range(-policy.WELLS_AROUND, policy.WELLS_AROUND + 1)]
    tried = [replaced(ears, model, number, other) for other in along]
    energy = [one.energy for one in tried]
    return [tried[k] for k in range(1, len(tried) - 1) if energy[k] < min(energy[k - 1], energy[k + 1])]


def with_wide(ears, model: Model, others: dict, briefly: set, unknown: dict, budget: Budget) -> dict:
    """What came close to each effect, and to those that were found `briefly` what of wide families explains most of what they
    do, looked for where links tell of them. Of a place or a material many links tell, and nothing else does so on all of them."""
    out = dict(others)
    for number, effect in enumerate(model.effects):
        if effect.key not in briefly or budget.is_spent:
            continue
        less, few = _without(ears, model, [number])
        if not (_is_local(model.base, effect) or effect.family.is_like_wide) and _are_many(few, ears):
            continue
        found = _explaining(ears, model, [number], less, few, unknown, budget, policy.MOST_SHARE)
        settled = [settling.settled(ears, with_effect(ears, less, one), unknown, budget).effects[-1] for one in found]
        out[effect.key] = [*out.get(effect.key, ()), *settled]
    return out


def wide_instead(ears, model: Model, least: int, unknown: dict, budget: Budget) -> list[Effect]:
    """What one thing of a wide family would be that explains what those effects do together that are of links, nodes and
    objects and not wide themselves, `least` of them, where not too many links tell of these for one thing."""
    local = [n for n, effect in enumerate(model.effects) if _is_local(model.base, effect) and not effect.family.is_wide]
    if len(local) < least or budget.is_spent:
        return []
    less, few = _without(ears, model, local)
    if _are_many(few, ears) and not any(model.effects[number].family.level == "node" for number in local):
        return []  # a node may be an end of all links
    return _explaining(ears, model, local, less, few, unknown, budget, policy.SAME_SHARE)


def _is_local(base, effect: Effect) -> bool:
    return effect.family.level_of(base, effect.owner) not in ("place", "material")


def _explaining(
    ears, model: Model, numbers: Sequence[int], less: Model, few: list, unknown: dict, budget: Budget, share: float
) -> list[Effect]:
    """Of wide families what explains, where links tell of it, a share of what effects of a model do beyond a lesser one, their
    prices taken off; the best first, of each family and owner one."""
    count = sum(ear.count for ear in ears)
    price = sum(weighing.numbers_price_nats(model.effects[number], count) for number in numbers)
    least = share * (less.tempered - model.tempered - price)
    found = rounds.wide_guesses(few, evaluated(few, model.base, less.effects), unknown, budget) if few else []
    best: dict[tuple, Effect] = {}
    for one in found:
        if one.promise >= least:
            best.setdefault(one.effects[-1].key, one.effects[-1])
    return [*best.values()][: policy.FITTED_AFTER_SCREEN]


def _without(ears, model: Model, numbers: Sequence[int]) -> tuple[Model, list]:
    """The model without effects, and the soundings; of responses the links alone of which these explain something."""
    less = fitted(ears, without_effects(ears, model, numbers), rounds=policy.SCREEN_ROUNDS)
    few = []
    for ear, before, after in zip(ears, less.fits, model.fits, strict=True):
        if not ear.has_responses:
            few.append(ear)
        elif len(told := np.flatnonzero(ear.nats(before) - ear.nats(after) > policy.LINK_NATS)):
            few.append(of_links(ear, tuple(told.tolist())))
    return less, few


def _are_many(few: Sequence[Ear], ears: Sequence[Ear]) -> bool:
    """Whether some soundings are responses of more links than one thing that stands somewhere is likely to be seen by."""
    some, every = ({link for ear in those if ear.has_responses for link in ear.predictor.links} for those in (few, ears))
    return len(some) > max(len(every) / 2, policy.LONE_LINKS)


def exchanged(ears, model: Model, others: dict, count: float, tried: float, budget: Budget, vault: Sequence[Ear] = ()):
    """What came close when an effect was found, in its place now: the better one stays, the other is a rival; of two that explain
    alike, it is the one that predicts the vault. What tells of the vault is nothing that was there for once."""
    rivals: dict = {}
    for number in range(len(model.effects)):
        model = _of_its_kinds(ears, vault, model, number, others, count)
        effect = model.effects[number]
        trials, stays = [], foretold.told_nats(vault, model)[number] > policy.REFUSED_NATS
        for other in others.get(effect.key, ()):
            if other.key in {e.key for e in model.effects} or budget.is_spent or stays and not other.family.lasts:
                continue
            trial = fitted(ears, replaced(ears, model, number, other), rounds=4)
            trials += [] if weighing.is_negligible(trial, number) else [trial]
        apart = {id(one): _foreseen_nats(ears, vault, one, model, number, count) for one in trials}
        trials.sort(key=lambda one: apart[id(one)] - weighing.worth(one, model, count, tried))
        if trials and weighing.worth(trials[0], model, count, tried) - apart[id(trials[0])] > 1.0:
            trials[0], model = model, trials[0]
            apart = {id(one): _foreseen_nats(ears, vault, one, model, number, count) for one in trials}
        own = model.effects[number]
        behind = [(one.effects[number], weighing.behind_nats(one, model, number, count) + apart[id(one)]) for one in trials]
        rivals[own.key] = sorted(behind, key=lambda pair: pair[1])
    return model, rivals


def _of_its_kinds(ears, vault: Sequence[Ear], model: Model, number: int, others: dict, count: float) -> Model:
    """The model with that fit of an effect which, of those that explain the soundings alike, predicts the vault best: a pattern
    of a node, or a wall, that the fitted soundings leave open."""
    for one in open_wells.kinds(ears, model, number, others):
        other = fitted(ears, one, rounds=4)
        if weighing.behind_nats(other, model, number, count) + _foreseen_nats(ears, vault, other, model, number, count) < -1.0:
            model = other
    return model


def _foreseen_nats(ears, vault: Sequence[Ear], rival: Model, model: Model, number: int, count: float) -> float:
    """By how much a rival that the fitted soundings leave open predicts the vault worse than the model; 0 of all others. Where
    one of both may have been there for once, the other one is likelier for what it explains of the vault, and not less for what
    it does not."""
    lasts, stays = rival.effects[number].family.lasts, model.effects[number].family.lasts
    most = 2 * policy.RIVAL_NATS + weighing.beside_fields(model)
    if not vault or not (lasts or stays) or weighing.behind_nats(rival, model, number, count) > most:
        return 0.0
    nats = foretold.foreseen(ears, vault, rival) - foretold.foreseen(ears, vault, model)
    return nats if lasts and stays else min(nats, 0.0) if lasts else max(nats, 0.0)
