# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be told apart: every found effect is swapped for its rivals; where the fit stays alike, both families stay open."""

from dataclasses import dataclass, replace

from ..twin.effects import FAMILIES, Effect
from ..twin.model import Model
from .fit import Fit
from .next_recording import Hypothesis, record_next
from .policy import ALIKE_NATS, ALIKE_TAPS_NATS, CHOICE, MOST_OPEN, NEAR_NATS, NEAR_SHARE, REFITS
from .search import candidates, claim_the_same, plausible, refit_or_known, roughness


@dataclass(frozen=True, kw_only=True)
class Rival:
    """The best other explanation of one effect: evidence behind it, ln L behind it, its fit where one was
    made."""

    effect: Effect
    evidence: float
    likelihood: float
    fit: Fit | None


def rivals(fit: Fit, index: int, known: list[Fit]) -> tuple[Fit, list[Rival]]:
    """(the fit without effect `index`, the rivals of that effect, the nearest first). `known`: fits that the search
    made."""
    effect = fit.model.effects[index]
    bare = refit_or_known(fit.data, fit.model.without(index), known)
    # A search prices what it fitted, a fit of what was found all that has an error.
    told = max((f.evidence for f in known if _what(f.model) == _what(fit.model)), default=fit.evidence)
    lost = max(told, fit.evidence) - bare.evidence + effect.aux.get("read", 0.0)
    found = []
    for s in candidates(bare) if not fit.data.late else ():
        family = FAMILIES[s.effect.family]
        if _same(effect, s.effect) or s.net < 0 or family.beyond:
            continue
        far = s.net < lost - max(NEAR_NATS, NEAR_SHARE * lost)  # a score is rough where an effect is strong
        promises = s.net > lost - roughness(lost) or _two_rows(effect, s.effect)
        if far or family.flexible and not promises:
            if not found:
                found.append(Rival(effect=s.effect, evidence=lost - s.net, likelihood=lost - s.net, fit=None))
            continue
        if sum(r.fit is not None and FAMILIES[r.effect.family].flexible == family.flexible for r in found) >= REFITS:
            continue
        if fit.data.late:
            break
        near = bare if family.noise_like else None
        # With all that has an error free, as what was found is.
        settled = replace(s.effect, free=family.settled(fit.data.scene, s.effect))
        other = refit_or_known(fit.data, bare.model.adding(settled), known, near=near)
        rival = Rival(
            effect=s.effect,
            evidence=bare.evidence + lost - other.evidence,
            likelihood=fit.likelihood - other.likelihood,
            fit=other,
        )
        if plausible(other.model) and not _holds(rival, effect):
            found.append(rival)
    for imitated in FAMILIES[effect.family].imitated(fit.data.scene, effect) if not fit.data.late else ():
        other = refit_or_known(fit.data, bare.model.adding(imitated), known)
        evidence, likelihood = bare.evidence + lost - other.evidence, fit.likelihood - other.likelihood
        found.append(Rival(effect=imitated, evidence=evidence, likelihood=likelihood, fit=other))
    return bare, sorted(found, key=lambda r: r.evidence)


def _what(model: Model) -> list[tuple]:
    """What a model claims, whatever the numbers and whichever of them are free."""
    return sorted((e.family, *(str(e.aux.get(name)) for name in ("tap", "side", "source", "held"))) for e in model.found)


def _same(a: Effect, b: Effect) -> bool:
    return claim_the_same(a, b) or b.family in FAMILIES[a.family].same_as or a.family in FAMILIES[b.family].same_as


def _two_rows(a: Effect, b: Effect) -> bool:
    """Whether two effects are rows of taps of different kinds."""
    return a.family != b.family and FAMILIES[a.family].row_of_taps and FAMILIES[b.family].row_of_taps


def all_alike(effect: Effect, rivals: list[Rival]) -> list[Rival]:
    """The rivals that the data leave open beside an effect, and what the data leave open beside those."""
    open_ones = [r for r in rivals if alike(effect, r)]
    for r in rivals:
        rows = [o for o in open_ones if _two_rows(o.effect, r.effect)]
        if r.fit and not any(r is o for o in open_ones) and any(abs(r.evidence - o.evidence) <= ALIKE_TAPS_NATS for o in rows):
            open_ones.append(r)
    return open_ones


def alike(effect: Effect, rival: Rival) -> bool:
    """Whether the data leave both open: as good a fit with no more freedom, both simple; or, where the rival is flexible,
    evidence that is alike."""
    if rival.fit is None:
        return False
    if _two_rows(effect, rival.effect):
        return rival.evidence <= ALIKE_TAPS_NATS
    if FAMILIES[rival.effect.family].flexible:
        return rival.evidence <= ALIKE_NATS
    if abs(rival.likelihood) > ALIKE_NATS or effect.prior is not None:
        return False
    freedom = CHOICE if not len(effect.p) and "tap" not in effect.aux else int(effect.free.sum())
    return int(rival.effect.free.sum()) <= freedom and rival.effect.prior is None


def open_beside(fit: Fit, effect: Effect, rivals: list[Rival]) -> dict | None:
    """The contract's entry of the other families that the data leave open beside an effect of `fit`; None without one."""
    name = FAMILIES[effect.family].told
    alike_ones = {FAMILIES[r.effect.family].told: r for r in reversed(all_alike(effect, rivals))}
    equal = sorted((r for other, r in alike_ones.items() if other != name), key=lambda r: r.evidence)[: MOST_OPEN - 1]
    if not equal:
        return None
    families, apart = [name, *(FAMILIES[r.effect.family].told for r in equal)], max(abs(r.likelihood) for r in equal)
    return {
        "families": families,
        "why": f"{' and '.join(families)} explain this recording equally well ({apart:.1f} nats apart).",
        "record_next": record_next([Hypothesis.of(f, like=fit) for f in (fit, *(r.fit for r in equal))]),
    }


def _holds(rival: Rival, effect: Effect) -> bool:
    """Whether a rival explains the same only by what it has of the effect's own family."""
    less = FAMILIES[rival.effect.family].less(rival.fit.data.scene, rival.effect, rival.fit.model.effects)
    return any(e.family == effect.family and e.aux.get("tap") == effect.aux.get("tap") for e in less)
