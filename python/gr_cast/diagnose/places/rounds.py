# SPDX-License-Identifier: GPL-3.0-or-later
"""Rounds of a search: candidates for one effect more, screened, and the best of them fitted with all found before."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from ...twin.places.families.base import Effect
from ...twin.places.world import World
from . import policy, settling, weighing
from .budget import Budget
from .ears import holding, thinned_as_fitted
from .fit import Ear, Model, evaluated, fitted, replaced, shows_in, with_effect
from .view import View


@dataclass(frozen=True, kw_only=True)
class Barred:
    """What the vault refused, by what it was refused `beside`: where more is known, it may be looked for again. What is refused
    twice beside the same is refused for good (None). And the `rounds` that were made since, which need not be made again, and
    what was looked at for any of them, which holds on: what is barred then stays so. `briefly`: keys of effects that were found
    in rounds where nothing wide was looked at."""

    beside: dict[tuple, list[frozenset | None]] = field(default_factory=dict)
    rounds: dict[tuple, tuple] = field(default_factory=dict)
    looks: dict[tuple, "Look"] = field(default_factory=dict)
    briefly: set[tuple] = field(default_factory=set)

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


@dataclass(frozen=True, eq=False, kw_only=True)
class Guess:
    """A candidate as it was screened: its effects, the last one new; nats that all soundings promise for it."""

    effects: tuple[Effect, ...]
    energy: float
    promise: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Screen:
    """On what candidates are screened: `heard`, the model `here`, how much `more` the whole says, and models with an effect in
    another well."""

    view: View
    heard: Sequence[Ear]
    here: Model
    more: float
    others: Sequence[Model]

    @classmethod
    def of(cls, view: View, budget: Budget) -> "Screen":
        heard, here, more = overheard(view)
        others = [] if budget.is_spent else _in_open_wells(heard, here, more)
        return cls(view=view, heard=heard, here=here, more=more, others=others)


@dataclass(eq=False, kw_only=True)
class Look:
    """What one model's round looked at: what it was screened on; the keys that were tried; guesses by whether their families are
    wide, where all of these were screened; wells by key; by guess, the effects from which it is fitted; by guess, and whether it
    had to wait, those to which it was, None where these are nothing to speak of."""

    screen: "Screen"
    tried: set[tuple] = field(default_factory=set)
    guesses: dict[bool, list[Guess]] = field(default_factory=dict)
    wells: dict[tuple, list[tuple[Effect, ...]]] = field(default_factory=dict)
    begun: dict[Guess, tuple[Effect, ...]] = field(default_factory=dict)
    fits: dict[tuple[Guess, bool], tuple[Effect, ...] | None] = field(default_factory=dict)


def candidates(ears: Sequence[Ear], model: Model, unknown: dict, budget: Budget, barred: Barred) -> tuple[list[Model], int]:
    """Models with one effect more, fitted, the best evidence first; and how many were tried. None where time ran out before all
    had been looked at: the best of a few is no answer."""
    return _once(_round, ears, model, unknown, budget, barred)


def brief(ears: Sequence[Ear], model: Model, unknown: dict, budget: Budget, barred: Barred) -> tuple[list[Model], int] | None:
    """The same of narrow families alone, where one of these explains most of what is left; None elsewhere."""
    return _once(_brief_round, ears, model, unknown, budget, barred)


def _once(make, ears, model: Model, unknown: dict, budget: Budget, barred: Barred):
    key = make, _of_round(model)
    if key not in barred.rounds:
        made = make(ears, model, unknown, budget, barred)
        if budget.is_spent:
            return made
        barred.rounds[key] = made
    return barred.rounds[key]


def _of_round(model: Model) -> tuple:
    return frozenset(effect.key for effect in model.effects), model.energy


def was_brief(model: Model, barred: Barred) -> bool:
    """Whether nothing wide was looked at in a model's round."""
    look = barred.looks.get(_of_round(model))
    return look is not None and True not in look.guesses


def wide_guesses(ears: Sequence[Ear], model: Model, unknown: dict, budget: Budget) -> list[Guess]:
    """Candidates of wide families alone, the most promising first; none where time ran out before all had been screened."""
    look = Look(screen=Screen.of(View(ears, model, unknown), budget))
    _look(look, Barred(), budget, wide=True)
    return sorted(look.guesses.get(True, ()), key=lambda one: one.promise, reverse=True)


def _round(ears: Sequence[Ear], model: Model, unknown: dict, budget: Budget, barred: Barred) -> tuple[list[Model], int]:
    look = _looked(ears, model, unknown, budget, barred)
    if True not in look.guesses:
        _look(look, barred, budget, wide=True)
    return _best_fitted(ears, model, look, unknown, budget, barred) if len(look.guesses) == 2 else ([], len(look.tried))


def _brief_round(ears, model: Model, unknown: dict, budget: Budget, barred: Barred) -> tuple[list[Model], int] | None:
    look = _looked(ears, model, unknown, budget, barred)
    if True in look.guesses or not _promises_most(look, model, barred):
        return None
    made = _best_fitted(ears, model, look, unknown, budget, barred)
    return made if any(weighing.tells_most(one, model, sum(ear.count for ear in ears)) for one in made[0]) else None


def _looked(ears, model: Model, unknown: dict, budget: Budget, barred: Barred) -> Look:
    """What is narrow, looked at for a model."""
    key = _of_round(model)
    if key not in barred.looks:
        barred.looks[key] = Look(screen=Screen.of(View(ears, model, unknown), budget))
    if False not in barred.looks[key].guesses:
        _look(barred.looks[key], barred, budget, wide=False)
    return barred.looks[key]


def _promises_most(look: Look, model: Model, barred: Barred) -> bool:
    """Whether something narrow that is not barred explains most of what is left above noise of what it was screened on."""
    have, here = {effect.key for effect in model.effects}, look.screen.here
    count = sum(ear.count for ear in look.screen.heard)
    return any(
        weighing.tells_most(one, here, count) and not barred.bars(one.effects[-1].key, have)
        for one in look.guesses.get(False, ())
    )


def _best_fitted(
    ears: Sequence[Ear], model: Model, look: Look, unknown: dict, budget: Budget, barred: Barred
) -> tuple[list[Model], int]:
    """The most promising of what was looked at, fitted, and how many were tried."""
    have, count, span_s = {effect.key for effect in model.effects}, sum(ear.count for ear in ears), settling.span_s(ears)
    all_ = sorted((one for some in look.guesses.values() for one in some), key=lambda one: one.promise, reverse=True)
    guesses = [one for one in all_ if not barred.bars(one.effects[-1].key, have)]
    tried = sum(not barred.bars(key, have) for key in look.tried)
    chosen, crowd = [], {}
    for one in guesses:
        name = one.effects[-1].family.name
        is_known = any(_is_again(model.base, one, other, span_s) for other in chosen)
        if crowd.get(name, 0) < policy.FITTED_PER_FAMILY and len(chosen) < policy.FITTED_AFTER_SCREEN and not is_known:
            crowd[name] = crowd.get(name, 0) + 1
            chosen.append(one)
    final: list[Model] = []
    chosen.sort(key=weighing.has_shape)  # what has a shape takes long, and may have to wait for what has none
    for one in chosen:
        best = max((weighing.worth(done, model, count, tried) for done in final), default=-math.inf)
        is_far_behind = one.promise < policy.BEHIND_SHARE * best
        is_told = any(weighing.is_plain(done) and weighing.explains_most(done, model, count) for done in final)
        is_hopeless = is_told and weighing.has_shape(one)
        waits = is_far_behind or is_hopeless
        if (one, waits) in look.fits:
            effects = look.fits[one, waits]
            final += [evaluated(ears, model.base, effects)] if effects else []
            continue
        if one not in look.begun:
            is_part = look.screen.more > 1
            look.begun[one] = by_all(ears, model, all_, one, look.wells).effects if is_part else one.effects
        begun = evaluated(ears, model.base, look.begun[one])
        fit = fitted(ears, begun, rounds=policy.SCREEN_ROUNDS) if waits else settling.settled(ears, begun, unknown, budget)
        stands = _stands_out(ears, fit, count, tried)
        final += [fit] if stands else []
        if not budget.is_spent:
            look.fits[one, waits] = fit.effects if stands else None
    return sorted(final, key=lambda one: -weighing.worth(one, model, count, tried)), tried


def _look(look: Look, barred: Barred, budget: Budget, *, wide: bool) -> None:
    """All candidates of narrow or of wide families, screened; nothing where time ran out before all had been."""
    view, heard, here, more = look.screen.view, look.screen.heard, look.screen.here, look.screen.more
    have, count = {effect.key for effect in view.model.effects}, sum(ear.count for ear in view.ears)
    guesses = []
    for family in view.families:
        for owner in family.owners(view) if family.is_wide == wide else ():
            key = family.name, owner
            if barred.bars(key, have) or key in have and not may_recur(family):
                continue
            if budget.is_spent:
                return
            look.tried.add(key)
            for one in screened(view, heard, here, family, owner, look.screen.others):
                gain = here.tempered - one.tempered - weighing.freedom(one, here)
                promise = more * gain - weighing.numbers_price_nats(one.effects[-1], count)
                guesses.append(Guess(effects=one.effects, energy=one.energy, promise=promise))
    look.guesses[wide] = guesses


def _in_open_wells(heard: Sequence[Ear], here: Model, more: float) -> list[Model]:
    """A model with one of its effects in another well of its phase, which the soundings leave open: what is looked for beside the
    wrong one may not be found."""
    heard, out = holding(heard, here.world), []
    for number, own in enumerate(here.effects):
        if own.family.shape_axes or own.family.is_flexible:
            continue
        fits = settling.refitted(heard, here, number, policy.FULL_STARTS)
        near = [one for one in fits if more * abs(one.energy - here.energy) < policy.RIVAL_NATS]  # no part's own deepest
        near.sort(key=lambda one: one.energy)
        apart = settling.distinct(here.base, [own, *(one.effects[number] for one in near)])[1:]
        out += [one for one in near if one.effects[number] in apart]
    return sorted(out, key=lambda one: one.energy)[: policy.OPEN_WELLS]


def by_all(ears, model: Model, guesses: Sequence[Model | Guess], one: Model | Guess, wells: dict) -> Model:
    """What was chosen on a part of the soundings, on all of them: of a family whose wells only a fit tells apart, the best that
    is left of its key in `wells`, for a part may hold the wrong well of a phase for the deepest."""
    effect = one.effects[-1]
    if effect.family.ranks_unfitted or effect.family.shape_axes:
        return evaluated(ears, model.base, one.effects)
    if effect.key not in wells:
        begun = [other.effects for other in guesses if other.effects[-1].key == effect.key][: policy.WELLS]
        fits = sorted(
            (settling.quick(ears, evaluated(ears, model.base, effects)) for effects in begun), key=lambda fit: fit.tempered
        )
        apart = {id(own) for own in settling.distinct(model.base, [fit.effects[-1] for fit in fits])}
        wells[effect.key] = [fit.effects for fit in fits if id(fit.effects[-1]) in apart]
    return evaluated(ears, model.base, wells[effect.key].pop(0) if wells[effect.key] else one.effects)


def _is_again(base: World, one: Guess, other: Guess, span_s: tuple[float, float]) -> bool:
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


def may_recur(family) -> bool:
    """Whether one owner may have several: a place is where all that nobody drew is."""
    return family.level == "place"


def _stands_out(ears, model: Model, count: float, tried: float) -> bool:
    """Whether the last effect is one to speak of, and explains more than the same without what sets its family apart."""
    if weighing.is_negligible(model, -1):
        return False
    last = len(model.effects) - 1
    others = model.effects[last].family.plainer(settling.span_s(ears), model.effects[last])
    plain = (fitted(ears, replaced(ears, model, last, one), free=[last]) for one in others)
    least = weighing.evidence(model, count, tried) - policy.LEAST_EVIDENCE_NATS
    return all(weighing.evidence(one, count, tried) < least for one in plain)


def screened(view: View, heard: Sequence[Ear], here: Model, family, owner: str, others: Sequence[Model] = ()) -> list[Model]:
    """Models with one effect more, from the most promising of its family's first guesses, the best one beside the best of
    `others`, in which something is in another well; none of them but a random field changes what is scattered, yet."""
    starts = family.starts(view, owner)
    heard = heard if family.is_flexible else holding(heard, here.world)
    if len(starts) > policy.FULL_STARTS and family.ranks_unfitted:
        starts = list({id(one): one for one in (*view.ranked(starts)[: policy.FULL_STARTS], starts[0])}.values())
    alone = sorted((settling.quick(heard, with_effect(heard, here, start)) for start in starts), key=lambda one: one.tempered)
    if not here.effects or not alone:
        return alone
    best, rest = alone[: policy.FITTED_PER_FAMILY], alone[policy.FITTED_PER_FAMILY :]
    # What was found before has taken some of what is another's for its own.
    free = [n for n, effect in enumerate(best[0].effects) if family.is_flexible or not effect.family.is_flexible]
    fits = [fitted(heard, one, rounds=policy.SCREEN_ROUNDS, free=free) for one in best]
    if not family.shape_axes:
        beside = (settling.quick(heard, with_effect(heard, other, best[0].effects[-1])) for other in others)
        beside = [fitted(heard, one, rounds=policy.SCREEN_ROUNDS, free=free) for one in beside]
        fits[0] = min([fits[0], *beside], key=lambda one: one.tempered)
    return fits + rest


def overheard(view: View) -> tuple[Sequence[Ear], Model, float]:
    """What candidates are screened on: the soundings, thinned where what is left shows in a part of them just as well; the
    model there, and how much more the whole says."""
    parts = (thinned_as_fitted(view.ears, view.model.fits, times) for times in policy.SCREENED_TIMES)
    thin = next((part for part in parts if shows_in(part, view.ears, view.model)), None)
    if thin is None:
        return view.ears, view.model, 1.0
    count, part = (sum(ear.count for ear in ears) for ears in (view.ears, thin))
    here = fitted(thin, evaluated(thin, view.model.base, view.model.effects), rounds=policy.SCREEN_ROUNDS)
    return thin, here, count / max(part, 1)
