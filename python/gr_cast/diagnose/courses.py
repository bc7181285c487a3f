# SPDX-License-Identifier: GPL-3.0-or-later
"""The likeliest course of a quantity that is known amid every part of a recording: constant, a line, a relaxation or a step."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from .policy import COURSE_SURE_NATS, COURSE_TIMES, LEAST, WRONG_P


@dataclass(frozen=True, kw_only=True)
class Series:
    """A quantity amid every part, in time: share of the recording, value and its standard deviation, (parts,) each."""

    at: np.ndarray
    value: np.ndarray
    std: np.ndarray

    @property
    def mean(self) -> float:
        return float(np.sum(self.value / self.std**2) / np.sum(self.std**-2.0))


@dataclass(frozen=True, kw_only=True)
class Course:
    """A course over the parts: nats over a constant one, the values (parts,) it says, what it changes over the recording, and
    its time constant, or the number of the last part before its step and how much of the next one is before it too, or its
    coefficient of t² with the standard deviation."""

    nats: float
    said: np.ndarray
    change: float
    std: float
    time: float | None = None
    step: int | None = None
    share: float = 0.0
    bend: tuple[float, float] | None = None


def of_gain(level: Series | None) -> Course | None:
    """The likeliest course of a gain: a line, a relaxation or a step; None for a constant one."""
    if level is None:
        return None
    at, number, price = level.at, np.arange(len(level.at)), 1.5 * np.log(len(level.at))
    courses = [_fitted(level, at, price - np.log(len(at)))]
    courses += [_fitted(level, np.expm1(-at / tau) / np.expm1(-1 / tau), price + 2, time=tau) for tau in COURSE_TIMES]
    for k in range(len(at) - 1):
        courses.append(_fitted(level, (number > k).astype(float), price, step=k))
        if k + 2 < len(at):
            courses.append(_stepping_within(level, k, price + np.log(len(at))))
    return _likely(level, [c for c in courses if c is not None])


def _stepping_within(level: Series, k: int, price: float) -> Course | None:
    """A step within the part behind part `k`, whose own level tells how much of it is before the step."""
    number = np.arange(len(level.at))
    open_there = replace(level, std=np.where(number == k + 1, 1e6, level.std))
    course = _fitted(open_there, (number > k).astype(float), 0.0)
    share = (course.said[-1] - level.value[k + 1]) / course.change if course.change else 0.0
    if not 0 < share < 1:
        return None
    said = np.where(number == k + 1, level.value, course.said)
    return replace(course, nats=nats_over_none(level, said) - price, said=said, step=k, share=float(share))


def line(series: Series) -> Course | None:
    """The course of a quantity that changes evenly; None for a constant one."""
    return _likely(series, [_fitted(series, series.at, 0.5 * np.log(len(series.at)))])


def parabola(series: Series) -> Course | None:
    """The course of a quantity whose change may itself change evenly; None for a constant one."""
    return _likely(series, [_fitted(series, series.at, np.log(len(series.at)), bent=True)])


def _likely(series: Series, courses: list[Course]) -> Course | None:
    """The best of some courses, if it is surely likelier than none and leaves no more than chance does."""
    best = max(courses, key=lambda c: c.nats)
    left = np.sum(((series.value - best.said) / series.std) ** 2)
    numbers = 2 + (best.time is not None) + (best.share > 0) + (best.bend is not None)
    holds = stats.chi2.sf(left, max(len(series.at) - numbers, 1)) > WRONG_P
    return best if holds and best.nats > COURSE_SURE_NATS and np.ptp(best.said) > LEAST else None


def _fitted(series: Series, shape: np.ndarray, price: float, bent=False, **kind) -> Course:
    """A constant and a multiple of `shape` (parts,), where it is `bent` also of its square, by least squares."""
    shapes = np.stack([np.ones_like(shape), shape, *([shape**2] if bent else [])], 1)
    rows = shapes / series.std[:, None]
    inverse = np.linalg.pinv(rows.T @ rows)
    p = inverse @ rows.T @ (series.value / series.std)
    said, std = shapes @ p, np.sqrt(np.diag(inverse))
    bend = (float(p[2]), float(std[2])) if bent else None
    nats = nats_over_none(series, said) - price
    return Course(nats=nats, said=said, change=float(p[1]), std=float(std[1]), bend=bend, **kind)


def nats_over_none(series: Series, said: np.ndarray) -> float:
    """By which values are likelier than their mean."""
    apart = ((series.value - series.mean) / series.std) ** 2 - ((series.value - said) / series.std) ** 2
    return float(0.5 * apart.sum())
