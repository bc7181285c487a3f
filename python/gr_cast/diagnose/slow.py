# SPDX-License-Identifier: GPL-3.0-or-later
"""What is too slow to be seen in one part of a long recording, or happens between two: the courses of gain, phase and delay from
part to part."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import stats

from ..sounding.cir import DB_PER_NEPER as DB
from ..twin.effects import FAMILIES, Effect, Role, plays, with_role
from ..twin.effects.base import start
from ..twin.model import Model
from . import courses
from .courses import Course, Series
from .finding import Finding, Worth
from .policy import (
    FLOOR_DB,
    LEAST_PART,
    LEFT_NATS,
    OPEN_CYCLES,
    SLOW_ALIKE,
    SLOW_FEWEST,
    SURE,
    TIME_STD,
    UNSEEN,
    UNSEEN_CYCLES,
    WANDER,
    WORSE_NATS,
    WRONG_P,
)
from .residual import Leftover
from .search import refit


def between(findings: list[Finding]) -> None:
    """Put what the parts of a recording show together into one of them, as an effect. `findings` are of one recording, the
    first one that of the part that was searched."""
    shown = [e for f in findings for e in f.fit.model.found]
    wanders = {what for e in shown for what in FAMILIES[e.family].wanders}
    if len(findings) < SLOW_FEWEST or "gain" in wanders or len(findings[0].scene.sources) > 1:
        return
    first, in_time = findings[0], _in_time(findings)
    whole_s, whole = first.scene.whole_s, first.scene.whole
    level, steps = _levels(in_time), _steps_before(in_time)
    best = courses.of_gain(level)
    if best and best.step is None:
        told, std = {"total_db": DB * best.change}, {"total_db": DB * best.std}
        if best.time is not None:
            told["time_constant_s"] = best.time * whole_s
            std["time_constant_s"] = TIME_STD * best.time * whole_s
        worth = Worth(evidence=best.nats, held_out=_held_out(in_time, level, best, 1.0))
        _put(findings, first, Role.DRIFT, told, std, worth)
    elif best:
        best = best if _put_step(in_time, level, best) else None
    if level and best is None and courses.nats_over_none(level, level.value) > LEFT_NATS and np.ptp(level.value) > WANDER:
        first.left.append(_wander(level, whole_s))
        for finding in findings:  # what some of them show is no drift of the whole
            if (bare := _without(finding, Role.DRIFT)) is not finding.fit.model:
                finding.fit = refit(finding.fit.data, bare)
    if level:
        said = level.value if best is None else best.said
        _without_floors(in_time, said - said[0] + [nepers for nepers, _ in steps])
    phase = _phases(in_time) if "phase" not in wanders else None
    if phase and (best := courses.parabola(phase)):
        hz, (bend, doubt) = 1 / (2 * np.pi * whole_s), best.bend
        told = {"offset_hz": best.change * hz, "drift_hz_per_s": 2 * bend * hz / whole_s}
        std = {"offset_hz": best.std * hz, "drift_hz_per_s": 2 * doubt * hz / whole_s}
        worth = Worth(evidence=best.nats, held_out=_held_out(in_time, phase, best, 1j))
        _put(findings, first, Role.CARRIER, told, std, worth)
    delay = _delays(in_time) if not any(plays(e, Role.SLIP) for e in shown) else None
    if delay and (best := courses.line(delay)):
        told, std = {"offset_ppm": -best.change / whole * 1e6}, {"offset_ppm": best.std / whole * 1e6}
        _put(findings, first, Role.CLOCK, told, std, Worth(evidence=best.nats, held_out=None))


def gap(findings: list[Finding]) -> tuple[int, int] | None:
    """(first, last + 1) samples between two parts, neither of which holds them, between which the gain steps; None: it
    does not."""
    in_time = _in_time(findings)
    best = courses.of_gain(_levels(in_time)) if len(findings) >= SLOW_FEWEST and len(findings[0].scene.sources) == 1 else None
    if best is None or best.step is None or best.share:
        return None
    before, after = (f.scene for f in in_time[best.step : best.step + 2])
    first, last = before.begins + before.span, after.begins
    return (first, last) if last - first >= LEAST_PART else None


def _in_time(findings: list[Finding]) -> list[Finding]:
    return sorted(findings, key=lambda f: f.observation.first)


def _found(finding: Finding, role: Role) -> list[tuple[int, Effect]]:
    return [(i, e) for i, e in enumerate(finding.fit.model.effects) if plays(e, role) and not e.fixed]


def _series(in_time: list[Finding], role: Role, value: Callable, slopes: Callable) -> Series | None:
    """The series of a value of a finding, with its derivatives {number in the model's vector: derivative}; None where the
    twin's own of that family moves in the fits of the parts."""
    if any(plays(e, role) and e.fixed and e.free.any() for f in in_time for e in f.fit.model.effects):
        return None
    at, values, std = [], [], []
    for finding in in_time:
        by = slopes(finding)
        weights = np.array(list(by.values()))
        values.append(value(finding))
        std.append(np.hypot(np.sqrt(weights @ finding.fit.covariance[np.ix_(list(by), list(by))] @ weights), SLOW_ALIKE))
        at.append((finding.scene.begins + _amidst(finding, role)) / finding.scene.whole)
    return Series(at=np.array(at), value=np.array(values), std=np.array(std))


def _amidst(finding: Finding, role: Role) -> float:
    """The sample of a part that its gain, phase and delay are those of: its middle where a course of them is fitted too, else
    that of what is heard in it."""
    scene = finding.scene
    if _found(finding, role):
        return scene.span / 2
    heard = np.abs(finding.fit.chain.y) ** 2 * finding.fit.data.use
    return float(np.sum(scene.index * heard) / max(np.sum(heard), 1e-300))


def _gain_of(finding: Finding) -> complex:
    return complex(*finding.fit.model.base[1:3])


def _along(finding: Finding, way: complex) -> dict[int, float]:
    """Derivatives of the gain along itself (1) or across (1j), over its size."""
    gain = way * _gain_of(finding)
    return {1: gain.real / abs(gain) ** 2, 2: gain.imag / abs(gain) ** 2}


def _amid(finding: Finding, role: Role, share: float) -> dict[int, float]:
    """Derivative by the first number of what a part shows of a family itself."""
    return {finding.fit.model.span(i).start: share for i, e in _found(finding, role) if e.free[0]}


def _steps_before(in_time: list[Finding]) -> list[tuple[float, float]]:
    """[(nepers of the steps that parts before a part show, their variance)]."""
    out, total, variance = [], 0.0, 0.0
    for finding in in_time:
        out.append((total, variance))
        for i, e in _found(finding, Role.STEP):
            total += e.p[0]
            variance += finding.fit.covariance[finding.fit.model.span(i), finding.fit.model.span(i)].sum()
    return out


def _levels(in_time: list[Finding]) -> Series | None:
    """ln of the gain, without the steps that parts show."""
    drift, before = with_role(Role.DRIFT), dict(zip(map(id, in_time), _steps_before(in_time), strict=True))

    def value(finding):
        drifted = sum(np.log(drift.factor(e, np.array([0.5]))[0]) for _, e in _found(finding, Role.DRIFT))
        return np.log(abs(_gain_of(finding))) + drifted - before[id(finding)][0]

    series = _series(in_time, Role.DRIFT, value, lambda f: _along(f, 1.0) | _amid(f, Role.DRIFT, 0.5))
    return series and replace(series, std=np.hypot(series.std, [np.sqrt(before[id(f)][1]) for f in in_time]))


def _phases(in_time: list[Finding]) -> Series | None:
    """Phase in rad without what the twin's own oscillators turn; None where it is open how often it turns between parts."""
    carrier = with_role(Role.CARRIER)

    def value(finding):
        scene = finding.scene
        t = (scene.begins + scene.span / 2) / scene.sample_rate_hz
        own = [e for e in finding.fit.model.effects if plays(e, Role.CARRIER) and e.fixed]
        told = [carrier.values(scene, e, e.p) for e in (carrier.since_the_beginning(scene, e) for e in own)]
        return np.angle(_gain_of(finding)) - 2 * np.pi * sum(v["offset_hz"] * t + 0.5 * v["drift_hz_per_s"] * t**2 for v in told)

    series = _series(in_time, Role.CARRIER, value, lambda f: _along(f, 1j))
    if series is None or any(f.fit.model.inverted for f in in_time):
        return None
    turns, weights, unseen = [], [], []  # cycles over the recording
    for finding, std in zip(in_time, series.std, strict=True):
        lengths = finding.scene.whole / finding.scene.span
        for k, (_, e) in zip(_amid(finding, Role.CARRIER, 1.0), _found(finding, Role.CARRIER), strict=True):
            turns.append(e.p[0] * lengths)
            weights.append(1 / (finding.fit.covariance[k, k] * lengths**2))
        unseen.append(max(UNSEEN_CYCLES, UNSEEN * np.sqrt(12) * std / (2 * np.pi)) * lengths)
    mean, doubt = (np.average(turns, weights=weights), 1 / np.sqrt(np.sum(weights))) if turns else (0.0, max(unseen))
    apart = np.sum(np.array(weights) * np.square(np.array(turns) - mean))
    astray = turns and (len(turns) < len(in_time) / 2 or stats.chi2.sf(apart, len(turns) - 1) < WRONG_P)
    if astray or np.diff(series.at).max() * doubt > OPEN_CYCLES:
        return None
    ramp = 2 * np.pi * mean * series.at
    return replace(series, value=np.unwrap(series.value - ramp) + ramp)


def _delays(in_time: list[Finding]) -> Series | None:
    """Delay in samples without what the twin's own clocks have gained."""

    def value(finding):
        scene, clocks = finding.scene, [e for e in finding.fit.model.effects if plays(e, Role.CLOCK)]
        gained = sum(e.p[0] * (scene.begins / scene.span if e.fixed else -0.5) for e in clocks)
        return scene.anchor + finding.fit.model.base[0] + scene.begins + gained

    series = _series(in_time, Role.CLOCK, value, lambda f: {0: 1.0} | _amid(f, Role.CLOCK, -0.5))
    source = in_time[0].scene.sources[0]
    if series is None or not source.repeat:
        return series
    return replace(series, value=np.unwrap(series.value, period=len(source.samples)))


def _put(findings: list[Finding], holder: Finding, role: Role, told: dict, std: dict, worth: Worth) -> None:
    """Let one finding hold what the whole recording tells of a family; what others show of it themselves they have from there."""
    family = with_role(role)
    for finding in findings:
        bare, scene = _without(finding, role), finding.scene
        own = bare is not finding.fit.model
        if finding is not holder and not own:
            continue
        effect = family.in_its_part(scene, family.parse(scene, told, {}))
        side = {k: e.aux[k] for _, e in _found(finding, role) for k in ("side", "source") if k in e.aux}
        free, aux = np.zeros(len(effect.p), bool), {**effect.aux, **side, "whole": True, "_stds": std}
        effect = replace(effect, free=free, aux=aux, fixed=finding is not holder)
        model = bare.adding(effect)
        changed = own or effect.aux.get("before")
        finding.fit = refit(finding.fit.data, model) if changed else replace(finding.fit, model=model)
        if finding is holder:
            finding.worths[effect.key] = worth


def _without(finding: Finding, role: Role) -> Model:
    """The model of a part without what it shows of a family itself."""
    model = finding.fit.model
    for i, _ in reversed(_found(finding, role)):
        model = model.without(i)
    return model


def _put_step(in_time: list[Finding], level: Series, course: Course) -> bool:
    """Let a part hold the step of a gain, the one before it or the one that it is in; whether that is no less likely."""
    holder = in_time[course.step + (course.share > 0)]
    scene = holder.scene
    slack = np.sqrt(3) * level.std[course.step + 1] / abs(course.change) * scene.span  # by which a level tells of its part
    if course.share:
        middle = scene.begins + course.share * scene.span
        low, high = middle - slack, middle + slack
    else:
        low, high = scene.begins + scene.span - slack, in_time[course.step + 1].scene.begins + slack
    std = {"step_db": DB * course.std, "time_s": float(high - low) / np.sqrt(12) / scene.sample_rate_hz}
    aux = {"gap": float(high - low), "_stds": std}
    place = ((low + high) / 2 - scene.begins) / scene.span
    effect = start(with_role(Role.STEP), [course.change, place], free=[False, False], aux=aux)
    model = holder.fit.model.adding(effect)
    fit = refit(holder.fit.data, model) if place < 1 else replace(holder.fit, model=model)
    if fit.likelihood < holder.fit.likelihood - WORSE_NATS:
        return False
    held_out = _held_out(in_time, level, course, 1.0)
    holder.fit = fit
    holder.worths[effect.key] = Worth(evidence=course.nats, held_out=held_out)
    return True


def _wander(level: Series, whole_s: float) -> Leftover:
    nats, dof = courses.nats_over_none(level, level.value), len(level.at) - 1
    test = f"the gain differs by {DB * np.ptp(level.value):.2f} dB from part to part"
    return Leftover(test=test, p_value=float(stats.chi2.sf(2 * nats, dof)), nats=nats, where={"time_s": [0.0, whole_s]})


def _without_floors(in_time: list[Finding], changed: np.ndarray) -> None:
    """Take out noise floors that are no more than what the gain, `changed` by so many nepers (parts,), makes of the noise."""
    for finding, change_db in zip(in_time, DB * changed, strict=True):
        for i, e in reversed(_found(finding, Role.FLOOR)):
            doubt_db = FLOOR_DB + SURE * finding.stds[e.family]["change_db"]
            if abs(e.p[0] - change_db) < min(doubt_db, abs(change_db)):
                rest = finding.fit.model.without(i)
                finding.fit = replace(finding.fit, model=rest)


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
