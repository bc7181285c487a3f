# SPDX-License-Identifier: GPL-3.0-or-later
"""Which effects explain the soundings of a place: rounds of candidates, each fitted with all found before; then elimination."""

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...twin.places.families.base import Effect
from ...twin.places.world import World
from . import elsewhere, foretold, policy
from .ears import holding, thinned_as_fitted
from .fit import Ear, Model, evaluated, fitted, replaced, shows_in, with_effect, without_effects
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


@dataclass(frozen=True, kw_only=True)
class Barred:
    """What the vault refused, by what it was refused `beside`: where more is known, it may be looked for again. What is refused
    twice beside the same is refused for good (None). And the `rounds` that were made since, which need not be made again, and
    what was looked at for any of them, which holds on: what is barred then stays so."""

    beside: dict[tuple, list[frozenset | None]] = field(default_factory=dict)
    rounds: dict[tuple, tuple] = field(default_factory=dict)
    looks: dict[tuple, "_Look"] = field(default_factory=dict)

    def add(self, gone: Sequence[Effect], model: Model) -> None:
        """Effects that were taken out, of which a model is what remains."""
        self.rounds.clear()
        have = frozenset(effect.key for effect in model.effects)
        for key in {effect.key for effect in gone}:
            told = self.beside.setdefault(key, [])
            told.append(None if have in told else have)

    def bars(self, key: tuple, have: set | frozenset) -> bool:
        """Whether it was refused where at least these effects were known."""
        return any(one is None or have <= one for one in self.beside.get(key, ()))


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
    return evidence(model, count, tried) - evidence(before, count, tried) - _freedom(model, before)


def _freedom(model: Model, before: Model) -> float:
    """What edges gain beyond what they gained before, in nats as the evidence of both has them."""
    is_flexible = any(effect.family.is_flexible for effect in (*model.effects, *before.effects))
    part = 0 if is_flexible else 1
    return max(0.0, model.loose[part] - before.loose[part])


@dataclass(frozen=True, eq=False, kw_only=True)
class _Guess:
    """A candidate as it was screened: its effects, the last one new; nats that all soundings promise for it."""

    effects: tuple[Effect, ...]
    energy: float
    promise: float


@dataclass(eq=False, kw_only=True)
class _Look:
    """What one model's round looked at: the keys that were tried; guesses, the best first, None until all were screened; wells
    by key; by guess, the effects from which it is fitted; by guess, and whether it had to wait, those to which it was, None
    where these are nothing to speak of."""

    tried: set[tuple] = field(default_factory=set)
    guesses: list[_Guess] | None = None
    is_part: bool = False
    wells: dict[tuple, list[tuple[Effect, ...]]] = field(default_factory=dict)
    begun: dict[_Guess, tuple[Effect, ...]] = field(default_factory=dict)
    fits: dict[tuple[_Guess, bool], tuple[Effect, ...] | None] = field(default_factory=dict)


def candidates(ears: Sequence[Ear], model: Model, unknown: dict, budget: Budget, barred: Barred) -> tuple[list[Model], int]:
    """Models with one effect more, fitted, the best evidence first; and how many were tried. None where time ran out before
    all had been looked at: the best of a few is no answer."""
    key = _of_round(model)
    if key not in barred.rounds:
        made = _round(ears, model, unknown, budget, barred)
        if budget.is_spent:
            return made
        barred.rounds[key] = made
    return barred.rounds[key]


def _of_round(model: Model) -> tuple:
    return frozenset(effect.key for effect in model.effects), model.energy


def _round(ears: Sequence[Ear], model: Model, unknown: dict, budget: Budget, barred: Barred) -> tuple[list[Model], int]:
    have = {effect.key for effect in model.effects}
    look = barred.looks.setdefault(_of_round(model), _Look())
    if look.guesses is None:
        _look(look, View(ears, model, unknown), barred, budget)
    count, span_s = sum(ear.count for ear in ears), _span_s(ears)
    guesses = [one for one in look.guesses or () if not barred.bars(one.effects[-1].key, have)]
    tried = sum(not barred.bars(key, have) for key in look.tried)
    chosen, crowd = [], {}
    for one in guesses:
        name = one.effects[-1].family.name
        is_known = any(_is_again(model.base, one, other, span_s) for other in chosen)
        if crowd.get(name, 0) < policy.FITTED_PER_FAMILY and len(chosen) < policy.FITTED_AFTER_SCREEN and not is_known:
            crowd[name] = crowd.get(name, 0) + 1
            chosen.append(one)
    final: list[Model] = []
    chosen.sort(key=_has_shape)  # what has a shape takes long, and may have to wait for what has none
    for one in chosen:
        is_far_behind = final and one.promise < policy.BEHIND_SHARE * max(worth(done, model, count, tried) for done in final)
        is_hopeless = _has_shape(one) and any(_is_plain(done) and _explains_most(done, model, count) for done in final)
        waits = bool(is_far_behind or is_hopeless)
        if (one, waits) in look.fits:
            effects = look.fits[one, waits]
            final += [evaluated(ears, model.base, effects)] if effects else []
            continue
        if one not in look.begun:
            look.begun[one] = _by_all(ears, model, look.guesses, one, look.wells).effects if look.is_part else one.effects
        begun = evaluated(ears, model.base, look.begun[one])
        fit = fitted(ears, begun, rounds=policy.SCREEN_ROUNDS) if waits else _settled(ears, begun, unknown, budget)
        stands = _stands_out(ears, fit, count, tried)
        final += [fit] if stands else []
        if not budget.is_spent:
            look.fits[one, waits] = fit.effects if stands else None
    return sorted(final, key=lambda one: -worth(one, model, count, tried)), tried


def _look(look: _Look, view: View, barred: Barred, budget: Budget) -> None:
    """All candidates, screened; nothing where time ran out before all had been."""
    have, count = {effect.key for effect in view.model.effects}, sum(ear.count for ear in view.ears)
    heard, here, more = _overheard(view)
    others = [] if budget.is_spent else _in_open_wells(heard, here, more)
    guesses = []
    for family in view.families:
        for owner in family.owners(view):
            key = family.name, owner
            if barred.bars(key, have) or key in have and not _may_recur(family):
                continue
            if budget.is_spent:
                return
            look.tried.add(key)
            for one in _screened(view, heard, here, family, owner, others):
                gain = here.tempered - one.tempered - _freedom(one, here)
                promise = more * gain - numbers_price_nats(one.effects[-1], count)
                guesses.append(_Guess(effects=one.effects, energy=one.energy, promise=promise))
    guesses.sort(key=lambda one: one.promise, reverse=True)
    look.guesses, look.is_part = guesses, more > 1


def _in_open_wells(heard: Sequence[Ear], here: Model, more: float) -> list[Model]:
    """A model with one of its effects in another well of its phase, which the soundings leave open: what is looked for beside the
    wrong one may not be found."""
    heard, out = holding(heard, here.world), []
    for number, own in enumerate(here.effects):
        if own.family.shape_axes or own.family.is_flexible:
            continue
        fits = _refitted(heard, here, number, policy.FULL_STARTS)
        near = [one for one in fits if more * abs(one.energy - here.energy) < policy.RIVAL_NATS]  # no part's own deepest
        near.sort(key=lambda one: one.energy)
        apart = _distinct(here.base, [own, *(one.effects[number] for one in near)])[1:]
        out += [one for one in near if one.effects[number] in apart]
    return sorted(out, key=lambda one: one.energy)[: policy.OPEN_WELLS]


def _by_all(ears, model: Model, screened: Sequence[Model | _Guess], one: Model | _Guess, wells: dict) -> Model:
    """What was chosen on a part of the soundings, on all of them: of a family whose wells only a fit tells apart, the best that
    is left of its key in `wells`, for a part may hold the wrong well of a phase for the deepest."""
    effect = one.effects[-1]
    if effect.family.ranks_unfitted or effect.family.shape_axes:
        return evaluated(ears, model.base, one.effects)
    if effect.key not in wells:
        begun = [other.effects for other in screened if other.effects[-1].key == effect.key][: policy.WELLS]
        fits = sorted((_quick(ears, evaluated(ears, model.base, effects)) for effects in begun), key=lambda fit: fit.tempered)
        apart = {id(own) for own in _distinct(model.base, [fit.effects[-1] for fit in fits])}
        wells[effect.key] = [fit.effects for fit in fits if id(fit.effects[-1]) in apart]
    return evaluated(ears, model.base, wells[effect.key].pop(0) if wells[effect.key] else one.effects)


def _span_s(ears: Sequence[Ear]) -> tuple[float, float]:
    """When the first and the last sounding was made."""
    times_s = np.concatenate([ear.predictor.time_s for ear in ears])
    return float(times_s.min()), float(times_s.max())


def _is_again(base: World, one: _Guess, other: _Guess, span_s: tuple[float, float]) -> bool:
    """Whether the last effects are the same, for all that soundings tell, or one way of the same passer."""
    mine, its = one.effects[-1], other.effects[-1]
    if mine.key != its.key:
        return False
    if mine.family.is_flexible or one.energy == other.energy:
        return True
    if mine.family.has_ways:
        return mine.family.is_same_way(base, mine, its, span_s)
    is_chosen_alike = not mine.family.shape_axes and mine.choice == its.choice
    return is_chosen_alike and abs(one.energy - other.energy) < policy.SAME_NATS


def _may_recur(family) -> bool:
    """Whether one owner may have several: a place is where all that nobody drew is."""
    return family.level == "place"


def _stands_out(ears, model: Model, count: float, tried: float) -> bool:
    """Whether the last effect is one to speak of, and explains more than the same without what sets its family apart."""
    if _is_negligible(model, -1):
        return False
    last = len(model.effects) - 1
    others = model.effects[last].family.plainer(_span_s(ears), model.effects[last])
    plain = (fitted(ears, replaced(ears, model, last, one), free=[last]) for one in others)
    least = evidence(model, count, tried) - policy.LEAST_EVIDENCE_NATS
    return all(evidence(one, count, tried) < least for one in plain)


def _is_negligible(model: Model, number: int) -> bool:
    return model.effects[number].family.is_negligible(model.effects[number])


def _screened(view: View, heard: Sequence[Ear], here: Model, family, owner: str, others: Sequence[Model] = ()) -> list[Model]:
    """Models with one effect more, from the most promising of its family's first guesses, the best one beside the best of
    `others`, in which something is in another well; none of them but a random field changes what is scattered, yet."""
    starts = family.starts(view, owner)
    heard = heard if family.is_flexible else holding(heard, here.world)
    if len(starts) > policy.FULL_STARTS and family.ranks_unfitted:
        starts = list({id(one): one for one in (*view.ranked(starts)[: policy.FULL_STARTS], starts[0])}.values())
    alone = sorted((_quick(heard, with_effect(heard, here, start)) for start in starts), key=lambda one: one.tempered)
    if not here.effects or not alone:
        return alone
    best, rest = alone[: policy.FITTED_PER_FAMILY], alone[policy.FITTED_PER_FAMILY :]
    # What was found before has taken some of what is another's for its own.
    free = [n for n, effect in enumerate(best[0].effects) if family.is_flexible or not effect.family.is_flexible]
    fits = [fitted(heard, one, rounds=policy.SCREEN_ROUNDS, free=free) for one in best]
    if not family.shape_axes:
        beside = (_quick(heard, with_effect(heard, other, best[0].effects[-1])) for other in others)
        beside = [fitted(heard, one, rounds=policy.SCREEN_ROUNDS, free=free) for one in beside]
        fits[0] = min([fits[0], *beside], key=lambda one: one.tempered)
    return fits + rest


def _overheard(view: View) -> tuple[Sequence[Ear], Model, float]:
    """What candidates are screened on: the soundings, thinned where what is left shows in a part of them just as well; the
    model there, and how much more the whole says."""
    parts = (thinned_as_fitted(view.ears, view.model.fits, times) for times in policy.SCREENED_TIMES)
    thin = next((part for part in parts if shows_in(part, view.ears, view.model)), None)
    if thin is None:
        return view.ears, view.model, 1.0
    count, part = (sum(ear.count for ear in ears) for ears in (view.ears, thin))
    here = fitted(thin, evaluated(thin, view.model.base, view.model.effects), rounds=policy.SCREEN_ROUNDS)
    return thin, here, count / max(part, 1)


def _settled(ears, model: Model, unknown: dict, budget: Budget) -> Model:
    """Fitted, from the best of its family's other beginnings and in its best shape, turn by turn, as far as there is time."""
    if budget.is_spent:
        return model
    last = len(model.effects) - 1
    model = _begun_anew(ears, fitted(ears, model), last)
    for _ in range(policy.RESHAPED):
        shaped = _shaped(ears, model, last, unknown, budget)
        if model.energy - shaped.energy < policy.SHAPE_NATS:
            break
        model = _begun_anew(ears, shaped, last)
    return _trimmed(ears, model, last, unknown)


def _seen_again(ears, model: Model, number: int, unknown: dict, budget: Budget, others: dict) -> Model:
    """One effect that has ways on the best of those that explain most once what is unknown is fitted beside it, as long as that
    gives more: it was found while gains and phases made up for some of it. The `others` that came close stay open."""
    count, family = sum(ear.count for ear in ears), model.effects[number].family
    while family.has_ways and not budget.is_spent and model.deviations(count) > policy.STILL_DEVIATIONS:
        own = model.effects[number]
        found = [replaced(ears, model, number, one) for one in family.again(View(ears, model, unknown), own)]
        near = [fitted(ears, one, rounds=policy.SCREEN_ROUNDS, free=[number]) for one in found]
        near = [_chosen(ears, one, number) for one in _of_each_way(ears, near, number)[: policy.CHOSEN_AGAIN]]
        near = [fitted(ears, one) for one in _of_each_way(ears, near, number)[: policy.FULL_STARTS]]
        best = min((_begun_anew(ears, one, number) for one in near), key=lambda one: one.energy, default=model)
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
        if not any(own.family.is_same_way(one.base, own, other.effects[number], _span_s(ears)) for other in out):
            out.append(one)
    return out


def _pared(ears, model: Model, number: int, unknown: dict) -> Model:
    """As small as the soundings leave it."""
    return _trimmed(ears, model, number, unknown, None)


def _trimmed(ears, model: Model, number: int, unknown: dict, most: int | None = 1) -> Model:
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


def _begun_anew(ears, model: Model, number: int) -> Model:
    """From the best of its family's other beginnings, and of those that the family has from there, until none gives more."""
    for _ in range(policy.RESHAPED):
        before = model
        model = _chosen(ears, model, number)
        model = min((model, *(fitted(ears, one) for one in _restarted(ears, model, number))), key=lambda one: one.energy)
        if before.energy - model.energy < policy.SHAPE_NATS:
            break
    return model


def _chosen(ears, model: Model, number: int) -> Model:
    """With one effect as it is by the best of its choices."""
    others = model.effects[number].family.choices(model.base, model.effects[number])
    best = min((replaced(ears, model, number, one) for one in others), key=lambda one: one.energy, default=model)
    return fitted(ears, best) if best.energy < model.energy else model


def _as_strong(ears, model: Model) -> Model:
    """With random fields as strong as suits what is left beside all others: each was found for all that was not known yet."""
    for number, effect in enumerate(model.effects):
        model = _chosen(ears, model, number) if effect.family.is_flexible else model
    return model


def _restarted(ears, model: Model, number: int, most: int = policy.FULL_STARTS) -> list[Model]:
    """The most promising of other beginnings; of many, those that lead to the least energy in thinned soundings."""
    others = model.effects[number].family.restarts(model.base, model.effects[number])
    if len(others) <= policy.MANY_RESTARTS:
        return sorted((replaced(ears, model, number, one) for one in others), key=lambda one: one.energy)[:most]
    thin = thinned_as_fitted(ears, model.fits)
    known = evaluated(thin, model.base, model.effects)
    ranked = sorted((replaced(thin, known, number, one) for one in others), key=lambda one: one.energy)
    near = [fitted(thin, one, rounds=policy.SCREEN_ROUNDS, free=[number]) for one in ranked[: 4 * most]]
    near.sort(key=lambda one: one.energy)
    best = _distinct(model.base, [one.effects[number] for one in near])[:most]
    return [replaced(ears, model, number, one) for one in best]


def _refitted(ears, model: Model, number: int, most: int) -> list[Model]:
    """From each of these beginnings, one effect fitted beside all others as they are."""
    begun = _restarted(ears, model, number, most)
    return [fitted(ears, one, rounds=policy.SCREEN_ROUNDS, free=[number]) for one in begun]


def _distinct(base, effects: list[Effect]) -> list[Effect]:
    """One of those that fell into the same minimum, the first."""
    out: list[Effect] = []
    for one in effects:
        near = policy.SAME_STEPS * one.family.steps(base, one)
        if not any(one.choice is other.choice and np.all(np.abs(one.values - other.values) < near) for other in out):
            out.append(one)
    return out


def _shaped(ears, model: Model, number: int, unknown: dict, budget: Budget) -> Model:
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
    barred = Barred()
    found: list[Model] = []
    while True:
        model, tried = _explored(ears, model, unknown, budget, others, barred, progress)
        refused = foretold.refused(vault, model)
        if refused and (other := _otherwise(ears, vault, model, refused[0], unknown, others, budget)):
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
        model = max([*found, model], key=lambda one: evidence(one, count, tried) - evaluated(vault, base, one.effects).energy)
    spent = budget.is_spent
    budget = Budget.of(policy.RIVALS_SHARE * budget_s)
    others = _open(_with_images(ears, model, _with_kin(model, others), unknown, budget), barred, model)
    tracks = [one for one in (*itertools.chain(*others.values()), *model.effects) if one.family.has_ways]
    ways = {track.key: [one for one in tracks if one.key == track.key] for track in tracks}
    known = {effect.key for effect in model.effects}
    model, rivals = exchanged(ears, model, others, count, tried, budget, vault)
    model = pruned(ears, model, count, tried)  # what one of its kinds explains better, another need not explain any more
    for number in foretold.refused(vault, model):  # what came in another's place for what is open of its numbers
        key, before = model.effects[number].key, model.energy
        if key not in known and not budget.is_spent:
            model = _in_its_well(ears, vault, model, number, unknown, others, budget)
            rivals[key] = [(one, nats + before - model.energy) for one, nats in rivals.get(key, ())]
    return Found(model=model, start=start, rivals=rivals, tried=tried, count=count, spent=spent, ways=ways)


def _barring(ears, model: Model, numbers: list[int], barred: Barred) -> Model:
    """The model without effects, which are not looked for again where no more than the rest is known."""
    less = _as_strong(ears, fitted(ears, without_effects(ears, model, numbers)))
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
        model = _beside(ears, vault, model, number, most)
        model = _in_its_well(ears, vault, model, number, unknown, others, budget)
    while len(model.effects) < policy.MOST_EFFECTS and not budget.is_spent:
        if _is_foretold(ears, vault, model, unknown, count):
            break
        found, tried = candidates(ears, model, unknown, budget, barred)
        least = max(policy.LEAST_EVIDENCE_NATS, model.slack, _beside_fields(model))
        paying = [one for one in found if worth(one, model, count, tried) > least and not foretold.refused(vault, one)]
        paying = [one for one in paying if not _at_once(ears, one, model)]
        before = evaluated(vault, model.base, model.effects)
        told = {id(one): before.energy - evaluated(vault, one.base, one.effects).energy for one in paying}
        best = max(paying, key=lambda one: told[id(one)], default=None)
        least = max(least, policy.CONFIRMED_SHARE * before.left_nats(sum(ear.count for ear in vault)))
        if best is None or told[id(best)] < least:
            break
        others[best.effects[-1].key] = [one.effects[-1] for one in found if one is not best]
        model = _as_strong(ears, best)
    return model


def _explored(ears, model: Model, unknown: dict, budget: Budget, others: dict, barred: Barred, progress) -> tuple[Model, int]:
    """The best model with effects, and how many were tried for the last: where going on with the best each time does not end at
    noise, or with a random field, what came close to one of the best is gone on with instead, the closest first."""
    count = sum(ear.count for ear in ears)
    open_: list[tuple[float, Model]] = []
    expanded: dict = {}
    best, tried = _grown(ears, model, unknown, budget, others, barred, open_, expanded, progress)
    while open_ and not budget.is_spent and not _is_told(best, count):
        open_.sort(key=lambda pair: pair[0])
        other = open_.pop(0)[1]
        if _has_shape(other):  # which may have had to wait
            other = _settled(ears, other, unknown, budget)
        other, tried = _grown(ears, other, unknown, budget, others, barred, open_, expanded, progress)
        best = max(best, other, key=lambda one: evidence(one, count, tried))
    return best, tried


def _by_shape(ears, model: Model) -> float:
    """Nats that effects explain whose shape is known in part alone."""
    numbers = [number for number, effect in enumerate(model.effects) if effect.family.shape_axes]
    return without_effects(ears, model, numbers).energy - model.energy if numbers else 0.0


def _is_told(model: Model, count: float) -> bool:
    """Whether a model leaves nothing, and no random field takes part in that: those explain much that they are not."""
    return model.deviations(count) < policy.CLEAN_DEVIATIONS and not any(one.family.is_flexible for one in model.effects)


def _grown(
    ears, model: Model, unknown: dict, budget: Budget, others: dict, barred: Barred, open_: list, expanded: dict, progress
) -> tuple[Model, int]:
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
        found, tried = candidates(ears, model, unknown, budget, barred)
        unshaped = policy.SHAPE_SHARE * _by_shape(ears, model)
        worths = {id(one): worth(one, model, count, tried) for one in found}
        least = max(policy.LEAST_EVIDENCE_NATS, model.slack, unshaped)
        beside = {id(one): max(least, _beside_rough(model, one), _beside_edges(one)) for one in found}
        paying = [one for one in found if worths[id(one)] >= beside[id(one)] and not _at_once(ears, one, model)]
        if not paying:
            model, before = _looked_for_anew(ears, model, unknown, budget, tried, others), model
            if model is before:
                break
            continue
        hidden = [
            one
            for one in elsewhere.instead(ears, model, budget)
            if not barred.bars(one.effects[-1].key, {effect.key for effect in one.effects[:-1]})
            and not _at_once(ears, one, model)
        ]
        worths |= {id(one): worth(one, model, count, tried) for one in hidden}
        found, paying = (sorted([*some, *hidden], key=lambda one: -worths[id(one)]) for some in (found, paying))
        good = _good_stiff(paying, worths, model, count)
        best = _stiff_first(paying, good, model, count)
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
        model = pruned(ears, best, count, tried)
        before = model
        for number in range(len(model.effects) - 1):  # what was found before fits what is known now
            model = _shaped(ears, model, number, unknown, budget)
            if model.deviations(count) > policy.QUIET_DEVIATIONS and not budget.is_spent:
                model = _begun_anew(ears, model, number)
        if model.effects:
            model = _seen_again(ears, model, len(model.effects) - 1, unknown, budget, others)
        model = _as_strong(ears, model)
        if model is not before:
            model = pruned(ears, model, count, tried)
        model = _asked_again(ears, model, count, tried, others, budget, barred)
    return model, tried


def _looked_for_anew(ears, model: Model, unknown: dict, budget: Budget, tried: float, others: dict) -> Model:
    """The model with one of its effects looked for anew beside all others, where something is left and that explains more of it:
    what was found first was found while the others hid part of it."""
    count = sum(ear.count for ear in ears)
    for number, own in enumerate(model.effects):
        if budget.is_spent or model.deviations(count) < policy.CLEAN_DEVIATIONS:
            break
        seen = _seen_again(ears, model, number, unknown, budget, others) if number < len(model.effects) - 1 else model
        if model.energy - seen.energy > policy.LEAST_EVIDENCE_NATS:  # the last one was seen again when it was found
            return pruned(ears, seen, count, tried)
        if len(model.effects) < 2 or not len(own.values):
            continue
        view = View(ears, fitted(ears, without_effects(ears, model, [number]), rounds=4), unknown)
        heard, here, _ = _overheard(view)
        screened = sorted(_screened(view, heard, here, own.family, own.owner), key=lambda one: one.tempered)
        wells: dict[tuple, list[Model]] = {}
        near = [_by_all(ears, view.model, screened, one, wells) for one in screened[: policy.FITTED_PER_FAMILY]]
        settled = [_settled(ears, one, unknown, budget) for one in near]
        best = min(settled, key=lambda one: one.tempered, default=model)
        if worth(best, model, count, tried) > policy.SHAPE_NATS:
            return pruned(ears, best, count, tried)
    return model


def _asked_again(ears, model: Model, count: float, tried: float, others: dict, budget: Budget, barred: Barred) -> Model:
    """The model with what came close to an earlier effect in its place, where that is better now: what one link alone lost is its
    node's once another of this node's links loses as much."""
    for number in range(len(model.effects) - 1):
        own, keys = model.effects[number], {effect.key for effect in model.effects}
        found = others.get(own.key, ())
        close = [one for one in found if (one.key not in keys or _may_recur(one.family)) and not one.family.is_flexible]
        close = [one for one in close if not barred.bars(one.key, keys - {own.key})]
        for other in close[: 0 if budget.is_spent else policy.ASKED_AGAIN]:
            trial = pruned(ears, fitted(ears, replaced(ears, model, number, other), rounds=4), count, tried)
            if worth(trial, model, count, tried) > policy.SHAPE_NATS:
                others.setdefault(other.key, [own, *(one for one in close if one is not other)])
                return _asked_again(ears, trial, count, tried, others, budget, barred)
    return model


def _stiff_first(paying: list[Model], good: Model | None, model: Model, count: float) -> Model:
    """The candidate to go on with: the best, but something stiff that explains a `good` part before random fields and what has a
    shape to choose, which explain much that they are not, unless they leave nothing where it leaves the most: then little is left
    to look for."""
    best = paying[0]
    if not good or good is best:
        return best
    return best if not _explains_most(good, model, count) and best.deviations(count) < policy.CLEAN_DEVIATIONS else good


def _has_shape(model: Model | _Guess) -> bool:
    return model.effects[-1].family.shape_axes > 0


def _is_plain(model: Model) -> bool:
    """Whether the last effect is no random field and has no shape."""
    return not model.effects[-1].family.is_flexible and not _has_shape(model)


def _explains_most(one: Model, model: Model, count: float) -> bool:
    return model.energy - one.energy >= policy.MOST_SHARE * (model.energy - model.offset - count)


def _good_stiff(paying: list[Model], worths: dict, model: Model, count: float) -> Model | None:
    """The best that is no random field, if it explains a good part of what is left, or else the best that explains the most of
    it; of what has a shape and what has none the latter, if it explains the most of that or hardly less than the other. None of
    which is worth little beside a random field: then that hides the rest."""
    here = model.energy - model.offset - count
    stiff = [one for one in paying if not one.effects[-1].family.is_flexible]
    good, plain = stiff[0] if stiff else None, next((one for one in paying if _is_plain(one)), None)
    if plain and good is not plain:
        told, other = model.energy - plain.energy, model.energy - good.energy
        good = plain if told >= min(policy.MOST_SHARE * here, (1 - policy.CLOSE_REGRET) * other) else good
    if good and model.energy - good.energy <= policy.STIFF_SHARE * here:
        good = next((one for one in stiff if _explains_most(one, model, count)), None)
    is_behind = good and worths[id(good)] < policy.STIFF_SHARE * worths[id(paying[0])]
    return None if is_behind and paying[0].effects[-1].family.is_flexible else good


def _otherwise(
    ears, vault: Sequence[Ear], model: Model, number: int, unknown: dict, others: dict, budget: Budget
) -> Model | None:
    """The model with another fit of a refused effect that explains the soundings as well and is not refused: the same wall, as
    small as they leave it, or another, elsewhere, or the same in another well of its phase, next to it or wherever what else is
    known leaves one, or beside where it is as far as they do not tell."""

    def begun():
        yield from [one] if (one := _pared(ears, model, number, unknown)) is not model else []
        yield from (*_kinds(ears, model, number, others), *_restarted(ears, model, number, policy.WELLS))
        if not budget.is_spent:
            yield from _lowest(_begun_beside(ears, model, number, unknown))

    for one in begun():
        other = fitted(ears, one, rounds=4)
        if other.energy < model.energy + policy.RIVAL_NATS and number not in foretold.refused(vault, other):
            return other
    other = _beside(ears, vault, model, number, model.energy + policy.RIVAL_NATS)
    return other if number not in foretold.refused(vault, other) else None


def _beside(ears, vault: Sequence[Ear], model: Model, number: int, most: float) -> Model:
    """The model with an effect beside where it is, of all places that leave at `most` so much energy the one that predicts the
    vault best."""
    own = model.effects[number]
    beside = [replaced(ears, model, number, one) for one in own.family.beside(model.base, own)]
    open_ = [model, *(one for one in beside if one.energy < most)]
    return min(open_, key=lambda one: evaluated(vault, one.base, one.effects).energy)


def _in_its_well(ears, vault: Sequence[Ear], model: Model, number: int, unknown: dict, others: dict, budget: Budget) -> Model:
    """The model with an effect in that well of its phase which predicts the vault best, of all that explain the soundings alike:
    wells are looked for from the lowest that is known, next to next."""
    fits, expanded, own = [model], set(), model.effects[number]
    if not own.family.lasts:
        return model
    begun = [*_kinds(ears, model, number, others), *_begun_beside(ears, model, number, unknown)]
    for _ in range(policy.RESHAPED):
        fits += [fitted(ears, one, rounds=4) for one in _lowest(begun)]
        apart = _distinct(model.base, [one.effects[number] for one in sorted(fits, key=lambda one: one.energy)])
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


def _kinds(ears, model: Model, number: int, others: dict) -> list[Model]:
    """The model with each other fit of one family and owner that came close to an effect."""
    key = model.effects[number].key
    return [replaced(ears, model, number, one) for one in others.get(key, ()) if one.key == key]


def wells(ears, vault: Sequence[Ear], model: Model, number: int) -> list[tuple[float, np.ndarray]]:
    """(nats behind, numbers) of an effect in the other wells of its phase that the soundings leave open and the vault does not
    refuse."""
    own = model.effects[number]
    tried = _refitted(ears, model, number, policy.WELLS)
    open_ = [
        one
        for one in tried
        if one.effects[number].choice is own.choice
        and one.energy - model.energy < policy.RIVAL_NATS
        and number not in foretold.refused(vault, one)
    ]
    apart = _distinct(model.base, [own, *(one.effects[number] for one in open_)])[1:]
    rows = [(one.energy - model.energy, one.effects[number]) for one in open_]
    return [(max(behind, 0.0), effect.values) for behind, effect in rows if effect in apart]


def is_one_of_many(ears, found: Found, number: int) -> bool:
    """Whether another way than an effect's explains nearly as much: then a third, which nobody found, may be the one."""
    model, own, span_s = found.model, found.model.effects[number], _span_s(ears)
    others = [fitted(ears, replaced(ears, model, number, one), rounds=4) for one in found.ways.get(own.key, ())]
    return any(
        one.energy < model.energy + policy.WAY_NATS and not own.family.is_same_way(model.base, own, one.effects[number], span_s)
        for one in others
    )


def _open(others: dict, barred: Barred, model: Model) -> dict:
    """What came close to each effect, without what the vault refused and the model has not."""
    have = {effect.key for effect in model.effects}
    return {key: [one for one in found if one.key not in barred.beside or one.key in have] for key, found in others.items()}


def _with_kin(model: Model, others: dict) -> dict:
    """What came close to each effect, and the same of all of its owner's material, or of one of these things alone."""
    out = dict(others)
    for effect in model.effects:
        out[effect.key] = [*out.get(effect.key, ()), *effect.family.kin(model.base, effect)]
    return out


def _with_images(ears, model: Model, others: dict, unknown: dict, budget: Budget) -> dict:
    """What came close to each effect, and what moves mirror images as it does: another mirror, or a node."""
    out, have = dict(others), {effect.key for effect in model.effects}
    for number, effect in enumerate(model.effects):
        shift_m = effect.family.images_moved_m(effect)
        if shift_m is None or budget.is_spent:
            continue
        view = View(ears, without_effects(ears, model, [number]), unknown)
        same = [one for family in view.families for one in family.moving_images(view, shift_m) if one.key not in have]
        begun = sorted((replaced(ears, model, number, one) for one in same), key=lambda one: one.energy)[: 2 * policy.ASKED_AGAIN]
        fits = [fitted(ears, one, rounds=policy.SCREEN_ROUNDS, free=[number]) for one in begun]
        fits.sort(key=lambda one: one.energy)
        out[effect.key] = [*out.get(effect.key, ()), *(one.effects[number] for one in fits[: policy.ASKED_AGAIN])]
    return out


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
            trials += [] if _is_negligible(trial, number) else [trial]
        apart = {id(one): foreseen_nats(ears, vault, one, model, number, count) for one in trials}
        trials.sort(key=lambda one: apart[id(one)] - worth(one, model, count, tried))
        if trials and worth(trials[0], model, count, tried) - apart[id(trials[0])] > 1.0:
            trials[0], model = model, trials[0]
            apart = {id(one): foreseen_nats(ears, vault, one, model, number, count) for one in trials}
        own = model.effects[number]
        behind = [(one.effects[number], behind_nats(one, model, number, count) + apart[id(one)]) for one in trials]
        rivals[own.key] = sorted(behind, key=lambda pair: pair[1])
    return model, rivals


def _of_its_kinds(ears, vault: Sequence[Ear], model: Model, number: int, others: dict, count: float) -> Model:
    """The model with that fit of an effect which, of those that explain the soundings alike, predicts the vault best: a pattern
    of a node, or a wall, that the fitted soundings leave open."""
    for one in _kinds(ears, model, number, others):
        other = fitted(ears, one, rounds=4)
        if behind_nats(other, model, number, count) + foreseen_nats(ears, vault, other, model, number, count) < -1.0:
            model = other
    return model


def foreseen_nats(ears, vault: Sequence[Ear], rival: Model, model: Model, number: int, count: float) -> float:
    """By how much a rival that the fitted soundings leave open predicts the vault worse than the model; 0 of all others. Where
    one of both may have been there for once, the other one is likelier for what it explains of the vault, and not less for what
    it does not."""
    lasts, stays = rival.effects[number].family.lasts, model.effects[number].family.lasts
    most = 2 * policy.RIVAL_NATS + _beside_fields(model)
    if not vault or not (lasts or stays) or behind_nats(rival, model, number, count) > most:
        return 0.0
    nats = foretold.foreseen(ears, vault, rival) - foretold.foreseen(ears, vault, model)
    return nats if lasts and stays else min(nats, 0.0) if lasts else max(nats, 0.0)


def behind_nats(rival: Model, model: Model, number: int, count: float) -> float:
    """How far a rival of one effect is behind, by what the soundings say and one nat (Akaike) per number: that it is less simple
    does not rule it out. But that something moves wants to be shown: a way that fits what stands still is one of many."""
    one, other = rival.effects[number], model.effects[number]
    more = one.family.price_nats - other.family.price_nats
    each = 1.0 if one.family.lasts == other.family.lasts else number_price_nats(count)
    return rival.energy - model.energy + more + each * (one.family.told_numbers(one) - other.family.told_numbers(other))


def _beside_fields(model: Model) -> float:
    """Nats that any effect may gain from what few patches of a random field send alike."""
    return policy.BESIDE_ROUGH_NATS if any(effect.family.is_flexible for effect in model.effects) else 0.0


def _beside_rough(before: Model, one: Model) -> float:
    """Nats that any effect may gain so, or, where edges are heard, from edges that bend in no phase of the theory's: unless all
    bend as the theory has it with this effect, and did not without."""
    is_mended = before.loose[1] > 0 >= one.loose[1]
    return policy.BESIDE_ROUGH_NATS if any(before.loose) and not is_mended else _beside_fields(before)


def _at_once(ears, one: Model, before: Model) -> bool:
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


def _beside_edges(model: Model) -> float:
    """Nats that any effect may gain from edges that bend otherwise than the theory has it."""
    return policy.LOOSE_SHARE * model.loose[1]


def pruned(ears, model: Model, count: float, tried: float) -> Model:
    """Without effects that no longer pay, or are none to speak of."""
    number = 0
    while number < len(model.effects) > 1:
        less = fitted(ears, without_effects(ears, model, [number]), rounds=4)
        least = max(policy.LEAST_EVIDENCE_NATS / 2, model.slack, _beside_rough(less, model), _beside_edges(model))
        if _is_negligible(model, number) or evidence(less, count, tried) > evidence(model, count, tried) - least:
            model = less
        else:
            number += 1
    return model
