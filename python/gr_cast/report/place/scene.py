# SPDX-License-Identifier: GPL-3.0-or-later
"""What a page draws of a diagnosed place: links with their misfit, objects by what paths meet them, the box that is shown."""

from dataclasses import dataclass, replace

import numpy as np

from ...core.units import db_from_power
from ...diagnose.places.view import View

MOST_INSTANTS = 12  # of a moving link that are drawn
_FAINT = 1e-12
_ROUND_M = 4.0  # that is shown around the nodes, at least


@dataclass(frozen=True, kw_only=True)
class Line:
    """A link as it is drawn at one instant: ends (3,) and misfit, each before and after; misfit is residual over noise."""

    name: str
    ends_m: tuple[np.ndarray, np.ndarray]
    misfit_db: tuple[float, float]
    is_vault: bool


@dataclass(frozen=True, kw_only=True)
class Scene:
    diagnosis: object
    lines: tuple[Line, ...]
    links: dict  # (campaign, link) → misfit_db before and after
    tracks_m: dict  # node → (n, 3), where the twin has it at the times of the soundings
    lit: frozenset
    shading: frozenset
    low_m: np.ndarray
    high_m: np.ndarray

    @property
    def base(self):
        return self.diagnosis.model.base

    @property
    def world(self):
        return self.diagnosis.model.world

    @property
    def worst_db(self) -> float:
        return float(np.clip(max((max(line.misfit_db) for line in self.lines), default=0), 10, 50))

    @property
    def campaigns(self) -> list:
        """(name, ear, before, after) of all that was sounded, the vault last."""
        d = self.diagnosis
        files = [one.file for one in d.place.soundings if not one.vault] + [one.file for one in d.place.soundings if one.vault]
        return list(zip(files, (*d.ears, *d.vault), d.before, d.after, strict=True))

    @property
    def duration_s(self) -> float:
        return float(max(ear.predictor.time_s.max() for _, ear, _, _ in self.campaigns))


def scene_of(diagnosis) -> Scene:
    everything = (*diagnosis.ears, *diagnosis.vault)
    model = diagnosis.model
    worlds = [replace(model, base=world, effects=()) for world in (model.base, model.world)]
    views = [View(everything, one, diagnosis.place.unknown) for one in worlds]
    lit = frozenset(name for view in views for name in view.seen_objects)
    shading = frozenset(name for view in views for name in view.blocking_objects) - lit
    lines, links = _lines(diagnosis)
    tracks_m = _tracks(diagnosis)
    low, high = _box(diagnosis, tracks_m)
    return Scene(
        diagnosis=diagnosis, lines=lines, links=links, tracks_m=tracks_m, lit=lit, shading=shading, low_m=low, high_m=high
    )  # fmt: skip


def _tracks(diagnosis) -> dict[str, np.ndarray]:
    found: dict = {}
    for ear in (*diagnosis.ears, *diagnosis.vault):
        order = np.argsort(ear.predictor.time_s, kind="stable")
        for index, link in enumerate(ear.predictor.links):
            for name, end_m in zip(link, ear.predictor.ends_m(diagnosis.model.base, index), strict=True):
                found.setdefault(name, {})[id(ear)] = end_m[order]
    tracks = {name: np.concatenate([*parts.values()]) for name, parts in found.items()}
    return {name: track if np.ptp(track, axis=0).any() else track[:1] for name, track in tracks.items()}


def misfit(ear, fit) -> tuple[np.ndarray, np.ndarray]:
    """(L, T) energy of what is left, and what noise alone would have."""
    if not ear.has_responses:
        return fit.rows**2, (ear.root[:, :, 0] > 0) * 0.5
    return (np.abs(fit.residual) ** 2 * ear.root**2).sum(axis=2), (ear.root > 0).sum(axis=2)


def _lines(diagnosis):
    """Links that stand still once, those that move at a few instants."""
    worlds = diagnosis.model.base, diagnosis.model.world
    still: dict = {}
    lines, links = [], {}
    for number, (ear, *fits) in enumerate(
        zip((*diagnosis.ears, *diagnosis.vault), diagnosis.before, diagnosis.after, strict=True)
    ):
        is_vault = number >= len(diagnosis.ears)
        both = [misfit(ear, fit) for fit in fits]
        for index, link in enumerate(ear.predictor.links):
            name, heard = ">".join(link), both[0][1][index] > 0
            if not heard.any():
                continue
            links[number, name] = tuple(_db(energy[index].sum(), count[index].sum()) for energy, count in both)
            ends_m = [ear.predictor.ends_m(world, index) for world in worlds]
            if not any(np.ptp(end, axis=0).any() for end in ends_m[0]):
                sums = [np.array([energy[index].sum(), count[index].sum()]) for energy, count in both]
                ends = tuple(np.array([end[0] for end in one]) for one in ends_m)
                old = still.get(name)
                sums = sums if old is None else [a + b for a, b in zip(old[0], sums, strict=True)]
                still[name] = sums, ends, is_vault and (old is None or old[2])
                continue
            for part in np.array_split(np.flatnonzero(heard), min(MOST_INSTANTS, int(heard.sum()))):
                middle = part[len(part) // 2]
                lines.append(
                    Line(
                        name=name,
                        ends_m=tuple(np.array([end[middle] for end in one]) for one in ends_m),
                        misfit_db=tuple(_db(energy[index, part].sum(), count[index, part].sum()) for energy, count in both),
                        is_vault=is_vault,
                    )
                )
    for name, (sums, ends, is_vault) in still.items():
        lines.append(Line(name=name, ends_m=ends, misfit_db=tuple(_db(*one) for one in sums), is_vault=is_vault))
    return tuple(sorted(lines, key=lambda line: line.misfit_db[0])), links


def _db(energy: float, count: float) -> float:
    return float(db_from_power(max(energy / max(count, _FAINT), 1e-3)))


def _box(diagnosis, tracks_m: dict):
    """What is shown: all nodes, with the objects around them as far as half the nodes' span."""
    world, points_m = diagnosis.model.base, np.concatenate([*tracks_m.values()])
    near = [points_m]
    for effect in diagnosis.document["effects"]:
        if box := effect["where"].get("position_m"):
            near.append(np.array(box))
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    reach = np.maximum(0.5 * max(high - low), _ROUND_M)
    corners = np.concatenate([solid.vertices_m for solid in world.mesh.solids] or [points_m])
    near.append(np.clip(corners, low - reach, high + reach))
    points_m = np.concatenate(near)
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    far = points_m.mean(axis=0)[2] + np.array([-1, 1]) * 4 * max(high - low)  # a ground far below would flatten the section
    return low, np.array([*high[:2], min(high[2], far[1])])
