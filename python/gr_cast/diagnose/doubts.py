# SPDX-License-Identifier: GPL-3.0-or-later
"""What effects that leave nothing tell by each other: that they are pieces of something that no family is."""

import itertools

import numpy as np

from ..twin.effects import FAMILIES, Role, plays
from .finding import Finding
from .passing import of_one_line
from .policy import ALIKE, AT_A_SLIP, PIECES_OF_GAIN, UNEXPLAINED_NATS, UNEXPLAINED_P
from .residual import Leftover


def doubts(finding: Finding) -> list[Leftover]:
    """What is there in pieces, as what is left; of loud pieces alone, as of all that is left."""
    tests = (_unsteady, _all_alike, _along_a_line, _gain_in_pieces, _beats_at_rails, _gates_at_slips)
    return [rest for test in tests for rest in test(finding) if rest.p_value < UNEXPLAINED_P and rest.nats > UNEXPLAINED_NATS]


def _found(finding: Finding) -> list[tuple[int, object]]:
    return [(i, e) for i, e in enumerate(finding.fit.model.effects) if finding.is_cause(e)]


def _of(finding: Finding, test: str, numbers, p_value: float, where: dict, record_next: str) -> Leftover:
    """Told of effects `numbers`, of which none is surer than not."""
    nats = max(finding.gain_of(i) for i in numbers)
    return Leftover(test=test, p_value=p_value, nats=max(nats, 0.0), where=where, record_next=record_next)


def _unsteady(finding: Finding):
    """Two of a family that are one whose numbers change."""
    for (i, one), (j, other) in itertools.combinations(_found(finding), 2):
        family, scene = FAMILIES[one.family], finding.scene
        if one.family == other.family and family.unsteady(one, other):
            late = [FAMILIES[e.family].delays(scene, e) for e in (one, other)]
            where = {"delay_s": [float(f(late) / scene.sample_rate_hz) for f in (np.min, np.max)]} if all(late) else {}
            p_value = float(np.exp(-max(min(finding.gain_of(i), finding.gain_of(j)), 0.0)))
            yield _of(finding, "two of one place: it changes in a way of its own", (i, j), p_value, where, "longer_recording")


def _all_alike(finding: Finding):
    """Paths that change, each as all others that do: what they have in common changes."""
    scene, courses = finding.scene, {}
    for i, effect in _found(finding):
        family = FAMILIES[effect.family]
        if {"gain", "phase"} <= {*family.wanders} and "tap" in effect.aux:
            power = np.abs(family.spectrum_of(effect)[0]) ** 2
            rank = power.sum() ** 2 / max(float((power**2).sum()), 1e-300)  # numbers that say anything of the course
            courses[i] = family.course(scene, effect, effect.p), float(rank)
    if len(courses) < 2:
        return
    p_value = 0.0
    for (a, rank), (b, other) in itertools.combinations(courses.values(), 2):
        a, b = a - a.mean(), b - b.mean()
        share = float(np.abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a).real * np.vdot(b, b).real + 1e-300))
        by_chance = (1 - min(share, 1.0)) ** max(min(rank, other) - 1, 0.0)  # of two random courses of so many numbers
        p_value = max(p_value, by_chance if share > ALIKE else 1.0)
    if p_value < UNEXPLAINED_P:
        where = {"time_s": [0.0, scene.duration_s]}
        yield _of(finding, "paths change alike, as no fading does", courses, p_value, where, "second_link")


def _along_a_line(finding: Finding):
    """A path whose strength changes and whose phase does not, or the other way round: many that scatter make both."""
    for i, effect in _found(finding):
        family = FAMILIES[effect.family]
        if {"gain", "phase"} <= {*family.wanders}:
            p_value = of_one_line(*family.spectrum_of(effect))
            where = {"time_s": [0.0, finding.scene.duration_s]}
            yield _of(finding, "a path that changes along one line, as no fading does", (i,), p_value, where, "longer_recording")


def _gain_in_pieces(finding: Finding):
    """A gain that steps, hums, drifts and fades at once: it changes in a way of its own. Paths that fade, each on its own, are
    one of its pieces."""
    found = _found(finding)
    fading = [i for i, e in found if "gain" in FAMILIES[e.family].wanders]
    pieces = [i for i, e in found if FAMILIES[e.family].of_gain] + sorted(fading, key=finding.gain_of)[-1:]
    if len(pieces) >= PIECES_OF_GAIN:
        sure = sorted(finding.gain_of(i) for i in pieces)[(len(pieces) - 1) // 2]  # most of them are
        p_value = float(np.exp(-max(sure, 0.0)))
        where = {"time_s": [0.0, finding.scene.duration_s]}
        yield _of(
            finding, f"a gain in {len(pieces)} pieces: it changes in a way of its own", pieces, p_value, where, "longer_recording"
        )


def _beats_at_rails(finding: Finding):
    """A gain that wanders where a band of interference reaches the rails: they take from the signal as the band beats."""
    found = _found(finding)
    if any(plays(e, Role.RAILS) for _, e in found) and any(FAMILIES[e.family].band(e) for _, e in found):
        for i in (i for i, e in found if "gain" in FAMILIES[e.family].wanders):
            p_value = float(np.exp(-max(finding.gain_of(i), 0.0)))
            where = {"time_s": [0.0, finding.scene.duration_s]}
            test = "a gain that wanders where interference reaches the rails: they take from the signal as it beats"
            yield _of(finding, test, (i,), p_value, where, "mute_transmitter")


def _gates_at_slips(finding: Finding):
    """What comes and goes, and each time when samples are lost or come twice, and at no other time."""
    scene, found = finding.scene, _found(finding)
    moments = [FAMILIES[e.family].moment(scene, e) for _, e in found if plays(e, Role.SLIP)]
    slips = np.array([np.searchsorted(scene.index, moment) for moment in moments if moment is not None and np.isfinite(moment)])
    for i, effect in found:
        gate = FAMILIES[effect.family].gate(scene, effect)
        if gate is None or not gate.any():
            continue
        turns = np.flatnonzero(np.diff(np.concatenate([[0], gate.astype(np.int8), [0]])))
        begins, ends = turns[::2], turns[1::2]
        within = [
            np.any((begin - AT_A_SLIP <= slips) & (slips <= end + AT_A_SLIP)) for begin, end in zip(begins, ends, strict=True)
        ]
        if len(begins) <= len(slips) and all(within):
            where = {"time_s": [float(scene.index[k] / scene.sample_rate_hz) for k in (begins[0], ends[-1] - 1)]}
            test = "interference that is on where samples are lost, and nowhere else"
            yield _of(finding, test, (i,), float(np.exp(-max(finding.gain_of(i), 0.0))), where, "mute_transmitter")
