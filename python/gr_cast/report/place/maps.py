# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps of what is left before and after: delay × link, delay × time, mirrors by direction; power over time where that is all."""

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from ...core.units import SPEED_OF_LIGHT_M_PER_S, db_from_power, power_from_db
from ...diagnose.places import imaging
from ..pages import CAUSE, GOOD, INK, NOISE, TITLES
from ..plot import new_figure

MOST_LINKS = 40  # that have a row or a panel
_AZIMUTHS, _LEVELS = 72, 160  # of the map of mirrors
_FINER = 4  # bins of the echoes that make one of the map
_BEYOND = 1.6  # of the longest path: how far the delay axis goes


@dataclass(frozen=True, kw_only=True)
class Profile:
    """What is left of one link of one campaign by delay: power over noise in dB, (T, D), before and after."""

    campaign: str
    link: str
    is_vault: bool
    delay_s: np.ndarray
    time_s: np.ndarray
    level_db: tuple[np.ndarray, np.ndarray]
    paths_s: np.ndarray

    @property
    def mean_db(self) -> list[np.ndarray]:
        return [_mean_db(one) for one in self.level_db]

    @property
    def worst_db(self) -> float:
        return float(self.mean_db[0].max())


def _mean_db(level_db: np.ndarray) -> np.ndarray:
    return db_from_power(np.maximum(np.nanmean(power_from_db(level_db), axis=0), 1e-2))


def profiles(scene) -> list[Profile]:
    """Of all links, the worst first."""
    found = []
    for number, (name, ear, *fits) in enumerate(scene.campaigns):
        if not ear.has_responses or len(ear.heard.frequency_hz) < 2:
            continue
        seen = [imaging.echoes(ear, fit, world) for fit, world in zip(fits, (scene.base, scene.world), strict=True)]
        shape = len(ear.predictor.links), len(ear.predictor.time_s), -1
        ways = [ear.predictor.path_table(scene.base, index) for index in range(shape[0])]
        longest_m = max((float(way.way.length_m.max()) for way in ways if len(way.gain)), default=30.0)
        bins = int(np.clip(_BEYOND * longest_m / SPEED_OF_LIGHT_M_PER_S * seen[0].bins_per_s, 16 * _FINER, seen[0].nats.shape[1]))
        bins -= bins % _FINER
        nats = [one.nats.reshape(shape)[:, :, :bins].reshape(*shape[:2], -1, _FINER).max(axis=3) for one in seen]
        known = (ear.heard.weight > 0).any(axis=2)
        delay_s = (np.arange(bins // _FINER) + 0.5) * _FINER / seen[0].bins_per_s
        for index, link in enumerate(ear.predictor.links):
            if known[index].any():
                level = tuple(db_from_power(np.where(known[index][:, None], np.maximum(n[index], 1e-2), np.nan)) for n in nats)
                way = ways[index]
                there = (np.abs(way.gain) > 0) & (way.instant == way.instant.min(initial=0))
                found.append(
                    Profile(
                        campaign=name, link=">".join(link), is_vault=number >= len(scene.diagnosis.ears), delay_s=delay_s,
                        time_s=ear.predictor.time_s, level_db=level,
                        paths_s=np.unique(way.way.length_m[there]) / SPEED_OF_LIGHT_M_PER_S,
                    )
                )  # fmt: skip
    return sorted(found, key=lambda one: -one.worst_db)


def maps_figure(scene, found: list[Profile]) -> Figure:
    """Delay × link; delay × time of the worst link that has several instants; mirrors by direction and distance."""
    shown = found[:MOST_LINKS]
    timed = next((one for one in found if len(one.time_s) > 3), None)
    heights = [max(1.6, 0.19 * len(shown) + 0.6)] + [2.4] * ((timed is not None) + 1)
    figure = new_figure(10.5, sum(heights) + 0.8)
    rows = figure.subplots(len(heights), 2, height_ratios=heights, sharey="row", squeeze=False)
    worst = float(np.clip(max(one.worst_db for one in shown), 10, 50))
    _by_link(figure, rows[0], shown, worst)
    if timed is not None:
        _by_time(figure, rows[1], timed)
    _by_mirror(figure, rows[-1], scene)
    for axis, title in zip(rows[0], TITLES, strict=True):
        axis.set_title(title, fontsize=12, fontweight="bold")
    return figure


def _by_link(figure, row, shown: list[Profile], worst: float) -> None:
    delay_ns = 1e9 * max((one.delay_s for one in shown), key=lambda axis: axis[-1])
    for side, axis in enumerate(row):
        level = [np.interp(delay_ns, 1e9 * one.delay_s, one.mean_db[side], right=np.nan) for one in shown]
        picture = axis.imshow(
            level, extent=[0, delay_ns[-1], len(shown) - 0.5, -0.5], vmin=0, vmax=worst, cmap="magma", aspect="auto",
            interpolation="nearest",
        )  # fmt: skip
        for number, one in enumerate(shown):
            axis.plot(1e9 * one.paths_s, np.full(len(one.paths_s), number), "|", color="#4fd1ff", ms=4, mew=0.7)
        axis.set_facecolor("black")
        axis.set(xlabel="delay / ns  (blue: the twin's paths)", xlim=(0, delay_ns[-1]))
    names = [one.link.replace(">", " → ") + (" (vault)" if one.is_vault else "") for one in shown]
    row[0].set_yticks(range(len(names)), names, fontsize=8)
    figure.colorbar(picture, ax=row, label="left over noise / dB", aspect=14)


def _by_time(figure, row, one: Profile) -> None:
    worst = float(np.clip(np.nanmax(one.level_db[0]), 10, 50))
    order = np.argsort(one.time_s, kind="stable")
    for axis, level in zip(row, one.level_db, strict=True):
        picture = axis.pcolormesh(
            one.time_s[order], 1e9 * one.delay_s, level[order].T, vmin=0, vmax=worst, cmap="magma", shading="nearest"
        )
        axis.set(xlabel="time / s")
    row[0].set_ylabel(f"delay / ns\n{one.link.replace('>', ' → ')}")
    figure.colorbar(picture, ax=row, label="left over noise / dB", aspect=14)


def _by_mirror(figure, row, scene) -> None:
    """Evidence for one more upright mirror, by where it faces and how far it is from the middle of what is shown."""
    azimuth = np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
    reach_m = float(np.linalg.norm((scene.high_m - scene.low_m)[:2])) / 2
    distance_m = np.linspace(-reach_m, reach_m, _LEVELS)
    normals = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(_AZIMUTHS)])
    level_m = np.tile(distance_m, _AZIMUTHS) + np.repeat(normals @ ((scene.low_m + scene.high_m) / 2), _LEVELS)
    both = []
    for world, side in ((scene.base, 2), (scene.world, 3)):
        seen = [imaging.echoes(one[1], one[side], world) for one in scene.campaigns if one[1].has_responses]
        both.append(imaging.plane_scores(seen, np.repeat(normals, _LEVELS, axis=0), level_m).reshape(_AZIMUTHS, _LEVELS).T)
    for axis, score in zip(row, both, strict=True):
        picture = axis.imshow(
            score, extent=[0, 180, -reach_m, reach_m], origin="lower", aspect="auto", cmap="magma", vmin=0,
            vmax=max(both[0].max(), 20.0),
        )  # fmt: skip
        axis.set(xlabel="direction that a mirror faces / degree from +x")
    row[0].set_ylabel("its distance / m")
    figure.colorbar(picture, ax=row, label="evidence / nats", aspect=14)


@dataclass(frozen=True, kw_only=True)
class Course:
    """Power of one link over time (T,): measured, by the twin, by the corrected twin; NaN is missing."""

    campaign: str
    link: str
    is_vault: bool
    time_s: np.ndarray
    measured_db: np.ndarray
    twin_db: np.ndarray
    corrected_db: np.ndarray
    std_db: float


def courses(scene) -> list[Course]:
    found = []
    for number, (name, ear, before, after) in enumerate(scene.campaigns):
        if ear.has_responses:
            continue
        order = np.argsort(ear.predictor.time_s, kind="stable")
        for index, link in enumerate(ear.predictor.links):
            weight = ear.weight[index, :, 0]
            if not (weight > 0).any():
                continue
            own = [
                np.where(weight > 0, values[index, :, 0], np.nan)[order] for values in (ear.power_db, before.model, after.model)
            ]
            found.append(
                Course(
                    campaign=name, link=">".join(link), is_vault=number >= len(scene.diagnosis.ears),
                    time_s=ear.predictor.time_s[order], measured_db=own[0], twin_db=own[1], corrected_db=own[2],
                    std_db=float(np.sqrt(0.5 / weight.max())),
                )
            )  # fmt: skip
    return found


def power_figure(found: list[Course]) -> Figure:
    """A panel per link: measured with the meter's error, the twin, the corrected twin."""
    shown = found[:MOST_LINKS]
    columns = min(2, len(shown))
    rows = -(-len(shown) // columns)
    figure = new_figure(10.5, 2.1 * rows + 0.6)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, one in zip(axes, shown, strict=False):
        axis.fill_between(one.time_s, one.measured_db - one.std_db, one.measured_db + one.std_db, color=NOISE, alpha=0.35, lw=0)
        axis.plot(one.time_s, one.measured_db, ".", color=INK, ms=3.5, label="measured, ± the meter's error")
        axis.plot(one.time_s, one.twin_db, color=CAUSE, lw=1.3, label="twin")
        axis.plot(one.time_s, one.corrected_db, color=GOOD, lw=1.6, ls="--", label="corrected twin")
        vault = " (vault)" if one.is_vault else ""
        axis.set_title(f"{one.link.replace('>', ' → ')}{vault}", fontsize=10, loc="left")
        axis.set(xlabel="time / s", ylabel="power / dB")
        axis.grid(alpha=0.25)
    for axis in axes[len(shown) :]:
        axis.set_axis_off()
    axes[0].legend(fontsize=7, loc="best")
    return figure
