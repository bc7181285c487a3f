# SPDX-License-Identifier: GPL-3.0-or-later
"""Where something passes by: coarsely by how late its echoes are, then with what it hides, instant after instant."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S
from ...scenario.create.images import tracing
from . import imaging, passages, policy

_SPEEDS_M_PER_S, _SPEED_STEP_M_PER_S, _SPEEDS = (2.4, 30.0), 0.4, 60  # that are looked for; steps at most
_ELSEWHERE_M = 1.5  # between coarse tracks
_KEPT = 3  # coarse tracks that are returned
_FOLLOWED, _KEPT_WAYS = 2, 10  # coarse tracks of echoes about which is looked finely; ways that are returned
_KEPT_AGAIN = 10  # ways that are returned of each fit beside whom is known to pass
_RADII_M, _WIDER = (0.2, 0.3), (1.0, 1.2)  # of bodies about tracks of echoes; times that of one which hides something


def passers(view, height_m: float, hiding: Sequence) -> tuple[list[passages.Way], list[tuple]]:
    """Ways of what passes, the best first, about those along which echoes are as late as they should be and about those (place at
    time 0, velocity, radius) that hide what is missing; and the former."""
    if (ear := _followed(view)) is None:
        return [], []
    coarse = _coarse(view, moving_echoes(view), height_m)
    about = [(*one, _RADII_M) for one in coarse[:_FOLLOWED]]
    about += [(*way, [radius_m * one for one in _WIDER]) for *way, radius_m in hiding[:1]]
    if passages.is_wide(view.world):  # in wavelengths: it takes long
        about = [(*way, [np.mean(radii_m)]) for *way, radii_m in about]
    found = [way for one in about for way in passages.ways(view, ear, height_m, *one) if way.nats > 0]
    return sorted(found, key=lambda way: -way.nats)[:_KEPT_WAYS], coarse


def again(view, height_m: float, place_m: np.ndarray, velocity: np.ndarray, radii_m: Sequence[float]) -> list[passages.Way]:
    """Ways near that of whom the model has passing by, where what it leaves changes."""
    if (ear := _followed(view)) is None:
        return []
    found = passages.ways_again(view, ear, height_m, place_m, velocity, radii_m)
    return [way for some in found for way in sorted(some, key=lambda way: -way.nats)[:_KEPT_AGAIN]]


def _followed(view):
    """The campaign in which most changes; None where next to nothing of what is left does."""
    if not (pairs := _pairs(view)) or moving_nats(view) < policy.BEHIND_SHARE * view.model.left_nats(view.count):
        return None
    return max(pairs, key=lambda pair: _nats(view, *pair))[0]


def moving_echoes(view) -> list[imaging.Echoes]:
    """Of the campaigns of several instants, without what stays the same."""
    return [imaging.echoes(ear, _moving(ear, fit, view.world), view.world) for ear, fit in _pairs(view)]


def moving_nats(view) -> float:
    """Of what is left above noise, what changes: all that anything which passes can explain. What stays the same has taken its
    share of the noise, no more of it than a mean would."""
    return sum(_nats(view, *pair) for pair in _pairs(view))


def _nats(view, ear, fit) -> float:
    """The same of one campaign."""
    instants = np.maximum(ear.heard.known.any(axis=2).sum(axis=1), 1)
    stands = [_stands(ear, index, view.world) for index in range(len(instants))]
    noise = ear.heard.known.sum(axis=(1, 2)) * np.where(stands, 1 - 1 / instants, 1.0)
    return float((ear.nats(_moving(ear, fit, view.world)) - noise).sum())


def _stands(ear, index: int, world) -> bool:
    """Whether both ends of a link stay where they are."""
    return not any(np.ptp(end_m, axis=0).any() for end_m in ear.predictor.ends_m(world, index))


def _pairs(view) -> list:
    return [(ear, fit) for ear, fit in view.wideband if np.ptp(ear.predictor.time_s) > 0]


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
