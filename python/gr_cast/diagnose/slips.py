# SPDX-License-Identifier: GPL-3.0-or-later
"""Sample slips between the parts of a recording, where nothing is fitted: every part against where the first one lets expect
it."""

from dataclasses import replace

import numpy as np

from ..twin.effects import FAMILIES, Role, plays, with_role
from ..twin.effects.base import start
from ..twin.entries import lost_before
from ..twin.model import predict
from . import align, offsets
from .finding import Finding, Worth
from .fit import misfit
from .policy import HELD, LEAST_JUMP, LEAST_PART, SLIPS_AROUND, SLIPS_SURE_NATS


def place(case, part, located: tuple[int, bool] | None, known: Finding) -> tuple[tuple[float, bool], float]:
    """((delay, inverted) of a later part of a recording, nats by which it is likelier there than where its first part lets
    expect it: 0 where it is there)."""
    expected = _expected(known, part, lost_before(case, part))
    first = 1 - known.fit.sigma2 * known.data.count / np.sum(np.abs(known.data.y * known.data.use) ** 2)
    held, _ = _held(case, part, expected, known)
    if held > HELD * first:
        return expected, 0.0
    middle, inverted = located or align.locate(case, part)
    begin = middle + _gained(known) * len(part.samples) / 2
    tries = [(*_held(case, part, (begin + d, inverted), known), begin + d) for d in SLIPS_AROUND]
    other, data, delay = max(tries, key=lambda t: t[0])
    nats = data.count * np.log((1 - held) / (1 - other))
    return ((delay, inverted), float(nats)) if nats > SLIPS_SURE_NATS else (expected, 0.0)


def _held(case, part, near, known: Finding):
    """(share of a part's energy that the prediction holds with the oscillators found in another part, data)."""
    scene, data, model = align.build(case, part, near=near)
    for effect in known.fit.model.found:
        if plays(effect, Role.CARRIER, Role.CLOCK):
            model = model.adding(FAMILIES[effect.family].moved_to(effect, known.scene, scene))
    y = predict(scene, offsets.with_gains(data, model)).y
    return 1 - misfit(data, y) / np.sum(np.abs(data.y * data.use) ** 2), data


def _expected(known: Finding, part, lost: int) -> tuple[float, bool]:
    """Where another part of the same recording, in front of which the twin knows so many samples to be lost, begins in the
    waveform."""
    ahead = part.first - known.observation.first
    delay = known.scene.anchor + known.fit.model.base[0] - ahead * (1 + _gained(known)) - (lost - known.scene.ahead)
    return delay, known.fit.model.index_of(Role.ORIENTATION, found=True) is not None


def _gained(known: Finding) -> float:
    """Samples that the received waveform gains per sample by its clock."""
    clock = next((e.p[0] for e in known.fit.model.effects if plays(e, Role.CLOCK)), 0.0)
    return clock / known.scene.span


def between(findings: list[Finding]) -> None:
    """Put samples that were lost between two parts of a recording into the later one, as an effect. `findings` are of one
    recording, the first one that of the part that was searched."""
    for before, after, lost, (first, last) in _jumps(findings):
        joint, width = (last + first) / 2 - after.observation.first, abs(last - first) + 1
        nats = max(after.elsewhere_nats, before.elsewhere_nats)
        std = {"time_s": width / np.sqrt(12) / after.scene.sample_rate_hz}
        aux = {"later": True, "nats": nats, "gap": float(width), "_stds": std}
        effect = start(with_role(Role.SLIP), [joint, lost], free=[False, False], aux=aux)
        after.fit = replace(after.fit, model=after.fit.model.adding(effect))
        after.worths[effect.key] = Worth(evidence=nats, held_out=None)


def gap(findings: list[Finding]) -> tuple[int, int] | None:
    """(first, last + 1) samples between two parts, neither of which holds them, between which samples are lost; None: none
    are."""
    return next((between for *_, between in _jumps(findings) if between[1] - between[0] >= LEAST_PART), None)


def _jumps(findings: list[Finding]):
    """(part before, part behind, samples lost between them, (first, last + 1) samples between what was fitted of both)."""
    in_time, period = sorted(findings, key=lambda f: f.observation.first), _period(findings[0].scene)
    for before, after in zip(in_time, in_time[1:], strict=False):
        lost = _slips(after, findings[0])[0] - _slips(before, findings[0])[1]
        if period:
            lost = (lost + period // 2) % period - period // 2
        if abs(lost) >= LEAST_JUMP:
            last, first = (f.observation.first + f.scene.index[f.data.use > 0][k] for f, k in ((before, -1), (after, 0)))
            yield before, after, lost, (int(last) + 1, int(first))


def _period(scene) -> int:
    """Samples of a waveform that repeats; 0 for one that is sent once."""
    return len(scene.sources[0].samples) if scene.sources[0].repeat else 0


def _slips(finding: Finding, known: Finding) -> tuple[int, int]:
    """Samples lost since the part that was searched, at the beginning and at the end of a part."""
    at, _ = _expected(known, finding.observation, finding.scene.ahead)
    here = round(at - finding.scene.anchor - finding.fit.model.base[0]) if finding.elsewhere_nats else 0
    begin = end = here
    for effect in finding.fit.model.found:
        if plays(effect, Role.SLIP):
            if effect.aux.get("later"):
                begin -= round(effect.p[1])
            else:
                end += round(effect.p[1])
    return begin, end
