# SPDX-License-Identifier: GPL-3.0-or-later
"""Which effects explain the soundings of a place: rounds of candidates, each fitted with all found before; then elimination."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from . import elsewhere, exchange, foretold, open_wells, policy, rounds, settling, weighing
from .budget import Budget
from .fit import Ear, Model, evaluated, fitted, replaced, without_effects
from .rounds import Barred
from .view import View


@dataclass(frozen=True, eq=False, kw_only=True)
class Found:
    """The chosen model, what came close to each of its effects, and how sure the counting is."""

    model: Model
    start: Model
    rivals: dict
    tried: int
    count: float
    spent: bool
    ways: dict = field(default_factory=dict)  # of what passes by, others that came close

    @property
    def deviations(self) -> float:
        return self.model.deviations(self.count)


def run(
    ears: Sequence[Ear], base, unknown: dict, budget_s: float, progress=lambda text: None, vault: Sequence[Ear] = ()
) -> Found:
    """Search, elimination, rivals; `budget_s` of processor time, a part of it for the rivals. What the `vault` refuses is taken
    out again, and the search goes on without it; no number is fitted to it, of what is open it has the choice."""
    budget = Budget.of((1 - policy.RIVALS_SHARE) * budget_s)
    start = model = evaluated(ears, base, ())
    count = sum(ear.count for ear in ears)
    others: dict = {}
    barred, brief = Barred(), any(ear.has_responses for ear in ears)  # power alone tells of nothing wide
    found: list[Model] = []
    told: tuple[Model | None, set] = None, set()  # the list of brief rounds, and what of it was found in these
    while True:
        model, tried = _explored(ears, model, unknown, budget, others, barred, progress, brief)
        refused = foretold.refused(vault, model)
        if brief and barred.briefly and not budget.is_spent:
            is_told = not refused and _is_told(model, count) and _is_foretold(ears, vault, model, unknown, count)
            instead = exchange.wide_instead(ears, model, 2, unknown, budget) if is_told else []
            for key in barred.briefly:
                others[key] = [*others.get(key, ()), *instead]
            if not is_told or instead:
                found.append(model)
                told, model, brief = (model, set(barred.briefly)), start, False
                barred.briefly.clear()
                continue
        if refused and (other := open_wells.otherwise(ears, vault, model, refused[0], unknown, others, budget)):
            model, refused = other, foretold.refused(vault, other)
        if not refused and (unshown := _unshown(ears, vault, model)):
            model = _barring(ears, model, unshown, barred)
            others = _open(others, barred, model)
            if not budget.is_spent:
                continue
        found.append(model)
        if not refused:
            model = _confirmed(ears, vault, model, unknown, budget, others, barred)
            break
        model = _barring(ears, model, refused, barred)
        if budget.is_spent:
            break
    if not _is_foretold(ears, vault, model, unknown, count):  # nor was what was refused, which may lack its shape alone
        model = max(
            [*found, model], key=lambda one: weighing.evidence(one, count, tried) - evaluated(vault, base, one.effects).energy
        )
    others = exchange.with_wide(ears, model, others, told[1] if model is told[0] else barred.briefly, unknown, budget)
    spent = budget.is_spent
    budget = Budget.of(policy.RIVALS_SHARE * budget_s)
    others = _open(exchange.with_images(ears, model, exchange.with_kin(model, others), unknown, budget), barred, model)
    tracks = [one for one in (*itertools.chain(*others.values()), *model.effects) if one.family.has_ways]
    ways = {track.key: [one for one in tracks if one.key == track.key] for track in tracks}
    known = {effect.key for effect in model.effects}
    model, rivals = exchange.exchanged(ears, model, others, count, tried, budget, vault)
    model = weighing.pruned(ears, model, count, tried)  # what one of its kinds explains better, another need not explain any more
    for number in foretold.refused(vault, model):  # what came in another's place for what is open of its numbers
        key, before = model.effects[number].key, model.energy
        if key not in known and not budget.is_spent:
            model = open_wells.in_its_well(ears, vault, model, number, unknown, others, budget)
            rivals[key] = [(one, nats + before - model.energy) for one, nats in rivals.get(key, ())]
    return Found(model=model, start=start, rivals=rivals, tried=tried, count=count, spent=spent, ways=ways)


def _barring(ears, model: Model, numbers: list[int], barred: Barred) -> Model:
    """The model without effects, which are not looked for again where no more than the rest is known."""
    less = settling.as_strong(ears, fitted(ears, without_effects(ears, model, numbers)))
    barred.add([model.effects[number] for number in numbers], less)
    return less


def _is_foretold(ears, vault: Sequence[Ear], model: Model, unknown: dict, count: float) -> bool:
    """Whether a model leaves nothing of what it was fitted to, nor of the vault."""
    return model.deviations(count) < policy.CLEAN_DEVIATIONS and foretold.holds(View(ears, model, unknown), vault)


def _confirmed(ears, vault: Sequence[Ear], model: Model, unknown: dict, budget: Budget, others: dict, barred: Barred) -> Model:
    """The model as the vault has it, where it is not predicted: what was added there where it predicts it best, and with what
    explains too little beside an added object, whose shape may be wrong by as much, or beside edges, to be told for what it was
    fitted to, but is told by the vault too."""
    count = sum(ear.count for ear in ears)
    if not vault or budget.is_spent or _is_foretold(ears, vault, model, unknown, count):
        return model
    most = model.energy + policy.RIVAL_NATS
    for number in range(len(model.effects)):
        model = open_wells.moved_beside(ears, vault, model, number, most)
        model = open_wells.in_its_well(ears, vault, model, number, unknown, others, budget)
    while len(model.effects) < policy.MOST_EFFECTS and not budget.is_spent:
        if _is_foretold(ears, vault, model, unknown, count):
            break
        found, tried = rounds.candidates(ears, model, unknown, budget, barred)
        least = max(policy.LEAST_EVIDENCE_NATS, model.slack, weighing.beside_fields(model))
        paying = [one for one in found if weighing.worth(one, model, count, tried) > least and not foretold.refused(vault, one)]
        paying = [one for one in paying if not weighing.at_once(ears, one, model)]
        before = evaluated(vault, model.base, model.effects)
        told = {id(one): before.energy - evaluated(vault, one.base, one.effects).energy for one in paying}
        best = max(paying, key=lambda one: told[id(one)], default=None)
        least = max(least, policy.CONFIRMED_SHARE * before.left_nats(sum(ear.count for ear in vault)))
        if best is None or told[id(best)] < least:
            break
        others[best.effects[-1].key] = [one.effects[-1] for one in found if one is not best]
        model = settling.as_strong(ears, best)
    return model


def _explored(
    ears, model: Model, unknown: dict, budget: Budget, others: dict, barred: Barred, progress, brief: bool
) -> tuple[Model, int]:
    """The best model with effects, and how many were tried for the last: where going on with the best each time does not end at
    noise, or with a random field, what came close to one of the best is gone on with instead, the closest first; but not where
    rounds were `brief`, which are made whole then."""
    count = sum(ear.count for ear in ears)
    open_: list[tuple[float, Model]] = []
    expanded: dict = {}
    best, tried = _grown(ears, model, unknown, budget, others, barred, open_, expanded, progress, brief)
    if brief and barred.briefly:
        return best, tried
    while open_ and not budget.is_spent and not _is_told(best, count):
        open_.sort(key=lambda pair: pair[0])
        other = open_.pop(0)[1]
        if weighing.has_shape(other):  # which may have had to wait
            other = settling.settled(ears, other, unknown, budget)
        other, tried = _grown(ears, other, unknown, budget, others, barred, open_, expanded, progress, brief)
        best = max(best, other, key=lambda one: weighing.evidence(one, count, tried))
    return best, tried


def _by_shape(ears, model: Model) -> float:
    """Nats that effects explain whose shape is known in part alone."""
    numbers = [number for number, effect in enumerate(model.effects) if effect.family.shape_axes]
    return without_effects(ears, model, numbers).energy - model.energy if numbers else 0.0


def _is_told(model: Model, count: float) -> bool:
    """Whether a model leaves nothing, and no random field takes part in that: those explain much that they are not."""
    return model.deviations(count) < policy.CLEAN_DEVIATIONS and not any(one.family.is_flexible for one in model.effects)


def _grown(
    ears, model: Model, unknown: dict, budget: Budget, others: dict, barred: Barred, open_: list, expanded: dict, progress,
    brief: bool,
) -> tuple[Model, int]:  # fmt: skip
    """The model with effect after effect as long as they pay, none of them `barred`, and how many were tried; what came next to
    each goes to `others`, what came close to it, with its regret, to `open_`."""
    count, tried = sum(ear.count for ear in ears), 1
    while not budget.is_spent:
        if len(model.effects) >= policy.MOST_EFFECTS:
            model = _looked_for_anew(ears, model, unknown, budget, tried, others)
            if len(model.effects) >= policy.MOST_EFFECTS:
                break
        keys = frozenset(effect.key for effect in model.effects)
        if model.energy > expanded.get(keys, np.inf) - policy.LEAST_EVIDENCE_NATS:
            break
        expanded[keys] = model.energy
        progress(f"looking for effect {len(model.effects) + 1}")
        made = rounds.brief(ears, model, unknown, budget, barred) if brief else None
        paying = _paying(ears, *made, model) if made else []
        if not any(weighing.tells_most(one, model, count) for one in paying):
            is_doubtful = brief and keys & barred.briefly and model.deviations(count) > policy.CLEAN_DEVIATIONS
            if is_doubtful and exchange.wide_instead(ears, model, 1, unknown, budget):
                break
            made = rounds.candidates(ears, model, unknown, budget, barred)
            paying = _paying(ears, *made, model)
        found, tried = made
        worths = {id(one): weighing.worth(one, model, count, tried) for one in found}
        if not paying:
            model, before = _looked_for_anew(ears, model, unknown, budget, tried, others), model
            if model is before:
                break
            continue
        hidden = [
            one
            for one in elsewhere.instead(ears, model, budget)
            if not barred.bars(one.effects[-1].key, {effect.key for effect in one.effects[:-1]})
            and not weighing.at_once(ears, one, model)
        ]
        worths |= {id(one): weighing.worth(one, model, count, tried) for one in hidden}
        found, paying = (sorted([*some, *hidden], key=lambda one: -worths[id(one)]) for some in (found, paying))
        good = _good_stiff(paying, worths, model, count)
        best = _stiff_first(paying, good, model, count)
        if brief and barred.briefly and best.effects[-1].family.is_flexible:
            break  # a list with a random field is held against others, in whole rounds
        known = {best.effects[-1].key}
        for one in paying:
            effect = one.effects[-1]
            regret = 1 - worths[id(one)] / worths[id(best)]
            if effect.family.is_flexible or one is good:
                regret = policy.FLEXIBLE_REGRET
            if regret < policy.CLOSE_REGRET and effect.key not in known:
                known.add(effect.key)
                open_.append((regret, one))
        others[best.effects[-1].key] = [one.effects[-1] for one in found if one is not best]
        if rounds.was_brief(model, barred):
            barred.briefly.add(best.effects[-1].key)
        model = weighing.pruned(ears, best, count, tried)
        for gone in {effect.key for effect in best.effects[:-1]} - {effect.key for effect in model.effects}:
            others[best.effects[-1].key] += others.get(gone, ())  # came close to what has its place now
        before = model
        for number in range(len(model.effects) - 1):  # what was found before fits what is known now
            model = settling.in_best_shape(ears, model, number, unknown, budget)
            if model.deviations(count) > policy.QUIET_DEVIATIONS and not budget.is_spent:
                model = settling.begun_anew(ears, model, number)
        if model.effects:
            model = settling.seen_again(ears, model, len(model.effects) - 1, unknown, budget, others)
        model = settling.as_strong(ears, model)
        if model is not before:
            model = weighing.pruned(ears, model, count, tried)
        model = _asked_again(ears, model, count, tried, others, budget, barred)
    return model, tried


def _paying(ears, found: list[Model], tried: float, model: Model) -> list[Model]:
    """Candidates that explain more than they cost, and than what a model has may gain from nothing."""
    count = sum(ear.count for ear in ears)
    least = max(policy.LEAST_EVIDENCE_NATS, model.slack, policy.SHAPE_SHARE * _by_shape(ears, model))
    return [
        one
        for one in found
        if weighing.worth(one, model, count, tried) >= max(least, weighing.beside_rough(model, one), weighing.beside_edges(one))
        and not weighing.at_once(ears, one, model)
    ]


def _looked_for_anew(ears, model: Model, unknown: dict, budget: Budget, tried: float, others: dict) -> Model:
    """The model with one of its effects looked for anew beside all others, where something is left and that explains more of it:
    what was found first was found while the others hid part of it."""
    count = sum(ear.count for ear in ears)
    for number, own in enumerate(model.effects):
        if budget.is_spent or model.deviations(count) < policy.CLEAN_DEVIATIONS:
            break
        seen = settling.seen_again(ears, model, number, unknown, budget, others) if number < len(model.effects) - 1 else model
        if model.energy - seen.energy > policy.LEAST_EVIDENCE_NATS:  # the last one was seen again when it was found
            return weighing.pruned(ears, seen, count, tried)
        if len(model.effects) < 2 or not len(own.values):
            continue
        view = View(ears, fitted(ears, without_effects(ears, model, [number]), rounds=4), unknown)
        heard, here, _ = rounds.overheard(view)
        screened = sorted(rounds.screened(view, heard, here, own.family, own.owner), key=lambda one: one.tempered)
        wells: dict[tuple, list[Model]] = {}
        near = [rounds.by_all(ears, view.model, screened, one, wells) for one in screened[: policy.FITTED_PER_FAMILY]]
        settled = [settling.settled(ears, one, unknown, budget) for one in near]
        best = min(settled, key=lambda one: one.tempered, default=model)
        if weighing.worth(best, model, count, tried) > policy.SHAPE_NATS:
            return weighing.pruned(ears, best, count, tried)
    return model


def _asked_again(ears, model: Model, count: float, tried: float, others: dict, budget: Budget, barred: Barred) -> Model:
    """The model with what came close to an earlier effect in its place, where that is better now: what one link alone lost is its
    node's once another of this node's links loses as much."""
    for number in range(len(model.effects) - 1):
        own, keys = model.effects[number], {effect.key for effect in model.effects}
        found = others.get(own.key, ())
        close = [one for one in found if (one.key not in keys or rounds.may_recur(one.family)) and not one.family.is_flexible]
        close = [one for one in close if not barred.bars(one.key, keys - {own.key})]
        for other in close[: 0 if budget.is_spent else policy.ASKED_AGAIN]:
            trial = weighing.pruned(ears, fitted(ears, replaced(ears, model, number, other), rounds=4), count, tried)
            if weighing.worth(trial, model, count, tried) > policy.SHAPE_NATS:
                others.setdefault(other.key, [own, *(one for one in close if one is not other)])
                if own.key in barred.briefly:
                    barred.briefly.add(other.key)
                return _asked_again(ears, trial, count, tried, others, budget, barred)
    return model


def _stiff_first(paying: list[Model], good: Model | None, model: Model, count: float) -> Model:
    """The candidate to go on with: the best, but something stiff that explains a `good` part before random fields and what has a
    shape to choose, which explain much that they are not, unless they leave nothing where it leaves the most: then little is left
    to look for."""
    best = paying[0]
    if not good or good is best:
        return best
    return best if not weighing.explains_most(good, model, count) and best.deviations(count) < policy.CLEAN_DEVIATIONS else good


def _good_stiff(paying: list[Model], worths: dict, model: Model, count: float) -> Model | None:
    """The best that is no random field, if it explains a good part of what is left, or else the best that explains the most of
    it; of what has a shape and what has none the latter, if it explains the most of that or hardly less than the other. None of
    which is worth little beside a random field: then that hides the rest."""
    here = model.energy - model.offset - count
    stiff = [one for one in paying if not one.effects[-1].family.is_flexible]
    good, plain = stiff[0] if stiff else None, next((one for one in paying if weighing.is_plain(one)), None)
    if plain and good is not plain:
        told, other = model.energy - plain.energy, model.energy - good.energy
        good = plain if told >= min(policy.MOST_SHARE * here, (1 - policy.CLOSE_REGRET) * other) else good
    if good and model.energy - good.energy <= policy.STIFF_SHARE * here:
        good = next((one for one in stiff if weighing.explains_most(one, model, count)), None)
    is_behind = good and worths[id(good)] < policy.STIFF_SHARE * worths[id(paying[0])]
    return None if is_behind and paying[0].effects[-1].family.is_flexible else good


def _open(others: dict, barred: Barred, model: Model) -> dict:
    """What came close to each effect, without what the vault refused and the model has not."""
    have = {effect.key for effect in model.effects}
    return {key: [one for one in found if one.key not in barred.beside or one.key in have] for key, found in others.items()}


def _unshown(ears, vault: Sequence[Ear], model: Model) -> list[int]:
    """Numbers of effects that explain a small part of what random fields beside them do, and nothing of a vault that hears of
    them: patches that send alike."""
    if not any(ear.has_responses for ear in vault) or not any(effect.family.is_flexible for effect in model.effects):
        return []
    least = policy.FIELDS_SHARE * (sum(fit.energy for fit in model.fits) - model.energy)
    return [
        number
        for number, (effect, nats) in enumerate(zip(model.effects, foretold.told_nats(vault, model), strict=True))
        if effect.family.lasts and not effect.family.is_flexible and policy.UNSOUNDED_NATS < abs(nats)
        and nats < policy.LEAST_EVIDENCE_NATS
        and without_effects(ears, model, [number]).energy - model.energy < least
    ]  # fmt: skip
