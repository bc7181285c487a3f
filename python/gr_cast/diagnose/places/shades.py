# SPDX-License-Identifier: GPL-3.0-or-later
"""From paths that the soundings lack to boxes that would stand in their way."""

import itertools
from dataclasses import dataclass

import numpy as np

from ...twin.places.families.additions import Sheet
from ...twin.places.predict import phasors
from . import planes

_WAYS = np.arange(1, 8) / 8  # along a leg: where something may stand
_LEAST_NATS = 20.0  # that a path's absence must be worth, all instants together
_STRONGEST = 3  # paths whose legs are looked along
_KEPT, _BEGUN = 3, 6  # boxes that are returned, and that are looked for near a first guess
_APART_M = 0.5  # of one first guess from another
_COUNTS_NATS = 1.0  # of a path: less is no reason for a box, nor against one
_FIRST = (np.arange(6) * np.pi / 6, (0.5, 2.0, 5.0), (0.1, 1.0, 3.0), (0.2, 1.5))  # yaw, widths, height above the leg
_BOX_STEPS = (1.0, 1.0, 0.4, 1.0, 1.0, 0.5)  # of its numbers
_SCALES = (1.0, 0.5, 0.25, 0.12, 0.5, 0.25, 0.12, 0.05)
_CELL_M, _COARSER, _CELLS, _POINTS = 0.3, 1.3, 400, 200  # of the floor under legs, and points along each
_SHAPES = ((1, 1), (2, 1), (1, 2), (4, 1), (1, 4))  # of boxes there: widths over two cells
_THIN_M, _AT_ONCE = 0.02, 64


def shades(view) -> list[Sheet]:
    """Boxes on the floor in the way of paths that are not there, and of as few others as may be; the best first."""
    lost, begin_m, end_m, path = view.legs
    if not len(lost):
        return []
    ways = Ways.of(view)
    groups, member = np.unique(path[:, :-1], axis=0, return_inverse=True)
    total = np.bincount(member.ravel(), lost)
    legs = []
    for group in np.argsort(-total):
        if total[group] < _LEAST_NATS:
            break
        own = np.flatnonzero(member.ravel() == group)
        legs.append(own[np.argmax(lost[own])])
    if not legs:
        return []
    strongest = (begin_m[legs[:_STRONGEST]], end_m[legs[:_STRONGEST]])
    found = _best(ways, _about(*strongest)) + _best(ways, _upon_the_floor(view, begin_m[legs], end_m[legs]))
    settled = sorted((ways.settled(*one) for one in found), key=lambda pair: -pair[1])
    return [_sheet(box, ways.floor_m) for box, _ in settled[:_KEPT]]


def _best(ways: "Ways", boxes: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """The boxes that explain most, apart from each other, and their nats."""
    nats = ways.nats(boxes)
    found: list = []
    for number in np.argsort(-nats):
        if len(found) == _BEGUN or nats[number] < _LEAST_NATS:
            break
        if not any(np.hypot(*(box - boxes[number])[:2]) < _APART_M for box, _ in found):
            found.append((boxes[number], nats[number]))
    return found


def _about(begin_m: np.ndarray, end_m: np.ndarray) -> np.ndarray:
    """Boxes (n, 6), turned each way, at a few points of each leg."""
    points_m = [a + share * (b - a) for a, b in zip(begin_m, end_m, strict=True) for share in _WAYS]
    return np.array([[*p[:2], yaw, w, d, p[2] + up] for p in points_m for yaw, w, d, up in itertools.product(*_FIRST)])


def _upon_the_floor(view, begin_m: np.ndarray, end_m: np.ndarray) -> np.ndarray:
    """Boxes (n, 6) that stand as what is there stands, wherever a leg goes over the floor."""
    share = (np.arange(_POINTS) + 0.5)[:, None, None] / _POINTS
    points_m = (begin_m + share * (end_m - begin_m)).reshape(-1, 3)
    step_m = _CELL_M
    while len((grid := np.unique(np.floor(points_m[:, :2] / step_m), axis=0, return_inverse=True))[0]) > _CELLS:
        step_m *= _COARSER
    cells, member = grid
    over_m = np.full(len(cells), np.inf)
    np.minimum.at(over_m, member.ravel(), points_m[:, 2])
    yaws = {round(float(np.arctan2(y, x) % (np.pi / 2)), 3) for x, y, z in planes.normals(view.world.faces) if not round(z)}
    return np.array(
        [
            [*middle_m, yaw, 2 * step_m * w, 2 * step_m * d, z_m + up]
            for middle_m, z_m in zip((cells + 0.5) * step_m, over_m, strict=True)
            for yaw, (w, d), up in itertools.product(sorted(yaws) or [0.0], _SHAPES, _FIRST[-1])
        ]
    )


@dataclass(frozen=True, kw_only=True)
class Ways:
    """Legs of paths, path after path: `nats` (P,) by which the soundings would rather not have a path, whose legs begin at
    `first` (P,)."""

    path_nats: np.ndarray
    first: np.ndarray
    begin_m: np.ndarray
    end_m: np.ndarray
    floor_m: float

    @classmethod
    def of(cls, view) -> "Ways":
        (lost, begin_m, end_m, path), floor_m = view.legs, float(view.bounds_m[0][2])
        keep = np.abs(lost) > min(_COUNTS_NATS, np.abs(lost).max() / 10)
        _, first, member = np.unique(
            path[keep][:, [0, 1, *range(3, path.shape[1])]], axis=0, return_index=True, return_inverse=True
        )
        order = np.argsort(member.ravel(), kind="stable")
        begins = np.searchsorted(member.ravel()[order], np.arange(len(first)))
        return cls(
            path_nats=lost[keep][first], first=begins, begin_m=begin_m[keep][order], end_m=end_m[keep][order], floor_m=floor_m
        )  # fmt: skip

    def nats(self, boxes: np.ndarray) -> np.ndarray:
        """(B,) what boxes (B, 6) of x, y, yaw, two widths, and top would explain by the paths that they block."""
        return np.concatenate([self._nats(part) for part in np.array_split(boxes, -(-len(boxes) // _AT_ONCE))])

    def _nats(self, boxes: np.ndarray) -> np.ndarray:
        cos, sin = np.cos(boxes[:, 2, None]), np.sin(boxes[:, 2, None])

        def inside(points_m):  # (B, n) each: as fractions of half the widths, and of the height
            x, y = points_m[:, 0] - boxes[:, 0, None], points_m[:, 1] - boxes[:, 1, None]
            half = np.maximum(boxes[:, 3:5, None], 1e-3) / 2
            height_m = np.maximum(boxes[:, 5, None] - self.floor_m, 1e-3) / 2
            return (
                (cos * x + sin * y) / half[:, 0],
                (cos * y - sin * x) / half[:, 1],
                (points_m[:, 2] - self.floor_m) / height_m - 1,
            )

        enter, leave = np.float64(0.0), np.float64(1.0)
        for a, b in zip(inside(self.begin_m), inside(self.end_m), strict=True):
            way = np.where(np.abs(b - a) > 1e-12, b - a, 1e-12)
            low, high = (-1 - a) / way, (1 - a) / way
            enter, leave = np.maximum(enter, np.minimum(low, high)), np.minimum(leave, np.maximum(low, high))
        hit = np.logical_or.reduceat(enter < leave, self.first, axis=1)
        return hit @ self.path_nats

    def settled(self, box: np.ndarray, nats: float) -> tuple[np.ndarray, float]:
        """The best box near by: one number after the other."""
        for scale in _SCALES:
            for number, step in enumerate(_BOX_STEPS):
                trials = np.repeat(box[None], 4, axis=0)
                trials[:, number] += scale * step * np.array([-2, -1, 1, 2])
                trials = trials[(trials[:, 3:5] >= _THIN_M).all(axis=1) & (trials[:, 5] > self.floor_m + _THIN_M)]
                found = self.nats(trials) if len(trials) else np.zeros(0)
                if len(found) and found.max() > nats:
                    box, nats = trials[np.argmax(found)], float(found.max())
        return box, nats


def _sheet(box: np.ndarray, floor_m: float) -> Sheet:
    x, y, yaw, wide_m, deep_m, top_m = (float(number) for number in box)
    u, normal = (np.cos(yaw), np.sin(yaw), 0.0), (-np.sin(yaw), np.cos(yaw), 0.0)
    origin = np.array([x, y, floor_m]) - deep_m / 2 * np.array(normal)
    return Sheet(
        origin_m=tuple(origin), normal=normal, u=u, v=(0.0, 0.0, 1.0),
        low_m=(-wide_m / 2, 0.0), high_m=(wide_m / 2, top_m - floor_m), depth_m=deep_m,
    )  # fmt: skip


def legs(view):
    """Nats (n,) by which the soundings would rather not have the path of each leg, both ends of the legs (n, 3), and which they
    are: numbers (n, 4 and more) of ear, link, leg, faces and instant."""
    none = np.zeros((0, 3))
    lost, begins, ends, names = [np.zeros(0)], [none], [none], [np.zeros((0, 4 + view.world.max_depth), int)]
    for number, (ear, fit) in enumerate(zip(view.ears, view.model.fits, strict=True)):
        if not ear.has_responses:
            continue
        for index in range(len(ear.heard.links)):
            table = ear.predictor.path_table(view.world, index)
            here = np.flatnonzero(table.gain)
            if not len(here):
                continue
            nats = _lost(ear, fit, view.world, index, table, here)
            faces, points = table.paths.faces[here], table.way.points_m[here]
            for leg in range(points.shape[1] - 1):
                used = np.flatnonzero(np.linalg.norm(points[:, leg + 1] - points[:, leg], axis=1) > 0.1)
                lost.append(nats[used])
                begins.append(points[used, leg])
                ends.append(points[used, leg + 1])
                where = np.broadcast_to([number, index, leg], (len(used), 3))
                padded = np.pad(faces[used], ((0, 0), (0, view.world.max_depth - faces.shape[1])), constant_values=-1)
                names.append(np.column_stack([where, padded, table.instant[here[used]]]))
    return tuple(np.concatenate(column) for column in (lost, begins, ends, names))


def _lost(ear, fit, world, index: int, table, here: np.ndarray) -> np.ndarray:
    """Nats by which the fit of a link is better without each path. Paths overlap in delay: the worst is taken away before the
    others are asked again."""
    f_hz, weight = ear.predictor.frequency_hz, ear.heard.weight[index]
    alone = phasors(table.gain[here], table.way.length_m[here], world.carrier_hz, f_hz).T * ear.predictor.cables(world, index)
    if table.many == 1:  # of a still link, at all instants
        at, path = np.divmod(np.arange(len(weight) * len(here)), len(here))
    else:
        at, path = table.instant[here], np.arange(len(here))
    part = alone[path] * fit.factor[index, at]
    _, family = np.unique(table.paths.faces[here[path]], axis=0, return_inverse=True)
    family = family.ravel()
    gone = np.zeros(family.max() + 1, bool)
    residual = fit.residual[index].copy()
    while True:
        side = np.where(gone[family], -1.0, 1.0)
        crossed = (residual[at].conj() * part).real
        nats = -((2 * crossed + side[:, None] * np.abs(part) ** 2) * weight[at]).sum(axis=1)
        total = np.where(gone, 0.0, np.bincount(family, nats))
        worst = int(np.argmax(total))
        if total[worst] < _LEAST_NATS:
            return np.bincount(path, nats, len(here))
        gone[worst] = True
        own = family == worst
        np.add.at(residual, at[own], part[own])


def shaded(view, effect) -> np.ndarray:
    """Points (n, 3), a few on each, of the legs that would go through an added rectangle if it were not there."""
    world, corners_m = view.without(effect), effect.choice.corners_m(*effect.values[:2])
    origin, u, v = corners_m[0], corners_m[1] - corners_m[0], corners_m[3] - corners_m[0]
    normal = np.cross(u, v)
    found = [np.zeros((0, 3))]
    for ear in view.ears:
        for index in range(len(ear.predictor.links)):
            points_m = ear.predictor.path_table(world, index).way.points_m
            begin, end = points_m[:, :-1].reshape(-1, 3), points_m[:, 1:].reshape(-1, 3)
            before, after = (begin - origin) @ normal, (end - origin) @ normal
            through = before * after < 0
            share = (before / np.where(through, before - after, 1.0))[:, None]
            place = begin + share * (end - begin) - origin
            across, up = place @ u / (u @ u), place @ v / (v @ v)
            through &= (across > 0) & (across < 1) & (up > 0) & (up < 1)
            found += [begin[through] + way * (end - begin)[through] for way in _WAYS]
    return np.concatenate(found)
