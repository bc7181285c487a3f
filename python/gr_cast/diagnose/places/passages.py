# SPDX-License-Identifier: GPL-3.0-or-later
"""Ways along which something that passes explains what is heard by what it hides and what it echoes together: beside a path that
it hides its echo is what is left, and neither alone need explain anything."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S
from ...scenario.create import fields
from ...scenario.create.images import tracing
from ...twin.places import passer
from ...twin.places.predict import phasors
from ...twin.places.world import World
from . import scan
from .ears import thinned, undisturbed_fit
from .likelihood import Fitted, tempered

_REACH_M, _MOST, _MOST_AGAIN = 1.4, 600, 400  # about a coarse way; steps across at most, and about a way that was found
_FINE = 8  # steps of a wavelength: an echo's phase turns twice as fast as a place moves
_SMOOTH_M = 0.05  # between places from which lengths and strengths are interpolated
_SHADE_M = 0.01  # between places of which is asked what is hidden from there
_FINER = 16  # of the grid of delays over the resolution of the band
_INSTANTS, _FEWER, _MANY = 15, 10, 300  # that are looked at, at most; where there are more steps across
_ROOTS_M = np.array([0.35, 0.6, 0.9, 1.3, 1.9, 2.8])  # of cross-sections that are tried: what lies between is a parabola's
_PATHS = 4  # of a link at an instant, the strongest, that may be hidden
_PEAKS = 200  # of each instant, through which ways are drawn: echoes of few links are in phase at many places
_FEW = 2  # instants beyond two by which ways are looked at first
_APART = 0.25  # of the time of a campaign, between the instants of a pair
_WEIGHED, _SLID, _TURNS = 4000, 60, 4  # ways of a pair; that are moved cell by cell to where they explain most, so many times
_LINES = 5  # near one of them that are returned


@dataclass(frozen=True, eq=False, kw_only=True)
class Way:
    """Of an upright body: where it is at time 0 and its velocity (2,), its radius and cross-section, and the nats that these
    explain."""

    place_m: np.ndarray
    velocity: np.ndarray
    radius_m: float
    area_m2: float
    nats: float


def ways(view, ear, height_m: float, place_m: np.ndarray, velocity: np.ndarray, radii_m: Sequence[float]) -> list[Way]:
    """Of bodies so wide about a coarse way, the best of each first, each a cell away from the others; echoes come from
    `height_m`."""
    ear = thinned(ear, _FEWER if is_wide(view.world) else _INSTANTS, len(ear.heard.frequency_hz))
    fit = undisturbed_fit(ear, view.world)
    return _about(view.world, ear, fit, height_m, place_m, velocity, radii_m, axis(view.world, _MOST))


def ways_again(
    view, ear, height_m: float, place_m: np.ndarray, velocity: np.ndarray, radii_m: Sequence[float]
) -> list[list[Way]]:
    """The same about the way of whom is known to pass, with what is unknown fitted beside him: to all responses, and more to
    those that are as they should be."""
    ear, world = thinned(ear, _INSTANTS, len(ear.heard.frequency_hz)), replace(view.world, person=None)
    fits = ear.profiled(ear.predicted(view.world)), undisturbed_fit(ear, view.world)
    axis_m, bare = axis(world, _MOST_AGAIN), ear.predicted(world)
    without = [replace(fit, model=fit.factor * bare) for fit in fits]
    return [_about(world, ear, fit, height_m, place_m, velocity, radii_m, axis_m) for fit in without]


def _about(world, ear, fit: Fitted, height_m: float, place_m, velocity, radii_m: Sequence[float], axis_m) -> list[Way]:
    middle_s = ear.predictor.time_s.mean()
    begun_m = place_m + velocity * middle_s
    found = []
    for radius_m, strip in zip(radii_m, _strips(world, ear, fit, height_m, begun_m, velocity, radii_m, axis_m), strict=True):
        for at_m, turn, area_m2, nats in strip.told():
            speed = velocity + turn
            place_m = begun_m + at_m - speed * middle_s
            found.append(Way(place_m=place_m, velocity=speed, radius_m=radius_m, area_m2=area_m2, nats=nats))
    return found


def axis(world, most: int = _MOST) -> np.ndarray:
    """Places across a strip, from its middle."""
    step_m = world.wavelength_m / _FINE
    steps = round(min(_REACH_M, step_m * most / 2) / step_m)
    return step_m * np.arange(-steps, steps + 1)


def is_wide(world) -> bool:
    """Whether a strip has very many steps."""
    return len(axis(world)) > _MANY


@dataclass(frozen=True, eq=False, kw_only=True)
class Strip:
    """Nats (cross-sections, instants, X, Y) about a place that moves, over `axis_m` either way; instants by their time after the
    middle. Ways (..., 2) are told by their place in the middle and their velocity, both more than that place's."""

    nats: np.ndarray
    axis_m: np.ndarray
    after_s: np.ndarray

    @property
    def step_m(self) -> float:
        return self.axis_m[1] - self.axis_m[0]

    def told(self) -> list[tuple[np.ndarray, np.ndarray, float, float]]:
        """(place, turn, cross-section, nats) of the ways that explain most."""
        at_m, turn = self.best(*self.through(), _SLID)
        at_m, turn = self.best(*self.slid(at_m, turn), _SLID)
        kept: list[int] = []
        for one in range(len(at_m)):
            if all(np.abs(np.concatenate([at_m[one] - at_m[k], turn[one] - turn[k]])).max() > self.step_m for k in kept):
                kept.append(one)
        kept = kept[:_LINES]
        nats, root_m = self.along(at_m[kept], turn[kept])
        return list(zip(at_m[kept], turn[kept], (root_m**2).tolist(), nats.tolist(), strict=True))

    def along(self, at_m: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(nats, root of the cross-section) of ways."""
        return _summit(self.sums(self.nats, range(len(self.after_s)), at_m, turn))

    def sums(self, maps: np.ndarray, which: Sequence[int], at_m: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Of maps (kinds, instants, X, Y) at some instants together, (kinds, ...) along ways."""
        at_m, turn = np.broadcast_arrays(at_m, turn)
        if tracing:
            sums = tracing.along(maps, self.axis_m[0], self.step_m, self.after_s, np.asarray(which), at_m, turn)
            return sums.reshape(len(maps), *at_m.shape[:-1])
        size = len(self.axis_m)
        out = np.zeros((len(maps), *at_m.shape[:-1]))
        for one in which:
            x, y = np.moveaxis(np.rint((at_m + self.after_s[one] * turn - self.axis_m[0]) / self.step_m).astype(np.int32), -1, 0)
            inside = (x >= 0) & (x < size) & (y >= 0) & (y < size)
            out += maps[:, one].reshape(len(out), -1)[:, np.where(inside, x * size + y, 0)] * inside
        return out

    def best(self, at_m: np.ndarray, turn: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
        order = np.argsort(-self.along(at_m, turn)[0])[:most]
        return at_m[order], turn[order]

    def slid(self, at_m: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ways moved cell by cell to where they explain most."""
        slide = np.array(list(itertools.product((-2, -1, 0, 1, 2), repeat=4))) * self.step_m
        slide[:, 2:] /= np.ptp(self.after_s) / 2
        for _ in range(_TURNS):
            top = np.argmax(self.along(at_m[:, None] + slide[:, :2], turn[:, None] + slide[:, 2:])[0], axis=1)
            at_m, turn = at_m + slide[top, :2], turn + slide[top, 2:]
        return at_m, turn

    def through(self) -> tuple[np.ndarray, np.ndarray]:
        """The best ways, at most so many of each two instants, through a peak each of any two maps that are some time apart."""
        after_s, loudest = self.after_s, self.nats.max(axis=0)
        peaks = [np.array(scan.minima_of((self.axis_m, self.axis_m), -one, _PEAKS)) for one in loudest]
        order = np.argsort(-loudest.max(axis=(1, 2)))
        found = [(np.zeros((1, 2)), np.zeros((1, 2)))]
        for first, last in itertools.combinations(range(len(after_s)), 2):
            apart_s = after_s[last] - after_s[first]
            if abs(apart_s) < np.ptp(after_s) * _APART or not len(peaks[first]) or not len(peaks[last]):
                continue
            a, b = (one.reshape(-1, 2) for one in np.broadcast_arrays(peaks[first][:, None], peaks[last][None]))
            turn = (b - a) / apart_s
            at_m = a - after_s[first] * turn
            few = [first, last, *order[~np.isin(order, (first, last))][:_FEW]]
            (told,) = self.sums(loudest[None], few, at_m, turn)
            best = np.argpartition(-told, min(_WEIGHED, len(told)) - 1)[:_WEIGHED]
            found.append((at_m[best], turn[best]))
        return tuple(np.concatenate(part) for part in zip(*found, strict=True))


def _summit(nats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The most of nats (cross-sections, ...) over the root of the cross-section, by the parabola through the best and its
    neighbours, and that root."""
    at = np.clip(nats.argmax(axis=0), 1, len(nats) - 2)
    low, best, high = (np.take_along_axis(nats, (at + one)[None], axis=0)[0] for one in (-1, 0, 1))
    a, b, c = (_ROOTS_M[at + one] for one in (-1, 0, 1))
    slope = (best - low) / (b - a)
    bend = ((high - best) / (c - b) - slope) / (c - a)
    end = np.where(low > np.maximum(best, high), a, np.where(high > best, c, b))
    top = np.where(bend < 0, np.clip((a + b) / 2 - slope / np.where(bend < 0, 2 * bend, -1), a, c), end)
    return np.maximum(low + slope * (top - a) + bend * (top - a) * (top - b), nats.max(axis=0)), top


@dataclass(frozen=True, eq=False, kw_only=True)
class Knots:
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


def _strips(
    world, ear, fit: Fitted, height_m: float, begun_m, velocity: np.ndarray, radii_m: Sequence[float], axis_m: np.ndarray
) -> list[Strip]:
    """Of bodies of some radii, whose echoes are the same."""
    predictor, knots = ear.predictor, Knots(axis_m=axis_m)
    after_s = predictor.time_s - predictor.time_s.mean()
    every = max(1, int(_SHADE_M / (axis_m[1] - axis_m[0])))
    near = np.rint(np.arange(len(axis_m)) / every).astype(int).clip(max=(len(axis_m) - 1) // every)
    tables = [passer.at_all_instants(predictor.path_table(world, one), len(after_s)) for one in range(len(predictor.links))]
    nats = np.zeros((len(radii_m), len(_ROOTS_M), len(after_s), len(axis_m), len(axis_m)), np.float32)
    for step, t in enumerate(after_s):
        centre_m = begun_m + velocity * t
        foot_m, bodies = _around(centre_m, axis_m[::every]), _Bodies(world=world, at_m=_around(centre_m, knots.at_m, height_m))
        for index, table in enumerate(tables):
            if ear.heard.weight[index, step].any():
                echo = _Echo.of(bodies, ear, fit.factor, index, step, knots)
                rest = _Rest.of(world, ear, fit, index, step, table, echo.scale)
                nats[:, :, step] += rest.nats(echo, [rest.hidden(foot_m, radius_m) for radius_m in radii_m], near)
    return [Strip(nats=one, axis_m=axis_m, after_s=after_s) for one in nats]


def _around(centre_m: np.ndarray, axis_m: np.ndarray, height_m: float = 0.0) -> np.ndarray:
    """Places (n, n, 3) over an axis either way of one, feet or so high."""
    at_m = centre_m + np.stack(np.meshgrid(axis_m, axis_m, indexing="ij"), axis=-1)
    return np.concatenate([at_m, np.full((*at_m.shape[:2], 1), height_m)], axis=2)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Bodies:
    """Where echoes of one instant may come from (n, n, 3), and by the ends of links from which of these they come there."""

    world: World
    at_m: np.ndarray
    found: dict[bytes, np.ndarray] = field(default_factory=dict)

    def reach(self, end_m: np.ndarray) -> np.ndarray:
        """(n, n): nothing solid stands in the way; links share their ends."""
        if (key := end_m.tobytes()) not in self.found:
            ways_m = np.stack(np.broadcast_arrays(end_m, self.at_m.reshape(-1, 3)), axis=1)
            self.found[key] = ~passer.blocked(self.world, ways_m).reshape(self.at_m.shape[:2])
        return self.found[key]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Echo:
    """From each place (n, n) of knots, of a body of 1 m² on one link at one instant: its strength there, the delay's cell and the
    phase that is left, about `turn`; `power` (X, Y) over noise between them. Where something solid stands in the way none."""

    strength: np.ndarray
    cell: np.ndarray
    turn: np.ndarray
    phase: np.ndarray
    power: np.ndarray
    scale: np.ndarray
    knots: Knots

    @classmethod
    def of(cls, bodies: _Bodies, ear, factors: np.ndarray, index: int, step: int, knots: Knots) -> "_Echo":
        world, heard, f_hz = bodies.world, ear.heard, ear.heard.frequency_hz
        ends_m = [end[step] for end in ear.predictor.ends_m(world, index)]
        legs = [bodies.at_m - ends_m[0], ends_m[1] - bodies.at_m]
        far_m = [np.maximum(np.linalg.norm(leg, axis=2), 0.1) for leg in legs]
        strength = world.wavelength_m / (4 * np.pi) ** 1.5 / (far_m[0] * far_m[1])
        for name, leg, long_m, sign in zip(heard.links[index], legs, far_m, (1, -1), strict=True):
            direction = (sign * leg / long_m[..., None]).reshape(-1, 3)
            far_field = np.linalg.norm(fields.far_field(world.radios[name].antenna, direction), axis=1)
            strength = strength * far_field.reshape(long_m.shape)
        for end_m in ends_m:
            strength = strength * bodies.reach(end_m)
        scale = factors[index, step] * ear.predictor.cables(world, index)
        length_m = far_m[0] + far_m[1]
        cells_per_m, about_m = (f_hz[1] - f_hz[0]) * _size(len(f_hz)) / SPEED_OF_LIGHT_M_PER_S, float(length_m.mean())
        waves = (world.carrier_hz + f_hz[0]) / SPEED_OF_LIGHT_M_PER_S
        return cls(
            strength=strength,
            cell=np.round(length_m * cells_per_m).astype(int) % _size(len(f_hz)),
            turn=np.exp(2j * np.pi * np.mod(waves * about_m, 1.0)),
            phase=2 * np.pi * waves * (length_m - about_m),
            power=knots.spread(strength**2 * (np.abs(scale) ** 2 * heard.weight[index, step]).sum()),
            scale=scale,
            knots=knots,
        )  # fmt: skip

    def told(self, weighed: np.ndarray) -> np.ndarray:
        """Real part (X, Y) of what it has in common with a response times its weight."""
        return self.knots.turned(self._profile(weighed), self.phase)

    def all_told(self, weighed: np.ndarray) -> np.ndarray:
        """The same, and its imaginary part."""
        profile = self._profile(weighed)
        return self.knots.turned(profile, self.phase) + 1j * self.knots.turned(-1j * profile, self.phase)

    def _profile(self, weighed: np.ndarray) -> np.ndarray:
        size = _size(len(weighed))
        return self.strength * self.turn * (np.fft.ifft(weighed * self.scale.conj(), size) * size)[self.cell]


def _size(tones: int) -> int:
    """Cells of delay."""
    return 1 << int(np.ceil(np.log2(_FINER * tones)))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Rest:
    """Of one link at one instant what is heard, what is predicted of it without anything that passes (K,), and the paths (P, K),
    over `points_m` (P, D + 2, 3), that it may hide."""

    y: np.ndarray
    model: np.ndarray
    paths: np.ndarray
    points_m: np.ndarray
    weight: np.ndarray
    is_free: bool

    @classmethod
    def of(cls, world, ear, fit, index: int, step: int, table, scale: np.ndarray) -> "_Rest":
        heard = ear.heard
        points_m, instant, gain, length_m, _ = table
        own = np.flatnonzero((instant == step) & (gain != 0))
        own = own[np.argsort(-np.abs(gain[own]))[:_PATHS]]
        return cls(
            y=heard.y[index, step],
            model=fit.model[index, step],
            paths=phasors(gain[own], length_m[own], world.carrier_hz, heard.frequency_hz).T * scale,
            points_m=points_m[own],
            weight=heard.weight[index, step],
            is_free=heard.phase == "snapshot",
        )

    def hidden(self, foot_m: np.ndarray, radius_m: float) -> np.ndarray:
        """Which paths, by the bits of a number, are hidden from over each place (X, Y)."""
        if not len(self.paths):
            return np.zeros(foot_m.shape[:2], int)
        dark = passer.shaded(radius_m, passer.HEIGHT_M, foot_m.reshape(-1, 1, 3), self.points_m[None])[:, 0]
        return (dark * (1 << np.arange(len(self.paths)))).sum(axis=1).reshape(foot_m.shape[:2])

    def nats(self, echo: _Echo, hidden: list[np.ndarray], near: np.ndarray) -> np.ndarray:
        """(bodies, cross-sections, X, Y): by which the response is likelier with each body, which hides so much at places, to
        which those of an axis are `near` (X,)."""
        sets, kind = np.unique(np.array(hidden), return_inverse=True)
        models = [self.model - self.paths[(bits >> np.arange(len(self.paths))) & 1 == 1].sum(axis=0) for bits in sets]
        kinds = kind.reshape(len(hidden), *hidden[0].shape)[:, near[:, None], near]
        heard = Response(
            power=float((np.abs(self.y) ** 2 * self.weight).sum()),
            count=int((self.weight > 0).sum()),
            is_free=self.is_free,
            own=np.array([(np.abs(model) ** 2 * self.weight).sum() for model in models]),
            shared=np.array([(model.conj() * self.y * self.weight).sum() for model in models]),
            before=((np.abs(self.model) ** 2 * self.weight).sum(), (self.model.conj() * self.y * self.weight).sum()),
        )
        common = np.array([echo.told(model * self.weight) for model in models])
        said = echo.all_told(self.y * self.weight)
        return np.array([heard.likelier(said, common, echo.power, one) for one in kinds])


@dataclass(frozen=True, eq=False, kw_only=True)
class Response:
    """Of one link at one instant: its energy over noise, in `count` numbers; `own` (sets,) of what is predicted of it where some
    set of paths is hidden, what that has in common with it, `shared` (sets,), whose phase may be free; `before`: both of these
    without anybody."""

    power: float
    count: int
    is_free: bool
    own: np.ndarray
    shared: np.ndarray
    before: tuple[float, complex]

    def energy(self, own, shared) -> np.ndarray:
        common = np.abs(shared) if self.is_free else np.real(shared)
        return tempered(np.maximum(self.power + own - 2 * common, self.count), self.count)

    def likelier(self, said: np.ndarray, common: np.ndarray, loud: np.ndarray, kind: np.ndarray) -> np.ndarray:
        """(cross-sections, X, Y): nats with somebody who hides the set `kind` (X, Y), by what an echo of 1 m² has in common with
        the response (X, Y) and with what is predicted (sets, X, Y), and how `loud` it is."""
        before = float(self.energy(*self.before))
        if tracing:
            told = self.power, self.count, before, self.is_free, self.own, self.shared, said, common, loud, kind, _ROOTS_M
            return tracing.likelier(*told).reshape(-1, *kind.shape)
        common = np.take_along_axis(common, kind[None], axis=0)[0]
        each = [
            self.energy(self.own[kind] + root_m**2 * loud + 2 * root_m * common, self.shared[kind] + root_m * said)
            for root_m in _ROOTS_M
        ]
        return (before - np.array(each)).astype(np.float32)
