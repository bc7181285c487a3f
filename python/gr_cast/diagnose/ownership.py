# SPDX-License-Identifier: GPL-3.0-or-later
"""Whose effect it is: an effect is fitted in every recording, and the node or link whose recordings,
together, say it most
loudly owns it.

For a recording with its own optimum θ_r of curvature H_r, ln L at a common θ is that of θ_r less ½(θ −
θ_r)ᵀH_r(θ − θ_r).
"""

from dataclasses import dataclass, replace

import numpy as np

from ..twin.effects import FAMILIES, Effect, Role, plays, stage_of
from ..twin.effects.base import TX_LO
from .fit import Fit, invert
from .policy import SEARCH_MARGIN, SIDES_ALIKE_NATS, SILENT_NATS, VERDICT_LEAST_NATS
from .search import candidates, refit


@dataclass(frozen=True, kw_only=True)
class Voice:
    """What one recording says of an effect: ln L it gains, its numbers and their curvature; whether it was
    found there."""

    finding: object
    index: int | None
    gain: float
    p: np.ndarray
    curvature: np.ndarray
    seen: bool


def agree_on_sides(findings) -> None:
    """Where one recording has an effect in front of the channel and another behind it, put all on the side that loses
    nothing, if there is one: a single recording often cannot tell."""
    for family in (f.name for f in FAMILIES.values() if f.two_sided):
        holders = [(f, i) for f in findings for i, e in enumerate(f.fit.model.effects) if e.family == family and not e.fixed]
        if len({f.fit.model.effects[i].aux["side"] for f, i in holders}) < 2 or len({id(f) for f, _ in holders}) < len(holders):
            continue
        found = sum(f.fit.likelihood for f, _ in holders)
        moved = {side: [_on_side(f.fit, i, side) for f, i in holders] for side in ("tx", "rx")}
        best = max(moved.values(), key=lambda fits: sum(fit.likelihood for fit in fits))
        if sum(fit.likelihood for fit in best) > found - SIDES_ALIKE_NATS * len(holders):
            for (finding, _), fit in zip(holders, best, strict=True):
                finding.refitted(fit)


def agree_on_wander(findings) -> None:
    """Where one recording shows a carrier offset and another the phase noise of the same oscillator, let it be phase noise in
    both, if that costs no more than what one effect less is worth: the slow part of a wander is an offset."""
    wandering = [f for f in findings if f.fit.model.index_of(Role.WANDER, found=True) is not None]
    for finding in findings:
        fit = finding.fit
        offset = fit.model.index_of(Role.CARRIER, found=True)
        apart = any(other is finding for other in wandering) or not any(_meet(finding, w) for w in wandering)
        if offset is None or apart or finding.later:
            continue
        bare = refit(fit.data, fit.model.without(offset))
        course = next((s.effect for s in candidates(bare) if plays(s.effect, Role.WANDER)), None)
        other = refit(fit.data, bare.model.adding(course)) if course else fit
        if other.evidence > fit.evidence - SEARCH_MARGIN:
            finding.refitted(other)


def agree_on_families(findings) -> None:
    """Where one recording leaves two families open, let it be the one that the other recordings of one owner have."""
    for finding in findings:
        if (other := _agreed(findings, finding)) is not None:
            finding.refitted(other)


def _agreed(findings, finding) -> Fit | None:
    """The fit of a recording with another family in the place of one that it leaves open, where others speak for that."""
    for i, effect in enumerate(finding.fit.model.effects):
        mine, worth = FAMILIES[effect.family].told, finding.worths.get(effect.key)
        if finding.later or worth is None or not finding.is_cause(effect):
            continue
        least = _elsewhere(findings, finding, effect.family) + VERDICT_LEAST_NATS
        for rival in (r.effect for r in worth.rivals if FAMILIES[r.effect.family].told in _open(finding, mine) - {mine}):
            if _elsewhere(findings, finding, rival.family) > least:
                other = refit(finding.data, finding.fit.model.without(i).adding(rival))
                if other.likelihood > finding.fit.likelihood - SIDES_ALIKE_NATS:
                    return other
    return None


def _open(finding, told: str) -> set[str]:
    """The names of the families that a recording leaves open where it has one, its own among them."""
    return {told}.union(*(entry["families"] for entry in finding.ambiguous if told in entry["families"]))


def _elsewhere(findings, finding, name: str) -> float:
    """Nats for a family, or for what may be it, in the other recordings of the owner of which they say most, if it has a part in
    one of a finding."""
    here, told, nats = finding.observation.name, FAMILIES[name].told, {}
    for f in findings:
        if f.observation.name != here:
            mine = [i for i, e in enumerate(f.fit.model.effects) if f.is_cause(e) and told in _open(f, FAMILIES[e.family].told)]
            nats[f.observation.name] = max((f.gain_of(i) for i in mine), default=0.0)
    return max((sum(nats.get(r, 0.0) for r in group) for group in groups(findings, FAMILIES[name]) if here in group), default=0.0)


def _meet(a, b) -> bool:
    """Whether two recordings have a radio in common."""
    return a.observation.receiver == b.observation.receiver or bool(set(a.scene.transmitters) & set(b.scene.transmitters))


def _on_side(fit: Fit, index: int, side: str) -> Fit:
    effect = fit.model.effects[index]
    if effect.aux["side"] == side:
        return fit
    aux = {**effect.aux, "side": side, "source": 0}
    return refit(fit.data, fit.model.without(index).adding(replace(effect, p=np.zeros(len(effect.p)), aux=aux)))


def kind_of(finding, effect: Effect) -> tuple:
    """What makes effects in several recordings candidates for being one."""
    family = FAMILIES[effect.family]
    if family.level == "link":
        return (effect.family, link_of(finding, effect), effect.aux.get("tap"))
    side = None if family.either_side else effect.aux.get("side")
    converter = finding.observation.receiver if "read" in effect.aux else None  # two that clip are two
    alone = None if family.either_side else sender(finding, effect)
    return (effect.family, side, effect.aux.get("code"), alone, converter)


def sender(finding, effect: Effect) -> str | None:
    """The transmitter whose signal alone an effect changes, where others are heard beside it."""
    several = len(finding.scene.transmitters) > 1 and stage_of(effect) <= TX_LO
    return finding.scene.transmitters[effect.aux["source"]] if several and "source" in effect.aux else None


def link_of(finding, effect: Effect) -> str:
    source = finding.scene.taps[effect.aux["tap"]].source if "tap" in effect.aux else effect.aux.get("source", 0)
    return f"{finding.scene.transmitters[source]}>{finding.observation.receiver}"


def voices(findings, members, trust: float = 1.0) -> list[Voice]:
    """Every recording on one effect; `members` are (finding, index) where it was found."""
    strongest, at = max(members, key=lambda m: m[0].gain_of(m[1]))
    template = strongest.fit.model.effects[at]
    out = []
    for finding in findings:
        there = FAMILIES[template.family].moved_to(template, strongest.scene, finding.scene)
        own = next((i for f, i in members if f is finding), None)
        if own is None and any(f.observation.name == finding.observation.name for f, _ in members):
            continue  # another part of the same recording speaks for it
        if own is not None:
            out.append(_voice(finding, finding.fit, own, finding.gain_of(own), True))
        elif there is None or FAMILIES[template.family].noise_like or not template.free.any() or template.prior is not None:
            out.append(
                Voice(
                    finding=finding,
                    index=None,
                    gain=0.0,
                    p=np.zeros(0),
                    curvature=np.zeros((0, 0)),
                    seen=False,
                )
            )
        else:
            aux = {k: v for k, v in there.aux.items() if k != "nats"}
            effect = replace(there, aux=aux)
            forced = refit(finding.data, finding.fit.model.adding(effect))
            index = next(i for i, e in enumerate(forced.model.effects) if e.key == effect.key)
            out.append(_voice(finding, forced, index, max(0.0, forced.likelihood - finding.fit.likelihood), False))
    return out


def _voice(finding, fit: Fit, index: int, gain: float, seen: bool) -> Voice:
    effect, span = fit.model.effects[index], fit.model.span(index)
    if len(fit.model.vector()) == len(fit.hessian) and effect.free.any():
        curvature = invert(fit.covariance[span, span])
    else:
        curvature = np.zeros((int(effect.free.sum()),) * 2)
    return Voice(
        finding=finding,
        index=index if seen else None,
        gain=gain,
        p=effect.p[effect.free],
        curvature=curvature,
        seen=seen,
    )


def weigh(family: str, heard: list[Voice], group: set[str]) -> float:
    """ln L of "the recordings of `group` share this effect" over "no recording has it"."""
    inside = [v for v in heard if v.finding.observation.name in group]
    sizes = {len(v.p) for v in inside}
    if FAMILIES[family].common and len(sizes) == 1 and 0 not in sizes:
        total = sum(v.curvature for v in inside)
        mean = invert(total) @ sum(v.curvature @ v.p for v in inside)
        return float(sum(v.gain - 0.5 * (mean - v.p) @ v.curvature @ (mean - v.p) for v in inside))
    loudest = max(heard, key=lambda v: v.gain)
    score = 0.0
    for v in inside:
        if v.seen:
            score += v.gain
        elif len(v.p) and len(loudest.p) == len(v.p):
            score += v.gain - min(SILENT_NATS, 0.5 * float(loudest.p @ v.curvature @ loudest.p))
        else:
            score -= SILENT_NATS
    return score


def owners(findings, family) -> list[tuple[str, str, set[str]]]:
    """(level, name, recordings) of everything that could own an effect of a family."""
    everything = {f.observation.name for f in findings}
    if family.level == "environment":
        return [("environment", "environment", everything)]
    out = []
    for level in (side for side in ("tx", "rx") if side in family.owners):
        names = (
            {tx for f in findings for tx in f.scene.transmitters} if level == "tx" else {f.observation.receiver for f in findings}
        )
        for name in sorted(names):
            mine = {
                f.observation.name
                for f in findings
                if (name in f.scene.transmitters if level == "tx" else f.observation.receiver == name)
            }
            out.append((level, name, mine))
    return out


def groups(findings, family) -> list[set[str]]:
    """The names of the recordings that one owner of a family has a part in, of every owner that it may have."""
    if family.level != "link":
        return [group for *_, group in owners(findings, family)]
    links = {(tx, f.observation.receiver) for f in findings for tx in f.scene.transmitters}
    return [
        {f.observation.name for f in findings if tx in f.scene.transmitters and f.observation.receiver == rx} for tx, rx in links
    ]


def owner(findings, members) -> tuple[dict, set[str]]:
    """(the contract's owner, names of the recordings that the owner has a part in)."""
    finding, index = members[0]
    effect = finding.fit.model.effects[index]
    family = FAMILIES[effect.family]
    if family.level == "link":
        name = link_of(finding, effect)
        return {"level": "link", "name": name}, {f.observation.name for f, _ in members}
    options = owners(findings, family)
    if name := sender(finding, effect):  # what the others send does not have it
        options = [o for o in options if o[:2] == ("tx", name)]
    if len(options) == 1:
        return {"level": options[0][0], "name": options[0][1]}, options[0][2]
    if len(findings) == 1 or len({frozenset(g) for _, _, g in options}) == 1:
        side = effect.aux.get("side") or ("tx" if family.level == "tx" else "rx")
        best = next((o for o in options if o[0] == side), options[0])
        rest = [o for o in options if o != best]
        name = {"level": best[0], "name": best[1]}
        if rest and len(family.owners) > 1:
            name["alternatives"] = [{"level": level, "name": other} for level, other, _ in rest]
        return name, best[2]
    heard = voices(findings, members)
    scores = sorted(((weigh(effect.family, heard, g), level, name, g) for level, name, g in options), key=lambda s: -s[0])
    best = scores[0]
    found = {"level": best[1], "name": best[2]}
    close = [s for s in scores[1:] if s[0] > best[0] - 3.0]
    if close:
        found["alternatives"] = [{"level": s[1], "name": s[2]} for s in close]
    return found, best[3]
