# SPDX-License-Identifier: GPL-3.0-or-later
"""What received power alone shows beside the fields of paths: who carries a node, fading along the way, the meter's scale."""

from dataclasses import replace

import numpy as np

from ..carrying import Body
from ..meters import Fading, Meter
from .base import Effect, Family, std_of, value

_K_DB = (-3.0, 3.0, 8.0)  # first guesses
_COHERENCE_M = (0.06, 0.2, 0.8)
_LEAST_REPEATS = 4  # readings on one number that are no chance
_CROWD = 3.0  # times the readings on the number beside it
_SAME_DB = 1e-6
_ROUND_RAD = np.linspace(-np.pi, np.pi, 8, endpoint=False)  # where a body may stand,
_WIDE_RAD, _TAKES_DB = (0.5, 1.2), 6.0  # how wide it is and what it takes: first guesses
_LOW, _KNOWN_DB = (
    0.05,
    3.0,
)  # quantile of the readings at which a meter may hear itself; how near that is to a limit that is known
_LEAST_STEP = 2.0  # of the meter's error: finer steps are inside it


class BodyLoss(Family):
    """Of a node that goes: what carries it stands in the way of some directions, and turns with it."""

    name = "excess_loss"
    shows_in_power = True
    is_in_spec = False
    level = "node"
    order = 6

    def owners(self, view):
        return [] if view.has_responses else view.walkers

    def starts(self, view, owner):
        return [Effect(family=self, owner=owner, values=np.array([_TAKES_DB, a, w])) for a in _ROUND_RAD for w in _WIDE_RAD]

    def apply(self, world, effect):
        loss_db, azimuth_rad, width_rad = map(float, effect.values)
        return world.with_radio(effect.owner, body=Body(loss_db=loss_db, azimuth_rad=azimuth_rad, width_rad=width_rad))

    def bounded(self, values):
        loss_db, azimuth_rad, width_rad = values
        return np.array([np.clip(loss_db, 0, 60), (azimuth_rad + np.pi) % (2 * np.pi) - np.pi, np.clip(width_rad, 0.2, 2.5)])

    def told(self, view, effect, covariance):
        names = ("loss_db", "azimuth_rad", "width_rad")
        return {name: value(effect.values[i], std_of(covariance, i)) for i, name in enumerate(names)}

    def sentence(self, effect, told):
        loss_db, azimuth_rad, _ = effect.values
        return (
            f"What carries {effect.owner} takes up to {loss_db:.1f} dB of what comes from "
            f"{np.degrees(azimuth_rad):+.0f}° left of where it is heading."
        )


class SmallScale(Family):
    name = "small_scale"
    shows_in_power = True
    is_in_spec = False
    level = "link"
    order = 6

    def owners(self, view):
        return [f"{a}>{b}" for a, b in view.fading_links]

    def starts(self, view, owner):
        return [Effect(family=self, owner=owner, values=np.array([k, np.log(m)])) for k in _K_DB for m in _COHERENCE_M]

    def apply(self, world, effect):
        fading = Fading(k_factor_db=float(effect.values[0]), coherence_m=float(np.exp(effect.values[1])))
        return replace(world, fading={**world.fading, tuple(effect.owner.split(">")): fading})

    def steps(self, world, effect):
        return np.array([1e-3, 1e-3])

    def bounded(self, values):
        return np.array([np.clip(values[0], -20, 25), np.clip(values[1], np.log(0.005), np.log(20.0))])

    def told(self, view, effect, covariance):
        coherence_m, apart_m = float(np.exp(effect.values[1])), view.apart_m(effect.owner)
        std_m = coherence_m * std_of(covariance, 1)
        if coherence_m < apart_m / 2:  # readings that have nothing in common say no more than that
            coherence_m = std_m = apart_m / 4
        return {"k_factor_db": value(effect.values[0], std_of(covariance, 0)), "coherence_m": value(coherence_m, std_m)}

    def sentence(self, effect, told):
        k_db, coherence_m = told["k_factor_db"]["value"], told["coherence_m"]["value"]
        return f"{effect.owner} fades about its mean: K = {k_db:.1f} dB, correlated over {coherence_m:.2g} m of the way."


class MeterLimits(Family):
    """Readings that repeat one number, or all lie on a grid, or level off where the meter hears itself, are not the place's."""

    name = "meter_limits"
    shows_in_power = True
    is_in_spec = False
    level = "node"
    order = 6
    price_nats = 6.0  # of which limit, and its number

    def owners(self, view):
        return [node for node in view.nodes if self.starts(view, node)]

    def starts(self, view, owner):
        readings, std_db, known = view.readings_of(owner)
        ends = [
            Effect(family=self, owner=owner, values=np.zeros(0), choice=(kind, number, std_db / max(len(readings), 1)))
            for kind, number in scales(readings, std_db, known)
        ]
        if len(readings) < 2 * _LEAST_REPEATS or (level_db := float(np.quantile(readings, _LOW))) < known[0] + _KNOWN_DB:
            return ends
        return [*ends, Effect(family=self, owner=owner, values=np.array([level_db]), choice=("noise_db", level_db, std_db))]

    def apply(self, world, effect):
        kind, number, _ = effect.choice
        number = float(effect.values[0]) if len(effect.values) else number
        meter = replace(world.meters.get(effect.owner, Meter()), **{kind: number})
        return replace(world, meters={**world.meters, effect.owner: meter})

    def told(self, view, effect, covariance):
        kind, number, std = effect.choice
        if len(effect.values):
            number, std = float(effect.values[0]), std_of(covariance, 0)
        return {"step_db" if kind == "step_db" else "level_db": value(number, std)}

    def steps(self, world, effect):
        return np.full(len(effect.values), 1e-4)

    def sentence(self, effect, told):
        kind, number, _ = effect.choice
        number = float(effect.values[0]) if len(effect.values) else number
        word = {
            "top_db": "saturates at", "floor_db": "reads nothing below", "step_db": "reads in steps of",
            "noise_db": "reads its own noise with what comes, as much as",
        }[kind]  # fmt: skip
        return f"The meter of {effect.owner} {word} {number:.4g} dB."


def scales(readings_db: np.ndarray, std_db: float, known: tuple[float, float]) -> list[tuple[str, float]]:
    """What the readings of one receiver say of its scale: (field of Meter, number); `known` limits are no finding."""
    if len(readings_db) < 2 * _LEAST_REPEATS:
        return []
    numbers, count = np.unique(np.round(readings_db / _SAME_DB).astype(np.int64), return_counts=True)
    numbers = numbers * _SAME_DB
    step = grid(numbers)
    if step >= _LEAST_STEP * std_db and (count > 1).any():
        return [("step_db", step)]
    out = []
    for kind, end, beside, limit in (("top_db", -1, slice(-4, -1), known[1]), ("floor_db", 0, slice(1, 4), known[0])):
        crowd = count[end] >= max(_LEAST_REPEATS, _CROWD * count[beside].max(initial=0) + 1)
        if crowd and not abs(numbers[end] - limit) < 10 * _SAME_DB:
            out.append((kind, float(numbers[end])))
    return out


def grid(numbers: np.ndarray) -> float:
    """The widest step whose multiples all numbers are; 0 where there is none worth the name."""
    step, tolerance = 0.0, 1e-4
    for number in np.abs(numbers):
        a, b = max(step, number), min(step, number)
        while b > tolerance:  # Euclid's algorithm, with an end
            a, b = b, abs(a - b * np.round(a / b))
        step = a
        if step < 1e-3:
            return 0.0
    return float(
        np.median(np.abs(numbers[np.abs(numbers) > step / 2]) / np.round(np.abs(numbers[np.abs(numbers) > step / 2]) / step))
    )
