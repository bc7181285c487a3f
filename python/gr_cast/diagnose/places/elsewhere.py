# SPDX-License-Identifier: GPL-3.0-or-later
"""What seems to be new may be one more like an object of the twin, in its row, or an object that no link sees at its place and
that stands elsewhere; which of both, none tells."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...twin.places.families import FAMILIES
from ...twin.places.families.additions import MissingObject, Sheet, across
from ...twin.places.families.base import Effect
from ...twin.places.families.objects import ExtraObject, ObjectMoved
from ...twin.places.world import World
from . import policy
from .ears import thinned_as_fitted
from .fit import Model, applied, evaluated, fitted, shows_in, with_effect

_MOVED, _GONE, _NEW = (next(one for one in FAMILIES if type(one) is kind) for kind in (ObjectMoved, ExtraObject, MissingObject))
_SHIFTS_M = np.arange(0.25, 4.6, 0.25)  # of a face, either way, from its place
_APART_M = 0.5  # of an object from its place, beyond which it may be a second one
_WITHIN_M = 0.15  # around those that are best
_FURNITURE_M, _SQUARE_M, _LEVEL = 4.0, 1e-3, 0.5  # longest side of what there may be one more of; of corners beside a box; cosine
_LEAST = 1e-5  # of a conductivity, S/m
_ALIKE_NATS = 0.5
_TRIED, _BEST = 6, 3  # that are looked at finely, and that are fitted


def instead(ears: Sequence, model: Model, budget) -> list[Model]:
    """The model with one effect more, fitted: an object that nobody sees at its place, or one more like an object, where it
    explains most, or elsewhere where it explains much."""
    if not (thin := _telling(ears, model)):
        return []
    found = [*moves(thin, model, budget)[:_BEST], *copies(thin, model, budget)[:_BEST]]
    return [fitted(ears, with_effect(ears, model, one)) for one in found]


def moves(ears: Sequence, rest: Model, budget) -> list[Effect]:
    """Moves of hidden objects that explain most of what `rest` leaves, the best first."""
    here = evaluated(ears, rest.base, rest.effects)
    world = here.world

    def moved(owner: str, axis: np.ndarray, shift_m: float) -> Effect:
        return Effect(family=_MOVED, owner=owner, values=np.array([shift_m]), choice=tuple(axis))

    ways = [(owner, axis) for owner in hidden(here, ears) for axis in world.axes(world.mesh.index(owner))]
    return _placed(ears, here, ways, moved, budget)


def copies(ears: Sequence, rest: Model, budget) -> list[Effect]:
    """Objects like those of the twin, beside them along the directions of their sides, that explain most of what is left."""
    here = evaluated(ears, rest.base, rest.effects)
    world = here.world
    ways = [
        (solid.name, axis)
        for index, solid in enumerate(world.mesh.solids)
        for axis in world.axes(index)
        if solid.name in rest.base.mesh.names and abs(axis[2]) < _LEVEL and _is_furniture(solid.vertices_m, axis)
    ]

    def made(owner: str, axis: np.ndarray, shift_m: float) -> Effect:
        index, surface = world.mesh.index(owner), world.surface
        corners_m = world.mesh.solids[index].vertices_m + shift_m * axis
        made = [max(surface.permittivity[index], 1.0), max(surface.conductivity[index], _LEAST)]
        sheet = Sheet.about(corners_m, axis, float(surface.thickness_m[index]))
        return Effect(family=_NEW, owner="place", values=np.array([0.0, 0.0, *np.log(made)]), choice=sheet)

    return _placed(ears, here, ways, made, budget)


def _placed(ears: Sequence, here: Model, ways: list[tuple[str, np.ndarray]], make, budget) -> list[Effect]:
    """Of effects `make(owner, axis, shift_m)` those that explain most, the best of each way (owner, axis) and place first."""
    world, fine_m = here.world, here.world.wavelength_m / 8
    coarse = []
    for way in ways:
        for shift_m in (*_SHIFTS_M, *-_SHIFTS_M):
            one = make(*way, shift_m)
            nats = 0.0 if budget.is_spent else _shown(ears, here, one.family.apply(world, one))
            coarse += [(nats, shift_m, way)] if nats > policy.LEAST_EVIDENCE_NATS else []
    best = []
    for _, shift_m, way in sorted(coarse, key=lambda row: -row[0])[:_TRIED]:
        near_m = [] if budget.is_spent else shift_m + np.arange(-_WITHIN_M, _WITHIN_M, fine_m)
        fine = [(with_effect(ears, here, one := make(*way, m)).energy, m, one) for m in near_m]
        least = min((energy for energy, *_ in fine), default=0.0)
        if alike := [row for row in fine if row[0] - least < _ALIKE_NATS]:  # what no path tells apart: its middle
            energy, middle_m, one = alike[len(alike) // 2]
            best.append((energy, middle_m, way, one))
    out: list[tuple] = []
    for _, shift_m, way, one in sorted(best, key=lambda row: row[0]):
        if not any(way is other and abs(shift_m - known_m) < fine_m for other, known_m, _ in out):
            out.append((way, shift_m, one))
    return [one for *_, one in out]


def _is_furniture(corners_m: np.ndarray, normal: np.ndarray) -> bool:
    """Whether corners are a small board's or box's, with sides that face along and across a direction."""
    at_m = corners_m @ np.stack([normal, *across(normal)], axis=1)
    low_m, high_m = at_m.min(axis=0), at_m.max(axis=0)
    return bool((high_m - low_m).max() < _FURNITURE_M and np.minimum(at_m - low_m, high_m - at_m).max() < _SQUARE_M)


def _telling(ears: Sequence, rest: Model) -> list:
    """Responses, thinned where what is left shows in a part of them just as well."""
    whole, thin = ([ear for ear in some if ear.has_responses] for some in (ears, thinned_as_fitted(ears, rest.fits)))
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
    if (offset_m < _APART_M).all():  # nobody puts two things up so near to each other
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
