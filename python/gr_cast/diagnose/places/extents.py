# SPDX-License-Identifier: GPL-3.0-or-later
"""Where an added plane ends: of the paths that an endless one sends, lets through and blocks, those that meet it within its ends
are there, and those that cross it within them are not. So one trace tells of all ends."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

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
_INSTANTS = 25  # of a sounding that are heard
_SAME_M = 1e-3  # of two places where paths meet the plane
_BEYOND_M = 0.5  # of the outermost
_WORTH_NATS, _SAME_NATS = 0.5, 0.01  # of a turn; of another end


@dataclass(frozen=True, eq=False, kw_only=True)
class _Heard:
    """One sounding beside an endless plane: `rest` (L, T, K) of what it has no part in; n paths that it has, by `row` of (L, T),
    in order: what is `sent` over them (n, K) where none of their legs crosses it; what it lets pass of each leg (n, D + 1),
    polarised as if no other leg crossed it; where they meet it (n, D, 2) and where their legs cross it (n, D + 1, 2), NaN where
    they do not."""

    ear: ResponseEar
    rest: np.ndarray
    row: np.ndarray
    sent: np.ndarray
    passed: np.ndarray
    met_m: np.ndarray
    crossed_m: np.ndarray
    known: dict = field(default_factory=dict)  # energies by what is left of each path

    def response(self, low_m: np.ndarray, high_m: np.ndarray) -> np.ndarray:
        return self._response(self._share(low_m, high_m))

    def energy(self, low_m: np.ndarray, high_m: np.ndarray) -> float:
        share = self._share(low_m, high_m)
        if (key := share.tobytes()) not in self.known:  # other ends that no path tells from these are as good
            fit = self.ear.profiled(self._response(share))
            self.known[key] = fit.energy - self.ear.tempered_nats(fit)
        return self.known[key]

    @cached_property
    def _does_not_meet(self) -> np.ndarray:
        return np.isnan(self.met_m[..., 0])

    @cached_property
    def _rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of (L, T) that have paths, and the first path of each."""
        return np.unique(self.row, return_index=True)

    def _share(self, low_m: np.ndarray, high_m: np.ndarray) -> np.ndarray:
        """(n,) what is left of each path."""
        there = (self._does_not_meet | _within(self.met_m, low_m, high_m)).all(axis=1)
        return np.where(_within(self.crossed_m, low_m, high_m), self.passed, 1.0).prod(axis=1) * there

    def _response(self, share: np.ndarray) -> np.ndarray:
        out, (rows, first) = self.rest.copy(), self._rows
        if len(rows):
            out.reshape(-1, out.shape[2])[rows] += np.add.reduceat(share[:, None] * self.sent, first)
        return out


def _within(at_m: np.ndarray, low_m: np.ndarray, high_m: np.ndarray) -> np.ndarray:
    x, y = at_m[..., 0], at_m[..., 1]
    return (x > low_m[0]) & (x < high_m[0]) & (y > low_m[1]) & (y < high_m[1])


def ended(ears: Sequence, base: World, effects: Sequence[Effect], number: int, bounds_m) -> Effect:
    """An added plane with the ends that explain most, looked for everywhere within `bounds_m` of the place, then near the best
    one after the other."""
    effect = effects[number]
    whole = effect.choice.through(*bounds_m)
    here, endless = (
        applied(base, [*effects[:number], replace(effect, choice=one), *effects[number + 1 :]]) for one in (effect.choice, whole)
    )
    own = [index for index, name in enumerate(endless.mesh.names) if name not in base.mesh.names and effect.family.adds(name)]
    owner = own[sum(one.family.name == effect.family.name for one in effects[:number])]
    heard = [
        _heard_beside(thinned(ear, _INSTANTS, policy.THIN_FREQUENCIES), here, endless, owner, effect)
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


def _crossing(paths: Paths, own: np.ndarray, leg: int = -1) -> Paths:
    """The same paths, that cross some faces with one of their legs alone, or with none."""
    keep = ~own[paths.crossing_face] | (paths.crossing_leg == leg)
    crossings = {key: getattr(paths, key)[keep] for key in ("crossing_path", "crossing_leg", "crossing_face")}
    return replace(paths, **crossings)


def _heard_beside(ear: ResponseEar, here: World, endless: World, owner: int, effect: Effect) -> _Heard:
    predictor, faces, plane = ear.predictor, endless.faces, _Plane.of(effect)
    own, links, times = faces.owner == owner, range(len(predictor.links)), np.arange(len(predictor.time_s))
    traced = [predictor.traced(endless, index).paths for index in links]
    bare = [_crossing(paths, own) for paths in traced]
    tables = predictor.tabled(endless, links, bare)
    legs = range(endless.max_depth + 1 if endless.surface.clear[owner] else 0)
    held = [predictor.tabled(endless, links, [_crossing(paths, own, leg) for paths in traced]) for leg in legs]
    columns = []
    for index, table in enumerate(tables):
        kept = np.flatnonzero(are_unblocked(faces, bare[index], endless.surface))
        met_m, crossed_m = plane.met_m(own, table), plane.crossed_m(own, traced[index], kept, table)
        passed = np.zeros(crossed_m.shape[:2], complex)
        for leg, through in zip(legs, held, strict=True):
            passed[:, leg] = through[index].gain / np.where(table.gain == 0, 1, table.gain)
        has = np.flatnonzero(~np.isnan(np.concatenate([met_m, crossed_m], axis=1)[..., 0]).all(axis=1))
        phases = phasors(table.gain[has], table.way.length_m[has], endless.carrier_hz, predictor.frequency_hz)
        sent = (phases * predictor.cables(endless, index)[:, None]).T
        instant, path = table.instant[has], np.arange(len(has))
        if table.many < len(times):  # one instant stands for all
            instant, path = np.repeat(times, len(has)), np.tile(path, len(times))
        columns.append((index * len(times) + instant, sent[path], *(one[has][path] for one in (passed, met_m, crossed_m))))
    row, sent, passed, met_m, crossed_m = (np.concatenate(column) for column in zip(*columns, strict=True))
    heard = _Heard(
        ear=ear, rest=np.zeros_like(ear.heard.y), row=row, sent=sent, passed=passed, met_m=met_m, crossed_m=crossed_m
    )  # fmt: skip
    ends_m = np.array(effect.choice.low_m), np.array(effect.choice.high_m)
    return replace(heard, rest=ear.predicted(here) - heard.response(*ends_m))
