# SPDX-License-Identifier: GPL-3.0-or-later
"""What may be claimed of what was found: an effect has a size beyond its error, is not there to cancel another, and does not
fail on samples that were not fitted."""

import numpy as np

from ..twin.basis import course_length
from ..twin.effects import FAMILIES, Role, plays
from ..twin.model import predict
from .finding import Finding, numbers
from .fit import Fit, invert
from .policy import BROKEN_SIGMA, CANCELLED, LITTLE_NATS, SIZE_SIGMA


def unsure(fit: Fit) -> int | None:
    """The effect of a fit that is claimed without need: of no size within its error, or, of two that cancel each other, the one
    of the smaller size over its error; None where all may be claimed."""
    sizes = {i: size for i in range(len(fit.model.effects)) if (size := sigmas(fit, i)) is not None}
    least = min(sizes, key=sizes.get, default=None)
    if least is not None and sizes[least] < SIZE_SIGMA:
        return least
    added = {i: _added(fit, i) for i in sizes} if len(sizes) > 1 else {}
    for i in added:
        for j in (j for j in added if j > i):
            if _power(added[i] + added[j]) < CANCELLED * min(_power(added[i]), _power(added[j])):
                return min(i, j, key=sizes.get)
    return None


def sigmas(fit: Fit, index: int) -> float | None:
    """Size of an effect over its error, all else free (Wald 1943); None where its size is no number of the fit."""
    effect = fit.model.effects[index]
    sizes = [k for k in FAMILIES[effect.family].sizes if effect.free[k]]
    if effect.fixed or not sizes or len(fit.model.vector()) != len(fit.hessian):
        return None
    at = fit.model.span(index).start + np.cumsum(effect.free)[sizes] - 1
    return float(np.sqrt(effect.p[sizes] @ invert(fit.covariance[np.ix_(at, at)]) @ effect.p[sizes]))


def broken(finding: Finding) -> int | None:
    """The effect of a finding that makes held-out samples less likely where the fitted ones promise that it makes them likelier,
    the worst first, or that is worth less than nothing beside all that was found after it, or that is unfounded; None without
    one. What is there gains g ± √(2g) nats on samples of which the fitted ones promise g; impulses, which may come together, more
    or less."""
    worst = (BROKEN_SIGMA, None)
    for i, effect in enumerate(finding.fit.model.effects):
        if effect.fixed or "nats" in effect.aux or "read" in effect.aux:
            continue
        worth = finding.worth_of(i)
        if is_unfounded(finding, i):
            return i
        if worth.held_out is None:
            continue
        promised = _promised(finding, i)
        if worth.held_out < 0 < promised:
            chance = max(np.sqrt(2 * promised), worth.by_chance if FAMILIES[effect.family].scattered else 0.0)
            worst = max(worst, ((promised - worth.held_out) / chance, i))
        if worth.evidence < 0:
            return i
    return worst[1]


def _promised(finding: Finding, index: int) -> float:
    """Nats on held-out samples that the fitted ones promise of an effect."""
    data = finding.fit.data
    return finding.worth_of(index).evidence * data.vault.sum() / data.count


def by_chance(members: list[tuple[Finding, int]]) -> bool:
    """Whether chance may have left so few of the impulses of an effect, of [(finding, its number there)], to held-out samples."""
    asked = [(f.worth_of(i), _promised(f, i)) for f, i in members if f.worth_of(i).held_out is not None]
    lacking = sum(promised - worth.held_out for worth, promised in asked)
    return lacking < BROKEN_SIGMA * float(np.linalg.norm([worth.by_chance for worth, _ in asked]))


def is_unfounded(finding: Finding, index: int) -> bool:
    """Whether an effect is not what its name says, whatever it explains."""
    return _sizeless(finding, index) or _passes(finding, index) or _ends_a_course(finding, index)


def _sizeless(finding: Finding, index: int) -> bool:
    """Whether an effect brings little and its telling number is nothing within its error."""
    telling = FAMILIES[finding.fit.model.effects[index].family].telling
    if not telling or finding.worth_of(index).evidence >= LITTLE_NATS:
        return False
    number = numbers(finding, index)[0][telling]
    return abs(number["value"]) < SIZE_SIGMA * number["std"]


def _passes(finding: Finding, index: int) -> bool:
    """Whether an effect that lasts explains what a few stretches of the recording hold, and nothing of the others."""
    family = FAMILIES[finding.fit.model.effects[index].family]
    return family.lasting and not family.noise_like and not finding.worth_of(index).throughout


def _ends_a_course(finding: Finding, index: int) -> bool:
    """Whether an effect of one moment lies where a gain that wanders begins or ends: its cosines have no slope there, and a
    moment within half a period of the fastest mends that."""
    data, model = finding.fit.data, finding.fit.model
    scene, effect = data.scene, model.effects[index]
    courses = [e for e in model.found if "gain" in FAMILIES[e.family].wanders]
    moment = FAMILIES[effect.family].moment(scene, effect) if courses and plays(effect, Role.STEP) else None
    if moment is None:
        return False
    fewest = min(len(FAMILIES[e.family].spectrum_of(e)[0]) for e in courses)
    used = np.flatnonzero(data.use > 0)
    return min(moment - scene.index[used[0]], scene.index[used[-1]] - moment) < course_length(scene.span) / fewest


def _added(fit: Fit, index: int) -> np.ndarray:
    """(n,) what an effect changes of the prediction."""
    return (fit.chain.y - predict(fit.data.scene, fit.model.without(index)).y) * fit.data.use


def _power(signal: np.ndarray) -> float:
    return float(np.vdot(signal, signal).real)
