# SPDX-License-Identifier: GPL-3.0-or-later
"""What is too slow to be seen in one part of a long recording, or happens between two: the courses of gain, phase and delay from
part to part."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from ..effects import FAMILIES, Effect
from ..effects.base import start
from .finding import Finding, Worth
from .search import refit

DB = 20 / np.log(10)  # of a neper
SURE_NATS = 20.0  # by which a course must be likelier than none
LEAST = 1e-3  # nepers, rad or samples: fits of parts may differ by a tenth of it for reasons of their own
FEWEST = 3  # parts that tell a course from a step
TIMES = np.geomspace(0.03, 1.0, 24)  # time constants that are tried, over the recording
TIME_STD = 0.15  # of a time constant: the grid's step, and what the parts tell of it
FLOOR_DB = 0.05  # by which a floor may differ from what a gain makes of it
WRONG_P = 1e-4  # a course that leaves less likely remainders is none
OPEN_CYCLES = 0.1  # from one part to the next: with a larger error of what they turn their phases cannot be joined
UNSEEN_CYCLES = 0.02  # that a part turns without an offset being found in it
RANDOM = {"tap_fading", "phase_noise", "spectral_inversion"}  # beside which a phase, or what fades, has no course of its own


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
    its time constant, or the number of the last part before its step and how much of the next one is before it too."""

    nats: float
    said: np.ndarray
    change: float
    std: float
    time: float | None = None
    step: int | None = None
    share: float = 0.0


def between(findings: list[Finding]) -> None:
    """Put what the parts of a recording show together into one of them, as an effect. `findings` are of one recording, the
    first one that of the part that was searched."""
    shown = {e.family for f in findings for e in f.fit.model.found}
    if len(findings) < FEWEST or "tap_fading" in shown:
        return
    first, in_time = findings[0], _in_time(findings)
    whole_s, whole = first.scene.whole / first.scene.sample_rate_hz, first.scene.whole
    level = _levels(in_time)
    if best := _course_of_gain(level):
        held_out = _held_out(in_time, level, best, 1.0)
        if best.step is None:
            told, std = {"total_db": DB * best.change}, {"total_db": DB * best.std}
            if best.time is not None:
                told["time_constant_s"] = best.time * whole_s
                std["time_constant_s"] = TIME_STD * best.time * whole_s
            _put(findings, first, "gain_drift", told, std, Worth(evidence=best.nats, held_out=held_out))
        else:
            _put_step(in_time, level, best, held_out)
        _without_floors(findings, abs(DB * best.change))
    phase = _phases(in_time) if not shown & RANDOM and len(first.scene.sources) == 1 else None
    if phase and (best := _line(phase)):
        hz = 1 / (2 * np.pi * whole_s)
        std = {"offset_hz": best.std * hz, "drift_hz_per_s": 2 * _bend_std(phase) * hz / whole_s}
        worth = Worth(evidence=best.nats, held_out=_held_out(in_time, phase, best, 1j))
        _put(findings, first, "carrier_frequency_offset", {"offset_hz": best.change * hz}, std, worth)
    delay = _delays(in_time) if "sample_loss" not in shown else None
    if delay and (best := _line(delay)):
        told, std = {"offset_ppm": -best.change / whole * 1e6}, {"offset_ppm": best.std / whole * 1e6}
        _put(findings, first, "sample_clock_offset", told, std, Worth(evidence=best.nats, held_out=0.0))


def gap(findings: list[Finding]) -> tuple[int, int] | None:
    """(first, last + 1) samples between two parts, neither of which holds them, between which the gain steps; None: it
    does not."""
    in_time = _in_time(findings)
    best = _course_of_gain(_levels(in_time)) if len(findings) >= FEWEST else None
    if best is None or best.step is None or best.share:
        return None
    before, after = (f.scene for f in in_time[best.step : best.step + 2])
    first, last = before.begins + before.span, after.begins
    return (first, last) if last > first else None


def _in_time(findings: list[Finding]) -> list[Finding]:
    return sorted(findings, key=lambda f: f.observation.first)


def _found(finding: Finding, family: str) -> list[tuple[int, Effect]]:
    effects = finding.fit.model.effects
    return [(i, e) for i, e in enumerate(effects) if e.family == family and not e.fixed]


def _series(in_time: list[Finding], value: Callable, slope: Callable) -> Series:
    """The series of a value of a finding, with its derivatives {number in the model's vector: derivative}."""
    values, std = [], []
    for finding in in_time:
        values.append(value(finding))
        slopes = slope(finding)
        at, by = list(slopes), np.array(list(slopes.values()))
        std.append(np.hypot(np.sqrt(by @ finding.fit.covariance[np.ix_(at, at)] @ by), LEAST / 10))
    at = [(f.scene.begins + f.scene.span / 2) / f.scene.whole for f in in_time]
    return Series(at=np.array(at), value=np.array(values), std=np.array(std))


def _gain_of(finding: Finding) -> complex:
    return complex(*finding.fit.model.base[1:3])


def _along(finding: Finding, way: complex) -> dict[int, float]:
    """Derivatives of the gain along itself (1) or across (1j), over its size."""
    gain = way * _gain_of(finding)
    return {1: gain.real / abs(gain) ** 2, 2: gain.imag / abs(gain) ** 2}


def _amid(finding: Finding, family: str, share: float) -> dict[int, float]:
    """Derivative by the first number of what a part shows of a family itself."""
    return {finding.fit.model.span(i).start: share for i, e in _found(finding, family) if e.free[0]}


def _levels(in_time: list[Finding]) -> Series:
    """ln of the gain, without the steps that parts show and what the twin's own drift has changed."""
    drift, before = FAMILIES["gain_drift"], {}
    for finding, after in zip(in_time, in_time[1:], strict=False):
        before[id(after)] = before.get(id(finding), 0.0) + sum(e.p[0] for _, e in _found(finding, "gain_step"))

    def value(finding):
        effects = [e for e in finding.fit.model.effects if e.family == "gain_drift"]
        known = sum(drift.before(finding.scene, e) for e in effects if e.fixed)
        drifted = sum(np.log(drift.factor(e, np.array([0.5]))[0]) for e in effects if not e.fixed)
        return np.log(abs(_gain_of(finding))) - known + drifted - before.get(id(finding), 0.0)

    return _series(in_time, value, lambda f: _along(f, 1.0) | _amid(f, "gain_drift", 0.5))


def _phases(in_time: list[Finding]) -> Series | None:
    """Phase in rad without what the twin's own oscillators turn; None where it is open how often it turns between parts."""
    carrier = FAMILIES["carrier_frequency_offset"]

    def value(finding):
        scene = finding.scene
        t = (scene.begins + scene.span / 2) / scene.sample_rate_hz
        own = [e for e in finding.fit.model.effects if e.family == carrier.name and e.fixed]
        told = [carrier.values(scene, e, e.p) for e in (carrier.since_the_beginning(scene, e) for e in own)]
        return np.angle(_gain_of(finding)) - 2 * np.pi * sum(v["offset_hz"] * t + 0.5 * v["drift_hz_per_s"] * t**2 for v in told)

    series = _series(in_time, value, lambda f: _along(f, 1j))
    turns, doubts = [], []  # cycles over the recording
    for finding in in_time:
        found, lengths = _found(finding, carrier.name), finding.scene.whole / finding.scene.span
        turns.append(sum(e.p[0] for _, e in found) * lengths)
        variance = sum(finding.fit.covariance[k, k] for k in _amid(finding, carrier.name, 1.0))
        doubts.append(max(np.sqrt(variance), 0.0 if found else UNSEEN_CYCLES) * lengths)
    if np.diff(series.at).max() * np.sqrt(np.mean(np.square(doubts)) / len(doubts)) > OPEN_CYCLES:
        return None
    ramp = 2 * np.pi * np.mean(turns) * series.at
    return replace(series, value=np.unwrap(series.value - ramp) + ramp)


def _delays(in_time: list[Finding]) -> Series:
    """Delay in samples without what the twin's own clocks have gained."""

    def value(finding):
        scene, clocks = finding.scene, [e for e in finding.fit.model.effects if e.family == "sample_clock_offset"]
        gained = sum(e.p[0] * (scene.begins / scene.span if e.fixed else -0.5) for e in clocks)
        return scene.anchor + finding.fit.model.base[0] + scene.begins + gained

    series = _series(in_time, value, lambda f: {0: 1.0} | _amid(f, "sample_clock_offset", -0.5))
    source = in_time[0].scene.sources[0]
    return replace(series, value=np.unwrap(series.value, period=len(source.samples))) if source.repeat else series


def _course_of_gain(level: Series) -> Course | None:
    """The likeliest course of a gain: a line, a relaxation or a step; None for a constant one."""
    at, number, price = level.at, np.arange(len(level.at)), 1.5 * np.log(len(level.at))
    courses = [_fitted(level, at, price - np.log(len(at)))]
    courses += [_fitted(level, np.expm1(-at / tau) / np.expm1(-1 / tau), price + 2, time=tau) for tau in TIMES]
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
    return replace(course, nats=_nats(level, said) - price, said=said, step=k, share=float(share))


def _line(series: Series) -> Course | None:
    return _likely(series, [_fitted(series, series.at, 0.5 * np.log(len(series.at)))])


def _likely(series: Series, courses: list[Course]) -> Course | None:
    """The best of some courses, if it is surely likelier than none and leaves no more than chance does."""
    best = max(courses, key=lambda c: c.nats)
    left = np.sum(((series.value - best.said) / series.std) ** 2)
    holds = stats.chi2.sf(left, max(len(series.at) - 2, 1)) > WRONG_P
    return best if holds and best.nats > SURE_NATS and abs(best.change) > LEAST else None


def _fitted(series: Series, shape: np.ndarray, price: float, time=None, step=None) -> Course:
    """A constant and a multiple of `shape` (parts,) by least squares."""
    rows = np.stack([np.ones_like(shape), shape], 1) / series.std[:, None]
    inverse = np.linalg.pinv(rows.T @ rows)
    p = inverse @ rows.T @ (series.value / series.std)
    said, std = p[0] + p[1] * shape, float(np.sqrt(inverse[1, 1]))
    return Course(nats=_nats(series, said) - price, said=said, change=float(p[1]), std=std, time=time, step=step)


def _nats(series: Series, said: np.ndarray) -> float:
    """By which values are likelier than their mean."""
    apart = ((series.value - series.mean) / series.std) ** 2 - ((series.value - said) / series.std) ** 2
    return float(0.5 * apart.sum())


def _bend_std(series: Series) -> float:
    """Standard deviation of the coefficient of t² beside a line."""
    rows = np.stack([np.ones_like(series.at), series.at, series.at**2], 1) / series.std[:, None]
    return float(np.sqrt(np.linalg.pinv(rows.T @ rows)[2, 2]))


def _put(findings: list[Finding], holder: Finding, family: str, told: dict, std: dict, worth: Worth) -> None:
    """Let one finding hold what the whole recording tells of a family; what others show of it themselves they have from there."""
    for finding in findings:
        if finding is not holder and not _found(finding, family):
            continue
        scene = finding.scene
        effect = FAMILIES[family].parse(scene, told, {})
        effect = FAMILIES[family].later(scene, effect, scene.begins / scene.span)
        free, aux = np.zeros(len(effect.p), bool), {**effect.aux, "whole": True}
        effect = replace(effect, free=free, aux=aux, fixed=finding is not holder)
        _replace(finding, family, effect)
        if finding is holder:
            finding.worths[id(effect.p)] = worth
            finding.stds[family] = std


def _put_step(in_time: list[Finding], level: Series, course: Course, held_out: float) -> None:
    """Let a part hold the step of a gain: the one before it, or the one that it is in."""
    holder = in_time[course.step + (course.share > 0)]
    scene = holder.scene
    low, high = (level.at[course.step : course.step + 2] * scene.whole).astype(float)
    if course.share:
        std = level.std[course.step + 1] / abs(course.change) * scene.span
        low, high = scene.begins + course.share * scene.span + np.array([-1, 1]) * np.sqrt(3) * std
    time = ((low + high) / 2 - scene.begins) / scene.span
    effect = start(FAMILIES["gain_step"], [course.change, time], free=[False, False], aux={"gap": float(high - low)})
    _replace(holder, None if course.share == 0 else "gain_step", effect)
    holder.worths[id(effect.p)] = Worth(evidence=course.nats, held_out=held_out)
    time_s = (high - low) / np.sqrt(12) / scene.sample_rate_hz
    holder.stds["gain_step"] = {"step_db": DB * course.std, "time_s": time_s}


def _without_floors(findings: list[Finding], gain_db: float) -> None:
    """Take out noise floors that are no more than the noise which a receiver's gain has changed with the signal."""
    for finding in findings:
        for i, e in reversed(_found(finding, "noise_floor")):
            if abs(e.p[0]) < FLOOR_DB + gain_db:
                finding.fit = replace(finding.fit, model=finding.fit.model.without(i))


def _replace(finding: Finding, family: str | None, effect: Effect) -> None:
    """Put an effect into a finding, and fit it again where it takes the place of one, or changes the part itself."""
    old, model = finding.fit, finding.fit.model
    own = _found(finding, family) if family else []
    for i, _ in reversed(own):
        model = model.without(i)
    model = model.adding(effect)
    within = effect.family == "gain_step" and 0 < effect.p[1] < 1
    if not own and not within:
        finding.fit = replace(old, model=model)
        return
    finding.fit = refit(old.data, model)
    for before, now in zip(model.effects, finding.fit.model.effects, strict=True):
        if id(before.p) in finding.worths:
            finding.worths[id(now.p)] = finding.worths[id(before.p)]


def _held_out(in_time: list[Finding], series: Series, course: Course, way: complex) -> float:
    """Nats that a course of the gain along itself (1) or across (1j) wins over a constant on samples nothing was fitted to."""
    total = 0.0
    for finding, here, said in zip(in_time, series.value, course.said, strict=True):
        fit, unseen = finding.fit, finding.fit.data.vault
        signal, rest = fit.chain.y[unseen], fit.residual[unseen]
        energy = max(float(np.vdot(signal, signal).real), 1e-300)
        seen = here + float((np.vdot(signal, rest) / way).real) / energy
        total += energy / fit.sigma2 * ((seen - series.mean) ** 2 - (seen - said) ** 2)
    return total
