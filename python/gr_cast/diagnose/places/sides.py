# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes whose shadow is known and leaves their outline open: sides and tops where echoes have them, as large as shadow and echoes
have it together."""

import itertools
from dataclasses import dataclass, field

import numpy as np

from ...twin.places.families.additions import Sheet
from ...twin.places.families.objects import made_at
from .coherent import Phased
from .ears import evenly
from .shades import Ways

_ROWS = 200  # of soundings that are asked, and the loudest
_LOUD, _LEAST_NATS = 6, 20.0  # rows whose echoes are asked for their planes, and what such an echo is worth
_TURNS = 240  # of a side, all around: of a box a quarter of them
_WELLS = 16  # levels to a wavelength, within half of one of where an echo's delay has a side
_BEYOND_M = 5.0  # of the box, which may stand anywhere along what it blocks, where an echo may be met
_WALL_M = 0.1  # thickness of sides
_OPEN = 6  # turns of boxes none of whose sides an echo tells
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
    outlines = [_Outline(rows=rows, ways=ways, normal=normal, level_m=m) for normal, m in _planes(rows, middle_m, reach_m)]
    for normal in _turned(np.array(box.normal)):  # the top alone may send something: the sides then are where the shadow has them
        level_m = float(np.min(np.concatenate([box.corners_m(), box.corners_m(box.depth_m)]) @ normal))
        outlines.append(_Outline(rows=rows, ways=ways, normal=normal, level_m=level_m, is_open=True))
    begun = [(outline, *outline.settled(outline.begun(box), _SCALES_M[:_FIRST])) for outline in outlines]
    begun.sort(key=lambda one: -one[2])
    found = [(outline, *outline.settled(ends[None], _SCALES_M)) for outline, ends, _ in begun[:_OUTLINED]]
    found.sort(key=lambda one: -one[2])
    return [(outline.sheet(ends), outline.made(ends)) for outline, ends, _ in found[:_KEPT]]


def _turned(normal: np.ndarray) -> np.ndarray:
    """(n, 3) a quarter of all turns of a side, a few."""
    angle_rad = np.arctan2(normal[1], normal[0]) + np.pi / 2 * np.arange(_OPEN) / _OPEN
    return np.column_stack([np.cos(angle_rad), np.sin(angle_rad), np.zeros(_OPEN)])


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
    told = np.where(near, rows.made_nats(normals, levels_m, made_at(rows.carrier_hz), _WALL_M), 0.0)
    return np.maximum(told, 0.0).sum(axis=1).max(axis=0)


@dataclass(frozen=True, kw_only=True)
class _Outline:
    """A box with a side on a plane, of which the ends (n, 5) are open: low and high along u, depth, top, and, where it `is_open`,
    how far behind the plane the side is (m)."""

    rows: Phased
    ways: Ways
    normal: np.ndarray
    level_m: float
    is_open: bool = False
    known: dict = field(default_factory=dict)  # what sides send, by their normals and levels

    @property
    def u(self) -> np.ndarray:
        return np.array([self.normal[1], -self.normal[0], 0.0])

    def begun(self, box: Sheet) -> np.ndarray:
        """Ends to begin with: about the middle of a box, and about where the side's best echo is met."""
        low, high = np.sort(box.corners_m()[:2] @ self.u + box.depth_m / 2 * (np.array(box.normal) @ self.u))
        side = self.normal[None], np.array([self.level_m])
        told = self.rows.made_nats(*side, made_at(self.rows.carrier_hz), _WALL_M).max(axis=0)
        lit = self.rows.met_m(*side)[np.argmax(told), 0] @ self.u
        top_m = box.high_m[1] + self.ways.floor_m
        every = itertools.product((lit, (low + high) / 2), _ENDS_M, _ENDS_M, _DEPTHS_M, _TOPS_M)
        return np.array([[at - before, at + after, deep_m, top_m + up, 0.0] for at, before, after, deep_m, up in every])

    def nats(self, ends: np.ndarray) -> np.ndarray:
        """Of what boxes block, and of the echoes that their sides and tops send, of what suits them best."""
        low, high, depth, top, behind = ends.T
        middle = (self.level_m + behind + depth / 2)[:, None] * self.normal + ((low + high) / 2)[:, None] * self.u
        turned = np.full(len(ends), np.arctan2(self.u[1], self.u[0]))
        return self.ways.nats(np.column_stack([middle[:, :2], turned, high - low, depth, top])) + self._told(ends).max(axis=0)

    def made(self, ends: np.ndarray) -> tuple[float, float]:
        return made_at(self.rows.carrier_hz)[int(np.argmax(self._told(ends[None])[:, 0]))]

    def _told(self, ends: np.ndarray) -> np.ndarray:
        """Nats (M, n) of the echoes of all upright sides and of the top, of each material."""
        low, high, depth, top, behind = ends.T
        near, up, floor = self.level_m + behind, np.array([0.0, 0.0, 1.0]), np.full(len(ends), self.ways.floor_m)
        along, deep, high_up = (self.u, low, high), (self.normal, near, near + depth), (up, floor, top)
        sides = (self.normal, near, along, high_up), (-self.normal, -(near + depth), along, high_up)
        ends_of = (self.u, low, deep, high_up), (-self.u, -high, deep, high_up), (-up, -top, along, deep)
        return sum(self._sent(*side) for side in (*sides, *ends_of))

    def _sent(self, inward, level, *between) -> np.ndarray:
        """Nats (M, n) of the echoes of sides `between` ends along two directions (direction, low, high), of each material."""
        levels, which = np.unique(level, return_inverse=True)
        nats, met = self._over(inward, levels)
        lit = self.rows.tx_m @ inward < level[:, None]
        for direction, low, high in between:
            at = (met @ direction)[which]
            lit &= (at > low[:, None]) & (at < high[:, None])
        return (nats[which] @ lit[..., None].astype(float))[..., 0].T

    def _over(self, inward: np.ndarray, levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nats (P, M, n) of the echoes of all planes with a normal, of each material, and where (P, n, 3) they are met: ends are
        moved one after the other, and most sides stay."""
        keys = [(inward.tobytes(), level) for level in levels.tolist()]
        missing = levels[[key not in self.known for key in keys]]
        if len(missing):
            planes = np.broadcast_to(inward, (len(missing), 3)), missing
            nats = self.rows.made_nats(*planes, made_at(self.rows.carrier_hz), _WALL_M).transpose(2, 0, 1)
            told = zip(missing.tolist(), nats.copy(), self.rows.met_m(*planes).transpose(1, 0, 2).copy(), strict=True)
            self.known.update(((inward.tobytes(), level), (nats, met)) for level, nats, met in told)
        nats, met = zip(*(self.known[key] for key in keys), strict=True)
        return np.array(nats), np.array(met)

    def settled(self, ends: np.ndarray, scales_m) -> tuple[np.ndarray, float]:
        """The best of some ends, and then one end after the other, with sides where echoes have them as well; and its nats."""
        sides = _levels_m(self.rows, np.array([self.u, -self.u, -self.normal, [0.0, 0.0, -1.0]]))
        phased = sides[:, 0], -sides[:, 1], -sides[:, 2] - self.level_m, -sides[:, 3], np.zeros(0)
        at, best = self._best(ends)
        for scale_m in scales_m:
            for number in range(5 if self.is_open else 4):
                moved = np.concatenate([at[number] + scale_m * np.array([-2, -1, 1, 2]), phased[number]])
                trials = np.repeat(at[None], len(moved), axis=0)
                trials[:, number] = moved
                there, nats = self._best(trials)
                at, best = (there, nats) if nats > best else (at, best)
        self.known.clear()  # there are many outlines
        return at, best

    def _best(self, ends: np.ndarray) -> tuple[np.ndarray, float]:
        low, high, depth, top, _ = ends.T
        ends = ends[(high - low > _THIN_M) & (depth > _THIN_M) & (top > self.ways.floor_m + _THIN_M)]
        if not len(ends):
            return np.zeros(5), -np.inf
        nats = self.nats(ends)
        return ends[np.argmax(nats)], float(nats.max())

    def sheet(self, ends: np.ndarray) -> Sheet:
        low, high, depth, top, behind = (float(number) for number in ends)
        origin = (self.level_m + behind) * self.normal + (low + high) / 2 * self.u + np.array([0, 0, self.ways.floor_m])
        return Sheet(
            origin_m=tuple(origin), normal=tuple(self.normal), u=tuple(self.u), v=(0.0, 0.0, 1.0),
            low_m=((low - high) / 2, 0.0), high_m=((high - low) / 2, top - self.ways.floor_m), depth_m=depth,
        )  # fmt: skip
