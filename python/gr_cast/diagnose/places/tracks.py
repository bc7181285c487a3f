# SPDX-License-Identifier: GPL-3.0-or-later
"""Where something passes by: coarsely by how late its echoes are, then by their phases, instant after instant, along a line."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S
from ...scenario.create import fields
from ...scenario.create.images import tracing
from ...twin.places import passer
from . import imaging, policy, scan
from .ears import thinned
from .fit import evaluated

_SPEEDS_M_PER_S, _SPEED_STEP_M_PER_S, _SPEEDS = (2.4, 30.0), 0.4, 60  # that are looked for; steps at most
_ELSEWHERE_M = 1.5  # between coarse tracks
_KEPT, _LINES = 3, 5  # coarse tracks, and lines near one of them, that are returned
_LOOKED_AT = 9  # places across that are asked whether anything is in the way of an echo
_FOLLOWED = 2  # coarse tracks about which is looked finely
_REACH_M, _NEAR_M, _MOST = 1.4, 0.4, 1200  # about a coarse track, about one that is nearly known; steps across at most
_FINE = 8  # steps of a wavelength: an echo's phase turns twice as fast as a place moves
_SMOOTH_M = 0.05  # between places from which lengths and strengths are interpolated
_FINER = 16  # of the grid of delays over the resolution of the band
_INSTANTS = 15  # that are looked at, at most
_PEAKS = 200  # of each instant, through which lines are drawn: echoes of few links are in phase at many places
_FEW = 2  # instants beyond two by which lines are looked at first
_WITHIN, _WITHIN_STEPS = 2, 8  # cells about a line that is looked at more finely still, and steps of such a cell
_APART = 0.25  # of the time of a campaign, between the instants of a pair
_WEIGHED = 4000  # lines of which is asked whether they may be
_SLID, _TURNS = 60, 4  # lines that are moved cell by cell to where they explain most, so many times
_LEAST, _LEAST_AREA_M2 = 1e-30, 0.02


def passers(view, height_m: float):
    """(place (2,) at time 0, velocity (2,), cross-section in m² or None) of things that would explain echoes that move, the best
    first."""
    if not _pairs(view) or moving_nats(view) < policy.BEHIND_SHARE * view.model.left_nats(view.count):
        return []
    coarse = _coarse(view, moving_echoes(view), height_m)
    fine = [track for one in coarse[:_FOLLOWED] for track in _fine(view, height_m, *one)]
    return [track for _, track in sorted(fine, key=lambda pair: -pair[0])] + [(*one, None) for one in coarse]


def near(view, height_m: float, place_m: np.ndarray, velocity: np.ndarray, otherwise) -> list:
    """The same of lines near a track that is known but for the phases of its echoes; `otherwise`: nats (C,) that else speak for
    places at time 0 and velocities (C, 2), −∞ for what may not be."""
    fine = _fine(view, height_m, place_m, velocity, otherwise) if _pairs(view) else []
    return [track for _, track in sorted(fine, key=lambda pair: -pair[0])]


def moving_echoes(view) -> list[imaging.Echoes]:
    """Of the campaigns of several instants, without what stays the same."""
    return [imaging.echoes(ear, _moving(ear, fit, view.world), view.world) for ear, fit in _pairs(view)]


def moving_nats(view) -> float:
    """Of what is left above noise, what changes: all that anything which passes can explain. What stays the same has taken its
    share of the noise, no more of it than a mean would."""
    total = 0.0
    for ear, fit in _pairs(view):
        instants = np.maximum(ear.heard.known.any(axis=2).sum(axis=1), 1)
        stands = [_stands(ear, index, view.world) for index in range(len(instants))]
        noise = ear.heard.known.sum(axis=(1, 2)) * np.where(stands, 1 - 1 / instants, 1.0)
        total += float((ear.nats(_moving(ear, fit, view.world)) - noise).sum())
    return total


def _stands(ear, index: int, world) -> bool:
    """Whether both ends of a link stay where they are."""
    return not any(np.ptp(end_m, axis=0).any() for end_m in ear.predictor.ends_m(world, index))


def _pairs(view) -> list:
    return [(ear, fit) for ear, fit in view.wideband if len(ear.predictor.time_s) > 1]


def _moving(ear, fit, world):
    """A fit with what is left that changes: what stays the same between ends that stay is no passer's. Its median, not its mean:
    a shadow at some instants would leave its share at all others, as something that stands there."""
    residual = fit.residual.copy()
    for index in range(len(ear.heard.links)):
        if _stands(ear, index, world):
            factor, known = fit.factor[index], ear.heard.weight[index] > 0
            own = np.where(known, residual[index] / np.where(known, factor, 1), np.nan)
            some = known.any(axis=0)
            stays = np.zeros(len(some), complex)
            stays[some] = np.nanmedian(own[:, some].real, axis=0) + 1j * np.nanmedian(own[:, some].imag, axis=0)
            residual[index] -= np.where(known, factor * stays, 0)
    return replace(fit, residual=residual)


def _coarse(view, seen: list, height_m: float) -> list:
    """(place at time 0, velocity) of straight ways along which echoes are as late as they should be, at any speed that stays in
    the place for most of the campaign."""
    low, high = view.bounds_m
    extent_m = float((high - low)[:2].max())
    step_m = max(float(np.clip(SPEED_OF_LIGHT_M_PER_S / seen[0].bins_per_s * 2, 0.25, 1.0)), extent_m / 60)
    x, y = (np.arange(low[axis] - 2, high[axis] + 2, step_m) for axis in (0, 1))
    foot_m = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    maps, time_s = imaging.passer_maps(seen, foot_m, height_m)
    most = float(np.clip(extent_m / max(np.ptp(time_s), 1e-3), *_SPEEDS_M_PER_S))
    speeds = np.arange(-most, most + 1e-9, max(_SPEED_STEP_M_PER_S, 2 * most / _SPEEDS))
    velocity = np.array([(a, b) for a in speeds for b in speeds if np.hypot(a, b) <= most])
    turn = (speeds[1] - speeds[0]) / 2
    maps = maps.reshape(-1, len(x), len(y))
    scores = summed(maps, np.round(time_s[:, None] * velocity[:, None] / step_m).astype(int))
    found, near = [], np.array([(a, b) for a in (-1, -0.5, 0, 0.5, 1) for b in (-1, -0.5, 0, 0.5, 1)])
    for _ in range(_KEPT):
        v, p = np.unravel_index(np.argmax(scores), scores.shape)
        best_m, best = foot_m[p], velocity[v]
        for finer in (1.0, 0.5, 0.25):
            fine_m, fine = best_m + step_m / 2 * finer * near, best + turn * finer * near
            i, j = np.unravel_index(
                np.argmax(fine_scores := imaging.passer_scores(seen, fine_m, fine, height_m)), (len(near),) * 2
            )
            best_m, best = fine_m[i], fine[j]
        found.append((best_m, best))
        scores[:, np.linalg.norm(foot_m - foot_m[p], axis=1) < _ELSEWHERE_M] = -np.inf
    return found


def summed(maps: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Maps (instants, X, Y) summed along ways that move by so many cells (ways, instants, 2): (ways, X·Y), by first cell."""
    if tracing:
        return tracing.summed_along(maps, moved).reshape(len(moved), -1)
    total, (_, wide, deep) = np.zeros((len(moved), *maps.shape[1:])), maps.shape
    for way, cells in zip(total, moved.tolist(), strict=True):
        for one, (a, b) in zip(maps, cells, strict=True):
            if abs(a) < wide and abs(b) < deep:
                way[max(-a, 0) : wide - max(a, 0), max(-b, 0) : deep - max(b, 0)] += one[
                    max(a, 0) : wide + min(a, 0), max(b, 0) : deep + min(b, 0)
                ]
    return total.reshape(len(moved), -1)


def _fine(view, height_m: float, place_m: np.ndarray, velocity: np.ndarray, otherwise=None) -> list:
    """(nats, (place, velocity, cross-section)) of lines near a coarse track along which echoes are in phase as they should: where
    nothing keeps them from links and, for the twin may be wrong in that, where what is solid does."""
    whole = _pairs(view)[0][0]
    ear = thinned(whole, _INSTANTS, len(whole.heard.frequency_hz))
    fit = _moving(ear, evaluated([ear], view.model.base, view.model.effects).fits[0], view.world)
    middle_s = ear.predictor.time_s.mean()
    start_m = place_m + velocity * middle_s
    step_m = view.world.wavelength_m / _FINE
    reach_m = min(_NEAR_M if otherwise else _REACH_M, step_m * _MOST / 2)
    told = otherwise and (lambda at_m, turn: otherwise(start_m + at_m - (velocity + turn) * middle_s, velocity + turn))
    found = []
    strips = partial(_strips, view, ear, fit, height_m)
    walls = (False, True) if _screened(view, ear, height_m, start_m, velocity, reach_m) else (False,)
    for is_solid, wide in zip(walls, strips(walls, start_m, velocity, reach_m, step_m), strict=True):
        found += _in_phase(partial(strips, (is_solid,)), wide, start_m, velocity, told)
    out, seen = [], []
    for nats, amplitude, at_m, turn in sorted(found, key=lambda line: -line[0]):
        if any(np.allclose([*at_m, *turn], other) for other in seen):  # as well with as without
            continue
        seen.append([*at_m, *turn])
        speed = velocity + turn
        area_m2 = (max(amplitude, 0) * (4 * np.pi) ** 1.5 / view.world.wavelength_m) ** 2
        out.append((nats, (start_m + at_m - speed * middle_s, speed, max(area_m2, _LEAST_AREA_M2))))
    return out


def _screened(view, ear, height_m: float, start_m: np.ndarray, velocity: np.ndarray, reach_m: float) -> bool:
    """Whether something solid keeps an echo from about a track from an end of a link."""
    after_s, grid_m = ear.predictor.time_s - ear.predictor.time_s.mean(), np.linspace(-reach_m, reach_m, _LOOKED_AT)
    about_m = np.stack(np.meshgrid(grid_m, grid_m, indexing="ij"), axis=-1).reshape(-1, 1, 2)
    feet_m = start_m + about_m + after_s[:, None] * velocity
    bodies_m = np.concatenate([feet_m, np.full((*feet_m.shape[:2], 1), height_m)], axis=2)
    for index in range(len(ear.heard.links)):
        for end_m in ear.predictor.ends_m(view.world, index):
            ways_m = np.stack(np.broadcast_arrays(end_m, bodies_m), axis=2).reshape(-1, 2, 3)
            if passer.blocked(view.world, ways_m).any():
                return True
    return False


def _in_phase(strips, wide: "_Strip", start_m: np.ndarray, velocity: np.ndarray, told) -> list:
    """(nats, amplitude, place in the middle, velocity), both more than those of a track, of lines along which the maps about it
    and those that `strips` makes are loud; `told`: nats that else speak for such lines, or None."""
    step_m = wide.step_m
    at_m, turn = _through(wide, _WEIGHED)

    def ranked(at_m, turn, most: int, also=None) -> tuple[np.ndarray, np.ndarray]:
        nats = wide.along(at_m, turn)[0] + (also(at_m, turn) if also else 0.0)
        order = np.argsort(-nats)[:most]
        order = order[np.isfinite(nats[order])]
        return at_m[order], turn[order]

    if told:
        at_m, turn = ranked(at_m, turn, _WEIGHED)
    at_m, turn = ranked(at_m, turn, _SLID, told)
    at_m, turn = ranked(*wide.slid(at_m, turn), _SLID, told)
    kept: list = []
    for one in range(len(at_m)):
        if all(np.abs(np.concatenate([at_m[one] - at_m[k], turn[one] - turn[k]])).max() > step_m for k in kept):
            kept.append(one)
    out = []
    for one in kept[:_LINES]:
        (near,) = strips(start_m + at_m[one], velocity + turn[one], _WITHIN * step_m, step_m / _WITHIN_STEPS)
        finer_m, slower = near.slid(np.zeros((1, 2)), np.zeros((1, 2)))
        nats, amplitude = (float(part[0]) for part in near.along(finer_m, slower))
        out.append((nats, amplitude, at_m[one] + finer_m[0], turn[one] + slower[0]))
    return out


@dataclass(frozen=True, eq=False, kw_only=True)
class _Strip:
    """Maps (instants, X, Y) about a place that moves, see `_map`, over `axis_m` either way; instants by their time after the
    middle."""

    cross: np.ndarray
    power: np.ndarray
    axis_m: np.ndarray
    after_s: np.ndarray

    @property
    def step_m(self) -> float:
        return self.axis_m[1] - self.axis_m[0]

    def along(self, at_m: np.ndarray, turn: np.ndarray, instants: Sequence[int] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """(nats, amplitude) of lines (..., 2) by their place in the middle and velocity, all echoes of one strength, at all
        instants or those alone."""
        which = np.arange(len(self.after_s)) if instants is None else np.asarray(instants)
        top, bottom = self._sums(which, *np.broadcast_arrays(at_m, turn))
        return np.maximum(top, 0) ** 2 / (bottom + _LEAST), top / (bottom + _LEAST)

    def _sums(self, which: np.ndarray, at_m: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Both maps at some instants, summed along lines (..., 2)."""
        if tracing:
            sums = tracing.along(self.cross, self.power, self.axis_m[0], self.step_m, self.after_s, which, at_m, turn)
            return tuple(one.reshape(at_m.shape[:-1]) for one in sums)
        size = len(self.axis_m)
        top, bottom = np.zeros((2, *at_m.shape[:-1]))
        for one in which:
            x, y = np.moveaxis(np.rint((at_m + self.after_s[one] * turn - self.axis_m[0]) / self.step_m).astype(np.int32), -1, 0)
            inside = (x >= 0) & (x < size) & (y >= 0) & (y < size)
            cell = np.where(inside, x * size + y, 0)
            top += self.cross[one].ravel()[cell] * inside
            bottom += self.power[one].ravel()[cell] * inside
        return top, bottom

    def slid(self, at_m: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lines moved cell by cell to where they explain most."""
        slide = np.array(list(itertools.product((-2, -1, 0, 1, 2), repeat=4))) * self.step_m
        slide[:, 2:] /= np.ptp(self.after_s) / 2
        for _ in range(_TURNS):
            top = np.argmax(self.along(at_m[:, None] + slide[:, :2], turn[:, None] + slide[:, 2:])[0], axis=1)
            at_m, turn = at_m + slide[top, :2], turn + slide[top, 2:]
        return at_m, turn


def _strips(
    view, ear, fit, height_m: float, walls: Sequence[bool], centre_m, velocity: np.ndarray, reach_m: float, step_m: float
) -> list[_Strip]:
    """About a place, where something solid keeps echoes from links and where nothing does, as `walls` has it."""
    axis_m = step_m * np.arange(-round(reach_m / step_m), round(reach_m / step_m) + 1)
    knots = _Knots(axis_m=axis_m)
    after_s = ear.predictor.time_s - ear.predictor.time_s.mean()
    share = ear.undisturbed(fit)  # what other causes leave is noise here
    cross, power = np.empty((2, len(walls), len(after_s), len(axis_m), len(axis_m)), np.float32)
    for step, t in enumerate(after_s):
        at_m = centre_m + velocity * t
        cross[:, step], power[:, step] = _maps(view, ear, fit, step, share[:, step], at_m, knots, height_m, walls)
    return [_Strip(cross=one, power=loud, axis_m=axis_m, after_s=after_s) for one, loud in zip(cross, power, strict=True)]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Knots:
    """Places (n,) of an axis between which fields are linear, and where the places of the axis are among them."""

    axis_m: np.ndarray

    @cached_property
    def at_m(self) -> np.ndarray:
        return np.linspace(self.axis_m[0], self.axis_m[-1], 2 + int((self.axis_m[-1] - self.axis_m[0]) / _SMOOTH_M))

    @cached_property
    def shares(self) -> np.ndarray:
        """(axis, n) that each has in what is between them."""
        return np.array([np.interp(self.axis_m, self.at_m, own) for own in np.eye(len(self.at_m))], np.float32).T

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Of values (n, n), (axis, axis)."""
        return self.shares @ values.astype(np.float32) @ self.shares.T

    def turned(self, field: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """Real part (axis, axis) of a field (n, n) that is turned by a phase (n, n)."""
        if tracing:
            return tracing.turned_between(field, phase, np.linspace(0, len(self.at_m) - 1, len(self.axis_m)))
        phase = self.spread(phase)
        return self.spread(field.real) * np.cos(phase) - self.spread(field.imag) * np.sin(phase)


def _through(strip: _Strip, most: int) -> tuple[np.ndarray, np.ndarray]:
    """The best lines, at most so many of each two instants, through a peak each of any two maps that are some time apart."""
    after_s, peaks, most_nats = strip.after_s, [], []
    for cross, power in zip(strip.cross, strip.power, strict=True):
        nats = np.maximum(cross, 0) ** 2 / power
        peaks.append(np.array(scan.minima_of((strip.axis_m, strip.axis_m), -nats, _PEAKS)))
        most_nats.append(nats.max())
    loudest = np.argsort(-np.array(most_nats))
    found = []
    for first, last in itertools.combinations(range(len(after_s)), 2):
        apart_s = after_s[last] - after_s[first]
        if apart_s >= np.ptp(after_s) * _APART:
            a, b = (one.reshape(-1, 2) for one in np.broadcast_arrays(peaks[first][:, None], peaks[last][None]))
            turn = (b - a) / apart_s
            at_m = a - after_s[first] * turn
            few = [first, last, *loudest[~np.isin(loudest, (first, last))][:_FEW]]
            told = strip.along(at_m, turn, few)[0]
            best = np.argpartition(-told, min(most, len(told)) - 1)[:most]
            found.append((at_m[best], turn[best]))
    return tuple(np.concatenate(part) for part in zip(*found, strict=True))


def _maps(
    view, ear, fit, step: int, share: np.ndarray, centre_m, knots: _Knots, height_m: float, walls: Sequence[bool]
) -> tuple[np.ndarray, list[np.ndarray]]:
    """What an echo from each place (X, Y) about a centre at one instant says of all links together, each with its `share`: its
    amplitude is the first over the second, its nats the first's square over the second. With what is solid in its way, or
    without, as `walls` has it."""
    heard, world = ear.heard, view.world
    f_hz = heard.frequency_hz
    spacing_hz, size = f_hz[1] - f_hz[0], 1 << int(np.ceil(np.log2(_FINER * len(f_hz))))
    foot_m = centre_m + np.stack(np.meshgrid(knots.at_m, knots.at_m, indexing="ij"), axis=-1)
    body_m = np.concatenate([foot_m, np.full((*foot_m.shape[:2], 1), height_m)], axis=2)
    cross = np.zeros((len(walls), *[len(knots.axis_m)] * 2), np.float32)
    power = np.full((len(walls), *[len(knots.at_m)] * 2), _LEAST)
    everywhere, reached = np.ones(body_m.shape[:2]), {}  # whether echoes from each place come to a node, or are kept from it

    def reaches(end_m: np.ndarray) -> np.ndarray:
        if (key := end_m.tobytes()) not in reached:
            ways_m = np.stack(np.broadcast_arrays(end_m, body_m.reshape(-1, 3)), axis=1)
            reached[key] = ~passer.blocked(world, ways_m).reshape(body_m.shape[:2])
        return reached[key]

    for index, link in enumerate(heard.links):
        ends_m = [end[step] for end in ear.predictor.ends_m(world, index)]
        legs = [body_m - ends_m[0], ends_m[1] - body_m]
        far_m = [np.maximum(np.linalg.norm(leg, axis=2), 0.1) for leg in legs]
        strength = 1 / (far_m[0] * far_m[1])
        for name, leg, long_m, sign in zip(link, legs, far_m, (1, -1), strict=True):
            direction = (sign * leg / long_m[..., None]).reshape(-1, 3)
            strength = strength * np.linalg.norm(fields.far_field(world.radios[name].antenna, direction), axis=1).reshape(
                long_m.shape
            )
        factor = fit.factor[index, step] * ear.predictor.cables(world, index)
        weight = heard.weight[index, step] * share[index]
        profile = np.fft.ifft(fit.residual[index, step] * weight * factor.conj(), size) * size
        length_m = far_m[0] + far_m[1]
        delay_s, waves = length_m / SPEED_OF_LIGHT_M_PER_S, (world.carrier_hz + f_hz[0]) / SPEED_OF_LIGHT_M_PER_S
        about_m = float(length_m.mean())
        told = profile[np.round(delay_s * spacing_hz * size).astype(int) % size]
        told = told * np.exp(2j * np.pi * np.mod(waves * about_m, 1.0))
        phase = 2 * np.pi * waves * (length_m - about_m)
        for number, is_solid in enumerate(walls):
            there = reaches(ends_m[0]) * reaches(ends_m[1]) if is_solid else everywhere
            if not number or not there.all():  # else as it is without what is solid
                sent = there * strength
                said, loud = knots.turned(sent * told, phase), sent**2 * (np.abs(factor) ** 2 * weight).sum()
            cross[number] += said
            power[number] += loud
    return cross, [knots.spread(one) for one in power]
