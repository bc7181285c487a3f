# SPDX-License-Identifier: GPL-3.0-or-later
"""Where an added plane ends: of the paths that an endless one sends, lets through and blocks, those that meet it within its ends
are there, and those that cross it within them are not. So one trace tells of all ends."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...scenario.create.fields import are_unblocked
from ...scenario.create.images import Paths
from ...twin.places.families.base import Effect
from ...twin.places.predict import Table, phasors
from ...twin.places.world import World
from . import policy
from .ears import ResponseEar, evenly, thinned
from .fit import applied

_COARSE, _BEGUN = 7, 3  # places along an axis where all ends are tried together; of these, from which one end after the other is
_TRIED, _TURNS = 12, 4  # places of one end; turns of all four
_SAME_M = 1e-3  # of two places where paths meet the plane
_BEYOND_M = 0.5  # of the outermost
_WORTH_NATS, _SAME_NATS = 0.5, 0.01  # of a turn; of another end


@dataclass(frozen=True, eq=False, kw_only=True)
class _Heard:
    """One sounding beside an endless plane: `rest` (L, T, K) of what it has no part in; n paths that it has, by `row` of (L, T):
    what they send, `open` and `shut` (n, K), as they do not, and do, cross the plane; where they meet it (n, D, 2), NaN where
    they do not, and where they cross it."""

    ear: ResponseEar
    rest: np.ndarray
    row: np.ndarray
    open: np.ndarray
    shut: np.ndarray
    met_m: np.ndarray
    crossed_m: np.ndarray

    def response(self, low_m: np.ndarray, high_m: np.ndarray) -> np.ndarray:
        sent = np.isnan(self.met_m[..., 0]) | _within(self.met_m, low_m, high_m)
        through = _within(self.crossed_m, low_m, high_m).any(axis=1)
        parts = np.where(through[:, None], self.shut, self.open) * sent.all(axis=1)[:, None]
        out = np.zeros((self.rest.shape[0] * self.rest.shape[1], self.rest.shape[2]), complex)
        np.add.at(out, self.row, parts)
        return self.rest + out.reshape(self.rest.shape)

    def energy(self, low_m: np.ndarray, high_m: np.ndarray) -> float:
        fit = self.ear.profiled(self.response(low_m, high_m))
        return fit.energy - self.ear.tempered_nats(fit)


def _within(at_m: np.ndarray, low_m: np.ndarray, high_m: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return ((at_m > low_m) & (at_m < high_m)).all(axis=-1)


def ended(ears: Sequence, base: World, effects: Sequence[Effect], number: int, bounds_m) -> Effect:
    """An added plane with the ends that explain most, looked for everywhere within `bounds_m` of the place, then near the best
    one after the other."""
    effect = effects[number]
    whole = effect.choice.through(*bounds_m)
    here, endless = (
        applied(base, [*effects[:number], replace(effect, choice=one), *effects[number + 1 :]]) for one in (effect.choice, whole)
    )
    owner = endless.mesh.index(effect.family.called(sum(one.family is effect.family for one in effects[: number + 1])))
    heard = [
        _heard_beside(thinned(ear, len(ear.predictor.time_s), policy.THIN_FREQUENCIES), here, endless, owner, effect)
        for ear in ears
        if ear.has_responses
    ]
    at_m = np.concatenate([part.reshape(-1, 2) for one in heard for part in (one.met_m, one.crossed_m)])
    between = [_between(at_m[~np.isnan(at_m[:, 0]), axis]) for axis in (0, 1)]

    def energy(ends_m: np.ndarray) -> float:
        return sum(one.energy(*ends_m) for one in heard) if (ends_m[1] > ends_m[0]).all() else np.inf

    coarse = [itertools.combinations(one[evenly(len(one), _COARSE)], 2) for one in between]
    begun = sorted((np.array(pair).T for pair in itertools.product(*coarse)), key=energy)[:_BEGUN]
    ends_m, *others = (_settled(energy, one, between) for one in (np.array([effect.choice.low_m, effect.choice.high_m]), *begun))
    for other in others:  # where nothing is lit, it ends as it did
        ends_m = other if energy(other) < energy(ends_m) - _WORTH_NATS else ends_m
    return replace(effect, choice=replace(effect.choice, low_m=tuple(ends_m[0]), high_m=tuple(ends_m[1])))


def _settled(energy, ends_m: np.ndarray, between: list[np.ndarray]) -> np.ndarray:
    """Ends that explain most near some, one moved after the other."""
    for _ in range(_TURNS):
        before = ends_m
        for side in range(4):
            ends_m = _moved(energy, ends_m, divmod(side, 2), between)
        if energy(before) - energy(ends_m) < _WORTH_NATS:
            break
    return ends_m


def _between(along_m: np.ndarray) -> np.ndarray:
    """Places between any two neighbours of those where paths meet or cross a plane, and beyond them all."""
    if not len(along_m):
        return np.zeros(0)
    along_m = np.unique(along_m)
    along_m = along_m[np.concatenate([[True], np.diff(along_m) > _SAME_M])]
    return np.concatenate([[along_m[0] - _BEYOND_M], (along_m[1:] + along_m[:-1]) / 2, [along_m[-1] + _BEYOND_M]])


def _moved(energy, ends_m: np.ndarray, which: tuple[int, int], between: list[np.ndarray]) -> np.ndarray:
    """With one end, low or high along an axis, where it is best: coarsely, then between the neighbours of the best."""
    places_m = between[which[1]]
    among = np.arange(len(places_m))
    while len(among):
        step = max(1, len(among) // _TRIED)
        tried = among[evenly(len(among), _TRIED)]
        trials = [ends_m]
        for place_m in places_m[tried]:
            other = ends_m.copy()
            other[which] = place_m
            trials.append(other)
        energies = [energy(one) for one in trials]
        best = int(np.argmin(energies))
        if best and energies[best] < energies[0] - _SAME_NATS:
            ends_m = trials[best]
        if step == 1:
            break
        near = tried[int(np.argmin(energies[1:]))]
        among = among[np.abs(among - near) <= step]
    return ends_m


@dataclass(frozen=True, eq=False, kw_only=True)
class _Plane:
    """A plane's origin, normal, and the directions (3, 2) in which it has its ends."""

    origin_m: np.ndarray
    normal: np.ndarray
    across: np.ndarray

    @classmethod
    def of(cls, effect: Effect) -> "_Plane":
        origin_m, u, v = effect.choice.frame(*effect.values[:2])
        return cls(origin_m=origin_m, normal=effect.choice.normal_at(effect.values[1]), across=np.stack([u, v], axis=1))

    def at(self, points_m: np.ndarray) -> np.ndarray:
        return (points_m - self.origin_m) @ self.across

    def met_m(self, own: np.ndarray, table: Table) -> np.ndarray:
        """(n, D, 2) where paths meet it; NaN where they do not."""
        met = (table.paths.faces >= 0) & own[table.paths.faces]
        return np.where(met[..., None], self.at(table.way.points_m[:, 1:-1]), np.nan)

    def crossed_m(self, own: np.ndarray, paths: Paths, kept: np.ndarray, table: Table) -> np.ndarray:
        """(n, D + 1, 2) where the legs of those paths that are `kept` cross it; NaN where they do not."""
        number = np.full(len(paths.pair), -1)
        number[kept] = np.arange(len(kept))
        of_own = own[paths.crossing_face] & (number[paths.crossing_path] >= 0)
        path, leg = number[paths.crossing_path[of_own]], paths.crossing_leg[of_own]
        begin_m, end_m = table.way.points_m[path, leg], table.way.points_m[path, leg + 1]
        above, below = ((points_m - self.origin_m) @ self.normal for points_m in (begin_m, end_m))
        out = np.full((*table.way.direction.shape[:2], 2), np.nan)
        out[path, leg] = self.at(begin_m + (above / (above - below))[:, None] * (end_m - begin_m))
        return out


def _without(paths: Paths, own: np.ndarray) -> Paths:
    """The same paths, none of which crosses some faces."""
    keep = ~own[paths.crossing_face]
    crossings = {key: getattr(paths, key)[keep] for key in ("crossing_path", "crossing_leg", "crossing_face")}
    return replace(paths, **crossings)


def _heard_beside(ear: ResponseEar, here: World, endless: World, owner: int, effect: Effect) -> _Heard:
    predictor, faces, plane = ear.predictor, endless.faces, _Plane.of(effect)
    own, links, times = faces.owner == owner, range(len(predictor.links)), np.arange(len(predictor.time_s))
    traced = [predictor.traced(endless, index).paths for index in links]
    bare = [_without(paths, own) for paths in traced]
    tables = predictor.tabled(endless, links, bare)
    shut = predictor.tabled(endless, links, traced) if endless.surface.clear[owner] else None
    columns = []
    for index, table in enumerate(tables):
        kept = np.flatnonzero(are_unblocked(faces, bare[index], endless.surface))
        met_m, crossed_m = plane.met_m(own, table), plane.crossed_m(own, traced[index], kept, table)
        through = shut[index].gain if shut else np.zeros(len(table.gain))
        sent, held = (
            (phasors(gain, table.way.length_m, endless.carrier_hz, predictor.frequency_hz) * cable[:, None]).T
            for cable in [predictor.cables(endless, index)]
            for gain in (table.gain, through)
        )
        still = table.many < len(times)  # one instant stands for all
        path = np.tile(np.arange(len(kept)), len(times)) if still else np.arange(len(kept))
        row = index * len(times) + (np.repeat(times, len(kept)) if still else table.instant)
        columns.append((row, sent[path], held[path], met_m[path], crossed_m[path]))
    row, sent, held, met_m, crossed_m = (np.concatenate(column) for column in zip(*columns, strict=True))
    has = ~np.isnan(np.concatenate([met_m, crossed_m], axis=1)[..., 0]).all(axis=1)
    rest = np.zeros((len(links) * len(times), len(predictor.frequency_hz)), complex)
    np.add.at(rest, row[~has], sent[~has])
    rest = rest.reshape(len(links), len(times), -1)
    heard = _Heard(
        ear=ear, rest=rest, row=row[has], open=sent[has], shut=held[has], met_m=met_m[has], crossed_m=crossed_m[has]
    )  # fmt: skip
    # What bends, and what passes by, is as it is beside the plane as it was.
    more = ear.predicted(here) - heard.response(np.array(effect.choice.low_m), np.array(effect.choice.high_m))
    return replace(heard, rest=rest + more)
