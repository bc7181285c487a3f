# SPDX-License-Identifier: GPL-3.0-or-later
"""From paths that the soundings lack to rectangles that would stand in their way."""

import numpy as np

from ...twin.places.families.additions import Sheet
from ...twin.places.predict import phasors
from .planes import rectangle

_WAYS = np.arange(1, 8) / 8  # along a leg: where something may stand
_LEAST_NATS = 20.0  # that a path's absence must be worth, all instants together
_STRONGEST = 3  # paths whose legs are looked along
_KEPT = 3


def shades(view) -> list[Sheet]:
    """Rectangles across legs of paths that are not there, and across as few others as may be; the best first."""
    lost, begin_m, end_m, path = _legs(view)
    if not len(lost):
        return []
    groups, member = np.unique(path[:, :-1], axis=0, return_inverse=True)
    total = np.bincount(member.ravel(), lost)
    found = []
    for group in np.argsort(-total)[:_STRONGEST]:
        if total[group] < _LEAST_NATS:
            break
        own = np.flatnonzero(member.ravel() == group)
        leg = own[np.argmax(lost[own])]
        for share in _WAYS:
            point = begin_m[leg] + share * (end_m[leg] - begin_m[leg])
            sheet = _across(point, end_m[leg] - begin_m[leg], lost, begin_m, end_m)
            if sheet:
                found.append(sheet)
    return [sheet for _, sheet in sorted(found, key=lambda pair: -pair[0])[:_KEPT]]


def _legs(view):
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


def _across(point: np.ndarray, way: np.ndarray, lost, begin_m, end_m):
    """(nats, sheet) of the best rectangle through a point, upright across `way` where it is not steep."""
    level = np.array([way[0], way[1], 0.0])
    steep = np.linalg.norm(level) < 0.3 * np.linalg.norm(way)
    normal = np.array([0.0, 0.0, 1.0]) if steep else level / np.linalg.norm(level)
    v = np.array([0.0, 1.0, 0.0]) if steep else np.array([0.0, 0.0, 1.0])
    u = np.cross(v, normal)
    before, after = (begin_m - point) @ normal, (end_m - point) @ normal
    through = before * after < 0
    share = (before / np.where(through, before - after, 1.0))[:, None]
    places = begin_m + share * (end_m - begin_m) - point
    box = rectangle(np.column_stack([places @ u, places @ v])[through], lost[through])
    if box is None:
        return None
    nats, low, high = box
    sheet = Sheet(origin_m=tuple(point), normal=tuple(normal), u=tuple(u), v=tuple(v), low_m=tuple(low), high_m=tuple(high))
    return nats, sheet


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
