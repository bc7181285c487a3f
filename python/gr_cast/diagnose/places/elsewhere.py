# SPDX-License-Identifier: GPL-3.0-or-later
"""What seems to be new may be an object that no link sees at its place and that stands elsewhere; which of both, none tells."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...twin.places.families.base import Effect
from ...twin.places.families.objects import ExtraObject, ObjectMoved
from ...twin.places.world import World
from . import policy
from .ears import thinned
from .fit import Model, applied, evaluated, fitted, shows_in, with_effect

_MOVED, _GONE = ObjectMoved(), ExtraObject()
_SHIFTS_M = np.arange(0.25, 4.6, 0.25)  # of a face, either way, from its place
_WITHIN_M = 0.15  # around those that are best
_TRIED, _BEST = 6, 3  # that are looked at finely, and that are fitted


def instead(ears: Sequence, model: Model, budget) -> list[Model]:
    """The model with one effect more, fitted: an object that nobody sees at its place stands where it explains most, or
    elsewhere where it explains much."""
    return [fitted(ears, with_effect(ears, model, one)) for one in moves(ears, model, budget)[:_BEST]]


def moves(ears: Sequence, rest: Model, budget) -> list[Effect]:
    """Moves of hidden objects that explain most of what `rest` leaves, the best first."""
    if not (thin := _telling(ears, rest)):
        return []
    here = evaluated(thin, rest.base, rest.effects)
    world = here.world

    def at(owner: str, axis: np.ndarray, shifts_m) -> list[Effect]:
        return [Effect(family=_MOVED, owner=owner, values=np.array([m]), choice=tuple(axis)) for m in shifts_m]

    coarse = []
    for owner in hidden(here, thin):
        for axis in world.axes(world.mesh.index(owner)):
            for one in at(owner, axis, [*_SHIFTS_M, *-_SHIFTS_M]):
                nats = 0.0 if budget.is_spent else _shown(thin, here, _MOVED.apply(world, one))
                coarse += [(-nats, one)] if nats > policy.LEAST_EVIDENCE_NATS else []
    best = []
    for _, one in sorted(coarse, key=lambda row: row[0])[:_TRIED]:
        near = at(one.owner, np.array(one.choice), one.values[0] + np.arange(-_WITHIN_M, _WITHIN_M, world.wavelength_m / 8))
        fine = [] if budget.is_spent else [(with_effect(thin, here, other).energy, other) for other in near]
        best += sorted(fine, key=lambda row: row[0])[:1]
    out: list[Effect] = []
    for _, one in sorted(best, key=lambda row: row[0]):
        known = [other.values[0] for other in out if (other.owner, other.choice) == (one.owner, one.choice)]
        if not any(abs(one.values[0] - shift_m) < world.wavelength_m / 8 for shift_m in known):
            out.append(one)
    return out


def _telling(ears: Sequence, rest: Model) -> list:
    """Responses, thinned where what is left shows in a part of them just as well."""
    whole = [ear for ear in ears if ear.has_responses]
    thin = [thinned(ear, policy.THIN_INSTANTS, policy.THIN_FREQUENCIES) for ear in whole]
    return thin if shows_in(thin, ears, rest) else whole


def _shown(ears: Sequence, here: Model, other: World) -> float:
    """Nats by which the change to another world explains the residual where each response may turn and scale it: an echo's phase
    goes round with every wavelength, its delay does not."""
    total = 0.0
    for ear, fit in zip(ears, here.fits, strict=True):
        change = (ear.predictor.response(other) - ear.predictor.response(here.world)) * fit.factor
        power = (np.abs(change) ** 2 * ear.heard.weight).sum(axis=2)
        cross = np.abs((change.conj() * fit.residual * ear.heard.weight).sum(axis=2)) ** 2
        total += float((cross / np.maximum(power, 1e-300) - 1)[power > 1].sum())
    return total


def hidden(here: Model, ears: Sequence) -> list[str]:
    """Objects of the mesh without which the soundings would be as they are."""
    moved = {effect.owner for effect in here.effects}
    return [name for name in here.base.mesh.names if name not in moved and _is_unseen(ears, here, name)]


def _is_unseen(ears: Sequence, here: Model, owner: str) -> bool:
    gone = with_effect(ears, here, Effect(family=_GONE, owner=owner, values=np.zeros(0)))
    return abs(gone.energy - here.energy) < 1e-6


def one_more(ears: Sequence, base: World, effects: Sequence, number: int) -> World | None:
    """The world where an object that was found elsewhere is a new one, and the old one is at its place; None of other effects.
    An object that was seen at its place is not said to hide in a new one around it; of one that never was, nothing is known."""
    effect = effects[number]
    if not isinstance(effect.family, ObjectMoved) or effect.owner not in base.mesh.names:
        return None
    world, index = applied(base, effects), base.mesh.index(effect.owner)
    offset_m, size_m = np.abs(effect.values[0] * np.array(effect.choice)), np.ptp(base.mesh.solids[index].vertices_m, axis=0)
    if (offset_m < _SHIFTS_M[0]).all():  # a hand from its place
        return None
    rest = [one for one in effects if one is not effect]
    if (offset_m < size_m).all() and not _is_unseen(ears, evaluated(ears, base, rest), effect.owner):
        return None
    name = f"new_{effect.owner}"
    surface = {key: values[index] for key, values in world.surface.numbers.items()}
    stays = world.with_object(replace(base.mesh.solids[index], name=name), **surface)
    return replace(stays, media={**world.media, name: world.media[effect.owner]})


def apart_nats(ears: Sequence, world: World, other: World) -> float:
    """By which soundings are less likely in the other world."""
    first, second = (sum(ear.profiled(ear.predicted(one)).energy for ear in ears) for one in (world, other))
    return second - first
