# SPDX-License-Identifier: GPL-3.0-or-later
"""Where something passes by: by the paths that it hides, whatever its echoes are."""

import itertools
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S
from ...twin.places import passer
from . import tracks
from .ears import evenly, undisturbed_fit
from .likelihood import tempered

_ROWS = 240  # responses of a campaign that are looked at
_PATHS, _TONES = 6, 12  # of a response, the strongest
_LEAST_NATS = 1.0  # of a path: less is no reason for someone in its way, nor against
_CELL_M, _CELLS = 0.15, 60  # of the floor; to a side, at most
_RADIUS_M, _RADII_M = 0.25, (0.14, 0.17, 0.2, 0.23, 0.27, 0.32, 0.4, 0.55, 0.75, 1.0)  # of bodies: to begin with, and tried
_BEGUN, _KEPT = 6, 3  # lines that are moved to where they explain most, and that are returned
_STEPS_M = (0.15, 0.07, 0.03, 0.015)  # by which both ends of a line are moved
_MOVED = 6  # times by each of them, at most
_ELSEWHERE_M = 0.7  # between beginnings of lines


@dataclass(frozen=True, eq=False, kw_only=True)
class _Rows:
    """Responses (R,) of `count` numbers with `heard` nats, of which those that are `free` have unknown phases. What is predicted
    has `power`, and `told` in common with what was heard; of its paths (R, P) by way of `points_m` (R, P, D + 2, 3) the same with
    what is predicted, `shared`, with what was heard, `cross`, and with each other, `gram` (R, P, P)."""

    time_s: np.ndarray
    count: np.ndarray
    free: np.ndarray
    heard: np.ndarray
    power: np.ndarray
    told: np.ndarray
    shared: np.ndarray
    cross: np.ndarray
    gram: np.ndarray
    points_m: np.ndarray

    def at(self, which) -> "_Rows":
        return _Rows(**{one.name: getattr(self, one.name)[which] for one in fields(self)})

    def energy(self, dark: np.ndarray) -> np.ndarray:
        """(C, R), at least as noise has it, where some paths (C, R, P) are not there."""
        power = self.power - 2 * np.einsum("crp,rp->cr", dark, self.shared)
        power += np.einsum("rcp,crp->cr", dark.transpose(1, 0, 2) @ self.gram, dark)
        told = self.told - np.einsum("crp,rp->cr", dark, self.cross)
        return np.maximum(self.heard + power - 2 * np.where(self.free, np.abs(told), told.real), self.count)

    @cached_property
    def _before(self) -> np.ndarray:
        """(1, R) where all are there."""
        return tempered(self.energy(np.zeros((1, *self.cross.shape))), self.count)

    def nats(self, foot_m: np.ndarray, radius_m: float) -> np.ndarray:
        """(C, R): by which each response is likelier with someone at `foot_m` (C, R, 2)."""
        feet_m = np.concatenate([foot_m, np.zeros((*foot_m.shape[:2], 1))], axis=2)
        dark = passer.shaded(radius_m, passer.HEIGHT_M, feet_m, self.points_m).astype(float)
        return self._before - tempered(self.energy(dark), self.count)

    def along(self, place_m: np.ndarray, velocity: np.ndarray, radius_m: float) -> np.ndarray:
        """(C,): the same of all responses, of someone at `place_m` (C, 2) at time 0 who goes at `velocity` (C, 2)."""
        return self.nats(place_m[:, None] + self.time_s[:, None] * velocity[:, None], radius_m).sum(axis=1)


@dataclass(frozen=True, eq=False, kw_only=True)
class Hidden:
    """What paths may be hidden, and what someone at each place of the floor would say at each of `times`: `maps` (T, X, Y)."""

    rows: _Rows
    times: np.ndarray
    extent_m: float
    step_m: float
    x_m: np.ndarray
    y_m: np.ndarray
    maps: np.ndarray

    @classmethod
    def of(cls, view) -> "Hidden | None":
        """None where no path counts at several instants."""
        rows = _rows(view)
        if rows is None:
            return None
        low, high = view.bounds_m
        extent_m = max(float((high - low)[:2].max()), _CELL_M)
        step_m = max(_CELL_M, extent_m / _CELLS)
        x_m, y_m = (np.arange(low[axis], high[axis] + step_m, step_m) for axis in (0, 1))
        floor = {"extent_m": extent_m, "step_m": step_m, "x_m": x_m, "y_m": y_m}
        found = cls(rows=rows, times=np.unique(rows.time_s), **floor, maps=np.zeros(0))
        return replace(found, maps=np.array([found._map(rows.at(rows.time_s == time_s)) for time_s in found.times]))

    @property
    def foot_m(self) -> np.ndarray:
        """(X·Y, 2)"""
        return np.stack(np.meshgrid(self.x_m, self.y_m, indexing="ij"), axis=-1).reshape(-1, 2)

    def _map(self, now: _Rows) -> np.ndarray:
        foot_m = np.broadcast_to(self.foot_m[:, None], (len(self.x_m) * len(self.y_m), len(now.count), 2))
        return now.nats(foot_m, _RADIUS_M).sum(axis=1).reshape(len(self.x_m), -1)


def lines(hidden: "Hidden | None") -> list[tuple[np.ndarray, np.ndarray, float]]:
    """(place (2,) at time 0, velocity (2,), radius in m) of upright bodies that hide what is missing and little else, the best
    first."""
    if hidden is None:
        return []
    search = _Search(hidden=hidden)
    settled = sorted((search.settled(ends_m) for ends_m in search.coarse()), key=lambda one: -one[0])
    return [(*search.line(ends_m), radius_m) for nats, ends_m, radius_m in settled[:_KEPT] if nats > 0]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Search:
    """For lines (2, 2) from where they are at the first response to where they are at the last."""

    hidden: Hidden

    def line(self, ends_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (..., 2) at time 0 and velocities of lines (..., 2, 2)."""
        times = self.hidden.times
        velocity = (ends_m[..., 1, :] - ends_m[..., 0, :]) / max(np.ptp(times), 1e-9)
        return ends_m[..., 0, :] - velocity * times[0], velocity

    def hides(self, ends_m: np.ndarray, radius_m: float) -> np.ndarray:
        """Nats (C,) of lines (C, 2, 2) by what they hide."""
        return self.hidden.rows.along(*self.line(ends_m), radius_m)

    def settled(self, ends_m: np.ndarray) -> tuple[float, np.ndarray, float]:
        """A line moved, and made wider or narrower, to where it explains most."""
        moves = np.array(list(itertools.product((-1, 0, 1), repeat=4))).reshape(-1, 2, 2)
        radius_m, nats = _RADIUS_M, -np.inf
        for step_m in _STEPS_M:
            for _ in range(_MOVED):
                near = ends_m + step_m * moves
                ends_m = near[int(np.argmax(self.hides(near, radius_m)))]
                widths = [float(self.hides(ends_m[None], one)[0]) for one in _RADII_M]
                radius_m = _RADII_M[int(np.argmax(widths))]
                if max(widths) <= nats:
                    break
                nats = max(widths)
        return nats, ends_m, radius_m

    def coarse(self) -> list[np.ndarray]:
        """Lines across a grid of the floor that explain most, apart from each other."""
        hidden, times, step_m = self.hidden, self.hidden.times, self.hidden.step_m
        foot_m = hidden.foot_m
        speeds = np.arange(-1, 1.001, 2 * step_m / hidden.extent_m) * hidden.extent_m / max(np.ptp(times), 1e-9)
        velocity = np.array([(a, b) for a in speeds for b in speeds if np.hypot(a, b) <= speeds[-1]])
        scores = tracks.summed(hidden.maps, np.round((times - times[0])[:, None] * velocity[:, None] / step_m).astype(int))
        found = []
        for _ in range(_BEGUN):
            v, p = np.unravel_index(np.argmax(scores), scores.shape)
            found.append(np.stack([foot_m[p], foot_m[p] + velocity[v] * np.ptp(times)]))
            scores[:, np.linalg.norm(foot_m - foot_m[p], axis=1) < _ELSEWHERE_M] = -np.inf
        return found


def _rows(view) -> _Rows | None:
    """Responses at several instants, with the paths that count."""
    found = []
    for ear in view.ears:
        if not ear.has_responses or len(ear.predictor.time_s) < 2:
            continue
        heard, predictor, fit = ear.heard, ear.predictor, undisturbed_fit(ear, view.world)
        tones = evenly(len(heard.frequency_hz), _TONES)
        steps = evenly(len(predictor.time_s), max(2, _ROWS // len(heard.links)))
        more = len(heard.frequency_hz) / len(tones)
        for index in range(len(heard.links)):
            table = passer.at_all_instants(predictor.path_table(view.world, index), len(predictor.time_s))
            points_m, instant, gain, length_m, _ = table
            cables = predictor.cables(view.world, index)[tones]
            for step in steps:
                weight = heard.weight[index, step, tones]
                if not weight.any():
                    continue
                own = np.flatnonzero((instant == step) & (gain != 0))
                own = own[np.argsort(-np.abs(gain[own]))[:_PATHS]]
                root = np.sqrt(more * weight)
                factor = fit.factor[index, step, tones] * cables * root
                turned = np.outer(length_m[own] / SPEED_OF_LIGHT_M_PER_S, view.world.carrier_hz + heard.frequency_hz[tones])
                paths = gain[own, None] * np.exp(-2j * np.pi * turned) * factor
                paths = paths[(np.abs(paths) ** 2).sum(axis=1) > _LEAST_NATS]
                y, model = heard.y[index, step, tones] * root, fit.model[index, step, tones] * root
                count = (heard.weight[index, step] > 0).sum()
                found.append(
                    dict(
                        time_s=predictor.time_s[step], count=count, free=heard.phase == "snapshot",
                        heard=(np.abs(y) ** 2).sum(), power=(np.abs(model) ** 2).sum(), told=model.conj() @ y,
                        shared=(paths.conj() @ model).real, cross=paths.conj() @ y, gram=(paths.conj() @ paths.T).real,
                        points_m=points_m[own][: len(paths)],
                    )
                )  # fmt: skip
    paths = max((len(one["cross"]) for one in found), default=0)
    if not paths:
        return None
    corners = max(one["points_m"].shape[1] for one in found)
    return _Rows(**{name: np.array([_padded(one[name], paths, corners) for one in found]) for name in found[0]})


def _padded(value, paths: int, corners: int):
    """What is told of each of so many paths: the missing ones have no strength and go nowhere."""
    if np.ndim(value) == 3:
        value = np.concatenate([value, np.repeat(value[:, -1:], corners - value.shape[1], axis=1)], axis=1)
        return np.concatenate([value, np.full((paths - len(value), corners, 3), 1e6)])
    return np.pad(value, [(0, paths - len(value))] * np.ndim(value)) if np.ndim(value) else value
