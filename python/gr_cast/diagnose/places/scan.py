# SPDX-License-Identifier: GPL-3.0-or-later
"""Coarse searches over numbers whose energy has a minimum every wavelength: paths keep strengths, phases turn."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import minimum_filter

from ...core.units import SPEED_OF_LIGHT_M_PER_S
from ...scenario.create.images import tracing
from .ears import ResponseEar, evenly
from .likelihood import Fitted, tempered

_ROWS, _TONES = 40, 12  # of a sounding that a scan looks at: a guess needs no more
_AT_ONCE = 4_000  # numbers that are looked at together: more leave a core's memory
_SOUNDED, _FINER = 4, 8  # wells whose bottoms are looked for, for each that is wanted; how much finer


@dataclass(frozen=True, kw_only=True)
class Row:
    """One response: paths that turn (n, K) at `rates` (axes, n, K) rad per unit, what stays (K,), data and weights (K,)."""

    base: np.ndarray
    rates: np.ndarray
    rest: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    is_free: bool  # its phase is unknown
    most: float = np.inf  # energy that it may do with where what turns is not there

    @cached_property
    def over_noise(self) -> tuple:
        """Base, rates, rest, what was heard, conjugate, and `is_free`, all amplitudes over the noise: powers of amplitudes alone
        are less than single precision holds."""
        root = np.sqrt(self.weight)
        return root * self.base, self.rates, root * self.rest, root * self.y.conj(), self.is_free


def rows(ear: ResponseEar, fit: Fitted, world, rates_of, without=None) -> list[Row]:
    """Rows of a sounding whose paths are turned by `rates_of(link)` → (axes, n, 2): metres of length and of its part that shows
    in the band, per unit; None where a link is not touched. Each may be as in the world `without` what turns, if one is given."""
    heard, predictor = ear.heard, ear.predictor
    touched = {index: rates for index in range(len(heard.links)) if (rates := rates_of(index)) is not None}
    out = []
    per_link = max(2, _ROWS // max(len(touched), 1))
    columns = evenly(len(heard.frequency_hz), _TONES)
    f_hz = heard.frequency_hz[columns]
    for index, rates in touched.items():
        table = predictor.path_table(world, index)
        instant, gain, way = table.instant, table.gain, table.way
        response = predictor.link_response(world, index)
        moves = gain != 0
        moves &= np.abs(rates).max(axis=(0, 2)) > 0
        still = instant.max(initial=0) == 0
        cables = predictor.cables(world, index)[columns]
        for step in (0,) if still else evenly(len(predictor.time_s), per_link):
            here = np.flatnonzero(moves & (instant == step))
            y, weight, factor = (_mean if still else _at)(heard, fit, index, step, columns)
            if not len(here) or not weight.any():
                continue
            tau_s = way.length_m[here] / SPEED_OF_LIGHT_M_PER_S
            base = gain[here, None] * np.exp(-2j * np.pi * (world.carrier_hz + f_hz) * tau_s[:, None]) * cables
            rate = (2 * np.pi / SPEED_OF_LIGHT_M_PER_S) * (
                world.carrier_hz * rates[:, here, :1] + f_hz[None, None] * rates[:, here, 1:]
            )
            less = None if without is None else predictor.link_response(without, index)[step, columns] * factor
            out.append(
                Row(
                    base=base * factor,
                    rates=rate,
                    rest=(response[step, columns] - base.sum(axis=0)) * factor,
                    y=y,
                    weight=weight,
                    is_free=heard.phase != "none",
                    most=np.inf if less is None else _left_by(less, y, weight, heard.phase != "none"),
                )  # fmt: skip
            )
    return out


def _left_by(model: np.ndarray, y: np.ndarray, weight: np.ndarray, is_free: bool) -> float:
    """Energy of one response (K,)."""
    cross = (y.conj() * model * weight).sum()
    along = np.abs(cross) if is_free else cross.real
    return float(((np.abs(y) ** 2 + np.abs(model) ** 2) * weight).sum() - 2 * along)


def _at(heard, fit: Fitted, index: int, step: int, columns):
    return heard.y[index, step, columns], heard.weight[index, step, columns], fit.factor[index, step, columns]


def _mean(heard, fit: Fitted, index: int, step: int, columns):
    """Of a still link: all instants as one, each turned as its fit is."""
    factor, weight = fit.factor[index][:, columns], heard.weight[index][:, columns]
    size = np.abs(factor)
    turned = heard.y[index][:, columns] * np.where(size > 0, factor, 1).conj() / np.where(size > 0, size, 1)
    total = weight.sum(axis=0)
    return (turned * weight).sum(axis=0) / np.where(total > 0, total, 1), total, size.mean(axis=0)


def energy(rows_: Sequence[Row], first: np.ndarray, second: np.ndarray, scale: np.ndarray | float | None = 1.0) -> np.ndarray:
    """Energy of all rows (2, len(first), len(second)) over the grid, tempered, for other causes may spoil some of them, and as it
    is; `scale`: by which all paths grow along it, None: by whatever suits each row."""
    return sum((_energy(row, (first, second), scale)[:, 0] for row in rows_), np.zeros((2, len(first), len(second)), np.float32))


def energy_in_space(rows_: Sequence[Row], first: np.ndarray, second: np.ndarray, third: np.ndarray) -> np.ndarray:
    """The same over three axes, (2, len(first), len(second), len(third))."""
    total = np.zeros((2, len(third), len(first), len(second)), np.float32)
    for row in rows_:
        total += _energy(row, (first, second, third), 1.0)
    return np.moveaxis(total, 1, 3)


def _energy(row: Row, axes: Sequence[np.ndarray], scale: np.ndarray | float | None) -> np.ndarray:
    """(2, levels of a third axis or 1, len(first), len(second)) of one row."""
    power, along = tracing.scanned(*row.over_noise, axes) if tracing else _scanned(*row.over_noise, axes)
    total, count = np.float32((np.abs(row.y) ** 2 * row.weight).sum()), np.float32((row.weight > 0).sum())
    if scale is None:
        over = total - np.maximum(along, 0) ** 2 / np.maximum(power, np.float32(1e-30))
    else:
        over = total + np.float32(scale) ** 2 * power - 2 * np.float32(scale) * along
    over = np.minimum(over, np.float32(row.most))
    return np.stack([tempered(over, count), over])


def _scanned(paths, rates, rest, heard, is_free: bool, axes: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(levels, len(first), len(second)) of both: power of the model at each place of a grid, and what of it lies along what was
    `heard`, conjugate; paths (n, K) turn at `rates` (axes, n, K)."""
    first, second, third = (*axes, [0.0])[:3]
    left = np.exp(-1j * (first[:, None] * rates[0].T[:, None]))
    right = np.exp(-1j * (rates[1].T[:, :, None] * second)).astype(np.complex64)
    shape = len(third), len(first), len(second)
    power, cross = np.zeros(shape, np.float32), np.zeros(shape, np.complex64)
    at_once = max(1, _AT_ONCE // (len(first) * len(second)))
    for level, by in enumerate(third):
        turned = (paths * np.exp(-1j * by * rates[2]) if len(axes) > 2 else paths).T[:, None]
        for begin in range(0, len(rest), at_once):
            part = slice(begin, begin + at_once)
            model = (turned[part] * left[part]).astype(np.complex64) @ right[part]
            model += rest[part, None, None].astype(np.complex64)
            power[level] += (model.real**2 + model.imag**2).sum(axis=0)
            model *= heard[part, None, None].astype(np.complex64)
            cross[level] += model.sum(axis=0)
    return power, np.abs(cross) if is_free else cross.real


def energy_along(rows_: Sequence[Row], grid: np.ndarray, scale: np.ndarray | float | None = 1.0) -> np.ndarray:
    """`energy` over one grid of equal steps (2, len(grid)), `scale` of its length too: many steps at once are turned, then by
    those in between."""
    between = int(np.ceil(np.sqrt(len(grid))))
    step = grid[1] - grid[0] if len(grid) > 1 else 1.0
    coarse, fine = grid[::between], step * np.arange(between)
    if np.ndim(scale):
        scale = np.resize(scale, len(coarse) * between).reshape(len(coarse), between)
    return energy(_twice(rows_), coarse, fine, scale).reshape(2, -1)[:, : len(grid)]


def _twice(rows_: Sequence[Row]) -> list[Row]:
    """The same along one axis and, from there, along it again."""
    return [replace(row, rates=row.rates[[0, 0]]) for row in rows_]


def minima(grid: np.ndarray, energies: np.ndarray, best: int) -> list[float]:
    """Values of the grid at the lowest local minima, the lowest first; of several energies (..., n) by turns."""
    found = []
    for one in energies.reshape(-1, len(grid)):
        inner = np.flatnonzero((one[1:-1] <= one[:-2]) & (one[1:-1] <= one[2:])) + 1
        inner = inner if len(inner) else np.array([int(np.argmin(one))])
        found.append([float(grid[i]) for i in inner[np.argsort(one[inner])][:best]])
    return by_turns(*found)[:best]


def wells(rows_: Sequence[Row], grid: np.ndarray, best: int) -> list[float]:
    """Bottoms of the lowest minima of `energy_along` a grid, the lowest first: its steps turn phases so far that they do not tell
    which well is the deepest."""
    near = np.array(minima(grid, energy_along(rows_, grid), 2 * _SOUNDED * best))
    step = (grid[1] - grid[0]) * np.linspace(-1, 1, 2 * _FINER + 1)
    sounded = energy(_twice(rows_), near, step)
    bottom = near + step[sounded.argmin(axis=2)]
    return by_turns(*(one[np.argsort(nats)].tolist() for one, nats in zip(bottom, sounded.min(axis=2), strict=True)))[:best]


def bottoms(rows_: Sequence[Row], places: np.ndarray, most: float, rounds: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Bottoms (n, axes) of the wells that places lie in, and energies there (2, n) as `energy` has them: Gauss-Newton steps of no
    more than `most`, for which what leaves much has the say of its noise alone."""
    places = np.array(places, float)
    for _ in range(rounds):
        told = [_steps(row, places) for row in rows_]
        top, side = (sum(one[part] for one in told) for part in (0, 1))
        size = np.einsum("waa->wa", top)
        top += 1e-6 * size.max(axis=1)[:, None, None] * np.eye(places.shape[1]) + 1e-300 * np.eye(places.shape[1])
        step = np.linalg.solve(top, side[:, :, None])[:, :, 0]
        places = places + step * np.minimum(1.0, most / np.maximum(np.linalg.norm(step, axis=1), 1e-300))[:, None]
    left = [(_steps(row, places)[2], (row.weight > 0).sum()) for row in rows_]
    return places, sum(np.stack([tempered(one, count), one]) for one, count in left)


def _steps(row: Row, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal equations (n, axes, axes) and (n, axes) of a step from places (n, axes), and what a row leaves there (n,)."""
    told, count = row.over_noise, float((row.weight > 0).sum())
    return tracing.stepped(*told, places, count) if tracing else _stepped(*told, places, count)


def _stepped(
    base, rates, rest, heard, is_free: bool, places: np.ndarray, count: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    paths = base * np.exp(-1j * np.einsum("wa,apk->wpk", places, rates))
    model, y = paths.sum(axis=1) + rest, heard.conj()
    slopes = np.einsum("wpk,apk->wak", -1j * paths, rates)
    if is_free:
        y = y * np.exp(1j * np.angle((heard * model).sum(axis=1)))[:, None]
        along = (slopes * model.conj()[:, None]).imag.sum(axis=2, keepdims=True)
        power = (np.abs(model) ** 2).sum(axis=1)[:, None, None]
        slopes = slopes - 1j * model[:, None] * along / np.maximum(power, 1e-300)
    lacks = y - model
    left = (np.abs(lacks) ** 2).sum(axis=1)
    told = slopes.conj() * np.minimum(1.0, count / np.maximum(left, 1e-300))[:, None, None]
    return np.einsum("wak,wbk->wab", told, slopes).real, np.einsum("wak,wk->wa", told, lacks).real, left


def minima_of(axes: Sequence[np.ndarray], energies: np.ndarray, best: int) -> list[tuple[float, ...]]:
    """Places on a grid over several axes at the lowest local minima, the lowest first; of several energies by turns."""
    found = []
    for one in energies.reshape(-1, *map(len, axes)):
        is_low = one <= minimum_filter(one, 3, mode="nearest")
        if (lows := one[is_low]).size > best:  # on a plain each place is one
            is_low &= one <= np.partition(lows, best - 1)[best - 1]
        places = np.argwhere(is_low)
        places = places[np.argsort(one[tuple(places.T)])][:best]
        found.append([tuple(float(axis[number]) for axis, number in zip(axes, place, strict=True)) for place in places])
    return by_turns(*found)[:best]


def by_turns(*lists: Sequence) -> list:
    """The first of each list, the second of each, and so on; what stands in several of them once."""
    return list(dict.fromkeys(one for rank in itertools.zip_longest(*lists) for one in rank if one is not None))
