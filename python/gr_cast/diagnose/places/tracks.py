# SPDX-License-Identifier: GPL-3.0-or-later
"""Where something passes by: coarsely by how late its echoes are, then by their phases, instant after instant, along a line."""

import itertools
from dataclasses import replace

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S
from ...scenario.create import fields
from . import imaging, scan
from .ears import thinned
from .fit import evaluated

_KEPT, _LINES = 3, 8  # coarse tracks, and lines near one of them, that are returned
_FOLLOWED = 2  # coarse tracks about which is looked finely
_REACH_M, _MOST = 2.0, 160  # about a coarse track; steps across at most
_FINE = 6  # steps of a wavelength
_FINER = 16  # of the grid of delays over the resolution of the band
_INSTANTS = 9  # that are looked at, at most
_PAIRS, _PEAKS = 4, 12  # of instants, and places at each, through which lines are drawn
_LOUD = 3.0  # times the median: rows with more energy are shadows' and count as this


def passers(view, height_m: float):
    """(place (2,) at time 0, velocity (2,)) of things that would explain echoes that move, the best first."""
    if not view.wideband:
        return []
    coarse = _coarse(
        view, [imaging.echoes(ear, _moving(ear, fit, view.world), view.world) for ear, fit in view.wideband], height_m
    )
    fine = [track for one in coarse[:_FOLLOWED] for track in _fine(view, height_m, *one)]
    return [track for _, track in sorted(fine, key=lambda pair: -pair[0])] + coarse


def _moving(ear, fit, world):
    """A fit with what is left that changes: what stays the same between ends that stay is no passer's."""
    residual = fit.residual.copy()
    for index in range(len(ear.heard.links)):
        if not any(np.ptp(end_m, axis=0).any() for end_m in ear.predictor.ends_m(world, index)):
            factor, weight = fit.factor[index], ear.heard.weight[index]
            power = (np.abs(factor) ** 2 * weight).sum(axis=0)
            mean = (residual[index] * factor.conj() * weight).sum(axis=0) / np.maximum(power, 1e-300)
            residual[index] -= np.where(weight > 0, factor * mean, 0)
    return replace(fit, residual=residual)


def _coarse(view, seen: list, height_m: float) -> list:
    low, high = view.bounds_m
    resolution_m = SPEED_OF_LIGHT_M_PER_S / seen[0].bins_per_s
    step_m = float(np.clip(resolution_m * 2, 0.25, 1.0))
    step_m = max(step_m, float((high - low)[:2].max()) / 60)
    x, y = (np.arange(low[axis] - 2, high[axis] + 2, step_m) for axis in (0, 1))
    foot = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    speeds = np.arange(-2.0, 2.01, 0.4)
    velocity = np.array([(a, b) for a in speeds for b in speeds if np.hypot(a, b) <= 2.4])
    scores = imaging.passer_scores(seen, foot, velocity, height_m)
    found = []
    for _ in range(_KEPT):
        p, v = np.unravel_index(np.argmax(scores), scores.shape)
        fine_p = foot[p] + step_m * 0.5 * np.array([(a, b) for a in (-1, -0.5, 0, 0.5, 1) for b in (-1, -0.5, 0, 0.5, 1)])
        fine_v = velocity[v] + 0.2 * np.array([(a, b) for a in (-1, -0.5, 0, 0.5, 1) for b in (-1, -0.5, 0, 0.5, 1)])
        fine = imaging.passer_scores(seen, fine_p, fine_v, height_m)
        i, j = np.unravel_index(np.argmax(fine), fine.shape)
        found.append((fine_p[i], fine_v[j]))
        scores[np.linalg.norm(foot - foot[p], axis=1) < 1.5] = -np.inf
    return found


def _fine(view, height_m: float, place_m: np.ndarray, velocity: np.ndarray) -> list:
    """(nats, track) of lines near a coarse track along which echoes have the phase that they should."""
    ear = thinned(view.wideband[0][0], _INSTANTS, len(view.wideband[0][0].heard.frequency_hz))
    fit = _moving(ear, evaluated([ear], view.model.base, view.model.effects).fits[0], view.world)
    time_s = ear.predictor.time_s
    step_m = max(view.world.wavelength_m / _FINE, 2 * _REACH_M / _MOST)
    axis_m = np.arange(-_REACH_M, _REACH_M + step_m / 2, step_m)
    offset_m = np.stack(np.meshgrid(axis_m, axis_m, indexing="ij"), axis=-1)
    maps = [_map(view, ear, fit, step, place_m + velocity * t + offset_m, height_m) for step, t in enumerate(time_s)]
    tops = np.array([one.max() for one in maps])
    pairs = sorted(itertools.combinations(range(len(maps)), 2), key=lambda pair: -tops[list(pair)].min())[:_PAIRS]
    tracks = []
    for first, last in pairs:
        ends = [np.array(scan.minima_2d(axis_m, axis_m, -maps[step], _PEAKS)) for step in (first, last)]
        for a, b in itertools.product(*ends):
            turn = (b - a) / (time_s[last] - time_s[first])
            cell = np.round((a + np.multiply.outer(time_s - time_s[first], turn) + _REACH_M) / step_m).astype(int)
            inside = ((cell >= 0) & (cell < len(axis_m))).all(axis=1)
            nats = sum(one[tuple(where)] for one, where, good in zip(maps, cell, inside, strict=True) if good)
            tracks.append((float(nats), (place_m + a - turn * time_s[first], velocity + turn)))
    return sorted(tracks, key=lambda pair: -pair[0])[:_LINES]


def _map(view, ear, fit, step: int, foot_m: np.ndarray, height_m: float) -> np.ndarray:
    """Nats of an echo from each place (X, Y, 2) at one instant: of all links together, its strength free, its phase known."""
    heard, world = ear.heard, view.world
    f_hz = heard.frequency_hz
    spacing_hz, size = f_hz[1] - f_hz[0], 1 << int(np.ceil(np.log2(_FINER * len(f_hz))))
    energy = (np.abs(fit.residual[:, step]) ** 2 * heard.weight[:, step]).sum(axis=1)
    loud = _LOUD * max(float(np.median(energy)), 1.0)
    centre_m = np.concatenate([foot_m, np.full((*foot_m.shape[:2], 1), height_m)], axis=2)
    cross, power = np.zeros(foot_m.shape[:2]), np.full(foot_m.shape[:2], 1e-300)
    for index, link in enumerate(heard.links):
        ends_m = [end[step] for end in ear.predictor.ends_m(world, index)]
        legs = [centre_m - ends_m[0], ends_m[1] - centre_m]
        far_m = [np.maximum(np.linalg.norm(leg, axis=2), 0.1) for leg in legs]
        strength = 1 / (far_m[0] * far_m[1])
        for name, leg, long_m, sign in zip(link, legs, far_m, (1, -1), strict=True):
            direction = (sign * leg / long_m[..., None]).reshape(-1, 3)
            strength = strength * np.linalg.norm(fields.far_field(world.radios[name].antenna, direction), axis=1).reshape(
                long_m.shape
            )
        factor = fit.factor[index, step] * ear.predictor.cables(world, index)
        weight = heard.weight[index, step] * min(1.0, loud / max(energy[index], 1e-300))
        profile = np.fft.ifft(fit.residual[index, step] * weight * factor.conj(), size) * size
        delay_s = (far_m[0] + far_m[1]) / SPEED_OF_LIGHT_M_PER_S
        total = profile[np.round(delay_s * spacing_hz * size).astype(int) % size]
        total = total * np.exp(2j * np.pi * np.mod((world.carrier_hz + f_hz[0]) * delay_s, 1.0))
        cross += strength * total.real
        power += strength**2 * (np.abs(factor) ** 2 * weight).sum()
    return np.maximum(cross, 0) ** 2 / power
