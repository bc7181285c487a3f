# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes whose shadow is known and leaves their outline open: sides where echoes have them, as large as shadow and echoes have
it together."""

import itertools
from dataclasses import dataclass

import numpy as np

from ...twin.places.families.additions import Sheet
from .coherent import Phased
from .ears import evenly
from .shades import Ways

_ROWS = 200  # of soundings that are asked, and the loudest
_LOUD, _LEAST_NATS = 6, 20.0  # rows whose echoes are asked for their planes, and what such an echo is worth
_TURNS = 240  # of a side, all around: of a box a quarter of them
_WELLS = 16  # levels to a wavelength, within half of one of where an echo's delay has a side
_BEYOND_M = 1.5  # of the box, where an echo may be met
_MADE = (
    (1.0, 1e7),
    (1.8, 0.01),
    (2.7, 0.02),
    (3.9, 0.03),
    (5.3, 0.06),
    (7.0, 0.06),
    (10.0, 0.03),
)  # permittivity, S/m: of metal, others
_WALL_M = 0.1  # thickness of sides
_OUTLINED, _KEPT = 6, 3  # boxes that are drawn in full, and that are returned
_ENDS_M, _DEPTHS_M, _TOPS_M = (0.3, 0.8, 1.5), (0.4, 1.2, 2.4, 4.0), (-1.0, -0.3, 0.0, 0.5)  # of boxes to begin with
_SCALES_M, _FIRST = (1.0, 0.5, 0.25, 0.12, 0.5, 0.25, 0.12, 0.05), 2
_THIN_M = 0.05


def sides(beside, box: Sheet, ways: Ways) -> list[tuple[Sheet, tuple[float, float]]]:
    """Boxes, and permittivity and conductivity (S/m) of each, in place of one that blocks what is to be blocked, `beside` which
    echoes are left; the best first."""
    if not beside.wideband:
        return []
    rows, middle_m = _asked(beside.phased), box.corners_m()[:2].mean(axis=0) + box.depth_m / 2 * np.array(box.normal)
    reach_m = float(np.hypot(box.depth_m, box.high_m[0] - box.low_m[0])) / 2 + _BEYOND_M
    begun = []
    for normal, level_m in _planes(rows, middle_m, reach_m):
        outline = _Outline(rows=rows, ways=ways, normal=normal, level_m=level_m)
        begun.append((outline, *outline.settled(outline.begun(box), _SCALES_M[:_FIRST])))
    begun.sort(key=lambda one: -one[2])
    found = [(outline, *outline.settled(ends[None], _SCALES_M)) for outline, ends, _ in begun[:_OUTLINED]]
    found.sort(key=lambda one: -one[2])
    return [(outline.sheet(ends), outline.made(ends)) for outline, ends, _ in found[:_KEPT]]


def _asked(rows: Phased) -> Phased:
    """Not too many, and the loudest among them."""
    loudest = np.argsort(-rows.every_nats().max(axis=1))[:_LOUD]
    return rows.taken(np.union1d(loudest, evenly(len(rows.power), _ROWS)))


def _levels_m(rows: Phased, inward: np.ndarray) -> np.ndarray:
    """(K, N) of sides with normals (N, 3) into their boxes, where the loudest echoes would be theirs."""
    nats, length_m = rows.every_nats(), rows.length_m
    apart_m = np.linalg.norm(rows.tx_m - rows.rx_m, axis=1)
    nats[length_m < apart_m[:, None]] = 0.0
    loud = np.argsort(-nats.max(axis=1))[:_LOUD]
    loud = loud[nats[loud].max(axis=1) > _LEAST_NATS]
    longest_m, apart_m = length_m[np.argmax(nats[loud], axis=1)], apart_m[loud]
    before, after = rows.tx_m[loud] @ inward.T, rows.rx_m[loud] @ inward.T
    middle = (before + after) / 2 + np.sqrt((before - after) ** 2 + (longest_m**2 - apart_m**2)[:, None]) / 2
    near_m = rows.wavelength_m / _WELLS * np.arange(-_WELLS // 2, _WELLS // 2 + 1)
    return (middle[:, None] + near_m[:, None]).reshape(-1, len(inward))


def _planes(rows: Phased, middle_m: np.ndarray, reach_m: float) -> list[tuple[np.ndarray, float]]:
    """(normal into a box, level) of the upright side near a place whose echoes explain most of those met there, of boxes turned
    each way."""
    angle_rad = 2 * np.pi * np.arange(_TURNS) / _TURNS
    inward = np.column_stack([np.cos(angle_rad), np.sin(angle_rad), np.zeros(_TURNS)])
    levels_m = _levels_m(rows, inward)
    row, turn = np.nonzero(np.abs(levels_m - inward @ middle_m) < reach_m)
    normals, levels_m = inward[turn], levels_m[row, turn]
    nats = np.concatenate([_seen_nats(rows, *part, middle_m, reach_m) for part in rows.parts(normals, levels_m)])
    best = {int(turn[number] % (_TURNS // 4)): number for number in np.argsort(nats) if nats[number] > _LEAST_NATS}
    return [(normals[number], float(levels_m[number])) for number in best.values()]


def _seen_nats(rows: Phased, normals: np.ndarray, levels_m: np.ndarray, middle_m: np.ndarray, reach_m: float) -> np.ndarray:
    """Nats (P,) of the echoes that sides, of what suits each best, send from near a place to the rows that want them."""
    near = np.linalg.norm((rows.met_m(normals, levels_m) - middle_m)[..., :2], axis=2) < reach_m
    near &= rows.tx_m @ normals.T < levels_m
    told = np.where(near, rows.made_nats(normals, levels_m, _MADE, _WALL_M), 0.0)
    return np.maximum(told, 0.0).sum(axis=1).max(axis=0)


@dataclass(frozen=True, kw_only=True)
class _Outline:
    """A box with a side on a plane, of which the ends (n, 4) are open: low and high along u, depth, top (m)."""

    rows: Phased
    ways: Ways
    normal: np.ndarray
    level_m: float

    @property
    def u(self) -> np.ndarray:
        return np.array([self.normal[1], -self.normal[0], 0.0])

    def begun(self, box: Sheet) -> np.ndarray:
        """Ends to begin with: about the middle of a box, and about where the side's best echo is met."""
        low, high = np.sort(box.corners_m()[:2] @ self.u + box.depth_m / 2 * (np.array(box.normal) @ self.u))
        side = self.normal[None], np.array([self.level_m])
        told = self.rows.made_nats(*side, _MADE, _WALL_M).max(axis=0)
        lit = self.rows.met_m(*side)[np.argmax(told), 0] @ self.u
        top_m = box.high_m[1] + self.ways.floor_m
        every = itertools.product((lit, (low + high) / 2), _ENDS_M, _ENDS_M, _DEPTHS_M, _TOPS_M)
        return np.array([[at - before, at + after, deep_m, top_m + up] for at, before, after, deep_m, up in every])

    def nats(self, ends: np.ndarray) -> np.ndarray:
        """Of what boxes block, and of the echoes that their upright sides send, of what suits them best."""
        low, high, depth, top = ends.T
        middle = (self.level_m + depth / 2)[:, None] * self.normal + ((low + high) / 2)[:, None] * self.u
        turned = np.full(len(ends), np.arctan2(self.u[1], self.u[0]))
        return self.ways.nats(np.column_stack([middle[:, :2], turned, high - low, depth, top])) + self._told(ends).max(axis=0)

    def made(self, ends: np.ndarray) -> tuple[float, float]:
        return _MADE[int(np.argmax(self._told(ends[None])[:, 0]))]

    def _told(self, ends: np.ndarray) -> np.ndarray:
        """Nats (M, n) of the echoes of all upright sides, of each material."""
        low, high, depth, top = ends.T
        level, u, normal = np.full(len(ends), self.level_m), self.u, self.normal
        across, along = (u, low, high, top), (normal, level, level + depth, top)
        sides = (normal, level, *across), (-normal, -(level + depth), *across), (u, low, *along), (-u, -high, *along)
        return sum(self._sent(*side) for side in sides)

    def _sent(self, inward, level, along, low, high, top) -> np.ndarray:
        """Nats (M, n) of the echoes of sides between ends along a direction, of each material."""
        levels, which = np.unique(level, return_inverse=True)
        normals = np.broadcast_to(inward, (len(levels), 3))
        met = self.rows.met_m(normals, levels)
        at, up = (met @ along)[:, which], met[:, which, 2]
        lit = (self.rows.tx_m @ inward[:, None] < level) & (at > low) & (at < high) & (up > self.ways.floor_m) & (up < top)
        return np.where(lit, self.rows.made_nats(normals, levels, _MADE, _WALL_M)[..., which], 0.0).sum(axis=1)

    def settled(self, ends: np.ndarray, scales_m) -> tuple[np.ndarray, float]:
        """The best of some ends, and then one end after the other, with sides where echoes have them as well; and its nats."""
        sides = _levels_m(self.rows, np.array([self.u, -self.u, -self.normal]))
        phased = sides[:, 0], -sides[:, 1], -sides[:, 2] - self.level_m, np.zeros(0)
        at, best = self._best(ends)
        for scale_m in scales_m:
            for number in range(4):
                moved = np.concatenate([at[number] + scale_m * np.array([-2, -1, 1, 2]), phased[number]])
                trials = np.repeat(at[None], len(moved), axis=0)
                trials[:, number] = moved
                there, nats = self._best(trials)
                at, best = (there, nats) if nats > best else (at, best)
        return at, best

    def _best(self, ends: np.ndarray) -> tuple[np.ndarray, float]:
        low, high, depth, top = ends.T
        ends = ends[(high - low > _THIN_M) & (depth > _THIN_M) & (top > self.ways.floor_m + _THIN_M)]
        if not len(ends):
            return np.zeros(4), -np.inf
        nats = self.nats(ends)
        return ends[np.argmax(nats)], float(nats.max())

    def sheet(self, ends: np.ndarray) -> Sheet:
        low, high, depth, top = (float(number) for number in ends)
        origin = self.level_m * self.normal + (low + high) / 2 * self.u + np.array([0, 0, self.ways.floor_m])
        return Sheet(
            origin_m=tuple(origin), normal=tuple(self.normal), u=tuple(self.u), v=(0.0, 0.0, 1.0),
            low_m=((low - high) / 2, 0.0), high_m=((high - low) / 2, top - self.ways.floor_m), depth_m=depth,
        )  # fmt: skip
