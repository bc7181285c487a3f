# SPDX-License-Identifier: GPL-3.0-or-later
"""From a case to its diagnosis: every recording on its own, then all of them together."""

import re
import time
from dataclasses import dataclass, replace

import numpy as np

from ..twin.effects import FAMILIES, Role, plays, stage_of
from ..twin.effects.base import RX_FILTER
from . import (
    align,
    ambiguity,
    blanks,
    claims,
    copies,
    evenness,
    flatness,
    floor,
    gate,
    jitter,
    noise,
    offsets,
    presence,
    residual,
    slips,
    slow,
)
from .doubts import doubts
from .exchange import exchanged
from .finding import Finding, nmse, numbers, worth
from .fit import Fit, of_even_noise, solve
from .ownership import agree_on_families, agree_on_sides, agree_on_wander
from .passing import without_passing
from .policy import (
    BUDGET_S,
    COLOUR_ORDERS,
    CROWDED_P,
    CUT_NATS,
    FINE_GRID,
    FIRST_PART,
    HUNGRY,
    MOST_FINDINGS,
    MOST_SWAPS,
    PICTURES,
    PROOF,
    RECORDINGS,
    SEARCH,
    SEARCH_MARGIN,
    TOLD_SIGMA,
    UNEXPLAINED_NATS,
    UNEXPLAINED_P,
    UNEXPLAINED_SHARE,
)
from .search import beginnings, is_apart, quantiser_again, refit, search, through_the_quantiser, told_on_its_side
from .verdict import Words, conclude


def examine(case, observation, *, deadline: float, progress=lambda where: None) -> list[Finding]:
    """Search one recording: its first part in full, every other from what the first one showed, and what lies between two
    between which something happened."""
    parts, findings = align.parts_of(case, observation), []
    for k, (part, near) in enumerate(parts):
        progress(f"{observation.name}, part {k + 1} of {len(parts)}")
        left = deadline - time.thread_time()
        if findings and left < 0:
            break
        share = FIRST_PART if k == 0 and len(parts) > 1 else 1 / (len(parts) - k)
        heard = next((f for f in findings if not f.absent), None)
        findings.append(_examine_part(case, observation, part, near, heard, time.thread_time() + left * share))
    findings, silent = [f for f in findings if not f.absent], [f for f in findings if f.absent]
    if not findings:  # one part stands for all
        return silent[:1]
    findings[0].left += [presence.of_a_part(f) for f in silent]
    while (gap := slips.gap(findings) or slow.gap(findings)) and time.thread_time() < deadline and len(findings) < MOST_FINDINGS:
        progress(f"{observation.name}, between its parts")
        part = align.around(case, observation, gap, len(findings[0].observation.samples))
        if part is None:
            break
        findings.append(_examine_part(case, observation, part, None, findings[0], deadline))
    slips.between(findings)
    slow.between(findings)
    return findings


def _examine_part(case, whole, part, near, known: Finding | None, deadline: float) -> Finding:
    begun = time.thread_time()
    near, elsewhere_nats = (near, 0.0) if known is None else slips.place(case, part, near, known)
    scene, data, model = align.build(case, part, near=near)
    data = replace(data, deadline=begun + SEARCH * (deadline - begun))
    model = _clocks_as_told(data, told_on_its_side(data, model))
    plain = replace(model, effects=tuple(e for e in model.effects if e.fixed))
    stds = {}
    known_of = {e.family for e in plain.effects}
    for effect, std in gate.discrete(part.samples.astype(complex), part.datatype):
        if effect.family not in known_of:  # the twin's own rails and quantiser are no finding
            model = model.adding(effect)
            stds[effect.family] = std
    twin = first = refit(data, plain)
    if model.effects != plain.effects:
        built = model  # of which the delay stays: without its carrier a fit moves a chirp
        model = replace(through_the_quantiser(data, refit(data, model).model), base=built.base)
        first = refit(data, model)
        model, first = _without_false_rails(data, built, model, first)
    if known is None and not presence.judge(data, model).there:
        return _absent(case, part, data, first, twin, stds)
    scene.rms = known.scene.rms if known else _wanted_rms(first) * align.whole_over_part(case, whole, part, scene)
    have = {e.family for e in model.effects}
    for effect in known.fit.model.found if known else ():
        if FAMILIES[effect.family].lasting and effect.family not in have:
            model = model.adding(FAMILIES[effect.family].moved_to(effect, known.scene, scene))
    if known:
        model = offsets.with_gains(data, model)
    data, begun_with, foreign = _begun(data, model, known)
    proof = begun + PROOF * (deadline - begun)
    fit, *known_fits = search(data, begun_with, proof) if known is None else _confirmed(known, data, begun_with[0], proof)
    complete = not fit.notes.get("cut", data.late)
    fit = exchanged(_until(fit, proof), known_fits) if known is None else fit
    fit = quantiser_again(data, fit)
    fit = _sure(_without_fine_quantiser(_settle(_without_crowds(_until(fit, deadline)), finer=known is None)))
    fit, passed = without_passing(_of_noise_alone(fit))
    # In the first fit the wanted signal may have been next to nothing.
    scene.level = known.scene.level if known else scene.rms * _wanted_rms(fit) / _wanted_rms(first)
    finding = Finding(
        observation=part,
        scene=scene,
        data=replace(data, deadline=deadline),
        twin=twin,
        fit=fit,
        known=known_fits,
        complete=complete,
        stds=stds,
        later=known is not None,
        elsewhere_nats=elsewhere_nats,
        left=[*foreign, *passed],
    )
    _weigh(finding)
    jitter.alone(finding)
    _look_for_rest(finding)
    floor.compare(finding)
    return finding


def _clocks_as_told(data, model):
    """The model with the twin's own clocks standing still where a fit would move them farther than the twin leaves open: what is
    beyond is a mismatch."""
    clocks = [i for i, e in enumerate(model.effects) if e.fixed and plays(e, Role.CLOCK) and "_told" in e.aux]
    for i in clocks:
        own, fit, at = model.effects[i], refit(data, model), model.span(i).start
        off = float(fit.model.effects[i].p[0] - own.p[0])
        if off**2 > TOLD_SIGMA**2 * (own.aux["_told"][0] ** 2 + fit.covariance[at, at]):
            model = model.replacing(i, replace(own, free=np.zeros_like(own.free)))
    return model


def _absent(case, part, data, fit: Fit, twin: Fit, stds: dict) -> Finding:
    """What a recording says in which the twin's waveform is not: what was read off its samples, and that."""
    model = replace(fit.model, effects=tuple(e for e in fit.model.effects if not plays(e, Role.ORIENTATION)))
    left = [presence.statement(data.scene, *align.looked_at(case, part))]
    fit = _without_fine_quantiser(refit(data, model) if model.effects != fit.model.effects else fit)
    return Finding(observation=part, scene=data.scene, data=data, twin=twin, fit=fit, stds=stds, left=left, absent=True)


def _weigh(finding: Finding, swaps: int = MOST_SWAPS) -> None:
    """What every effect of a finding is worth; one that samples contradict which were not fitted is taken out, and a rival that
    explains more takes the place of what was found."""
    if not finding.later:
        better = _compare(finding)
        if better is not None and swaps and not finding.data.late:
            _begin_again(finding, better)
            return _weigh(finding, swaps - 1)
    for i, effect in enumerate(finding.fit.model.effects):
        if not effect.fixed:
            finding.worth_of(i)
    at = claims.broken(finding)
    if at is not None and not finding.data.late:
        less = refit(finding.fit.data, finding.fit.model.without(at))
        _begin_again(finding, less)
        _weigh(finding, swaps)


def _begin_again(finding: Finding, fit: Fit) -> None:
    """Have a finding stand on another fit, of which nothing is weighed yet."""
    finding.fit, finding.worths, finding.ambiguous = _sure(_settle(fit, finer=False)), {}, []


def _sure(fit: Fit) -> Fit:
    """The fit without what is claimed without need."""
    at = claims.unsure(fit)
    if at is None or fit.data.late:
        return fit
    return _sure(_settle(refit(fit.data, fit.model.without(at)), finer=False))


def _without_false_rails(data, built, model, first: Fit):
    """(model, its fit) without rails that may be something else, unless they cut the prediction: on a grid a signal of few
    levels heaps up as rails would, and at one end alone so may the peak of a waveform. Without a grid it is then as it was
    `built`: false rails have moved the delay."""
    at, quantised = model.index_of(Role.RAILS, found=True), model.index_of(Role.QUANTISER, found=True) is not None
    if at is None or not quantised and "lone" not in model.effects[at].aux:
        return model, first
    uncut = through_the_quantiser(data, model.without(at)) if quantised else built.without(at)
    free = refit(data, uncut)
    return (model, first) if free.likelihood < first.likelihood - CUT_NATS else (uncut, free)


def _begun(data, model, known: Finding | None):
    """(the data without a stretch that is not what the twin says, the fits to begin with, [what is left there] or [])."""

    def fits(data):
        return beginnings(data, model) if known is None else [refit(data, model)]

    begun_with = fits(data)
    found = residual.foreign(begun_with[0])
    if found is None:
        return data, begun_with, []
    stretch, left = found
    data = replace(data, use=np.where(stretch, 0.0, data.use), vault=data.vault & ~stretch)
    return data, fits(data), [left]


def _confirmed(known: Finding, data, fit: Fit, proof: float) -> list[Fit]:
    """A later part of a recording: the fit of what its first part showed, and a search where more is left than there."""
    before: dict[str, float] = {}
    for rest in known.tested:
        before[_kind(rest)] = max(before.get(_kind(rest), 0.0), rest.nats)
    louder = max(fit.sigma2 / known.fit.sigma2, 1.0)
    raised = data.count * (louder - 1 - np.log(louder)) > UNEXPLAINED_NATS
    left = _tests(fit)
    if raised or any(r.p_value < UNEXPLAINED_P and r.nats > max(UNEXPLAINED_NATS, 2 * before.get(_kind(r), 0.0)) for r in left):
        return search(data, beginnings(data, fit.model), proof)
    return [fit]


def _of_noise_alone(fit: Fit) -> Fit:
    """The fit without a receiver's filter that the noise alone shows: what a twin predicts does not pass the filter's edges, and
    noise that a receiver colours, or a phase that is too fast to be followed, is no mismatch of a filter."""
    model = fit.model
    at = next((i for i, e in enumerate(model.effects) if not e.fixed and stage_of(e) == RX_FILTER), None)
    if at is None or fit.data.late:
        return fit
    bare = solve(fit.data, model.without(at))
    return bare if bare.evidence > fit.evidence + COLOUR_ORDERS * np.log(fit.data.count) - SEARCH_MARGIN else fit


def _until(fit: Fit, deadline: float) -> Fit:
    """A fit whose offspring have another deadline."""
    return replace(fit, data=replace(fit.data, deadline=deadline))


def _light(finding: Finding, deadline: float) -> None:
    """Let go of what only the search needs, and give what comes after it a deadline of its own."""
    finding.data = replace(finding.data, deadline=deadline)
    finding.fit = replace(_until(finding.fit, deadline), columns=[], notes={})
    finding.twin = replace(_until(finding.twin, deadline), columns=[], notes={})
    finding.known = []
    finding.scene.forget()


def _without_crowds(fit: Fit) -> Fit:
    """The fit without impulses that stand together in one stretch of time: that is something else, and is left."""
    if residual.crowded_impulses(fit) > CROWDED_P:
        return fit
    return refit(fit.data, fit.model.without(next(i for i, e in enumerate(fit.model.effects) if FAMILIES[e.family].scattered)))


def _without_fine_quantiser(fit: Fit) -> Fit:
    """The fit without a grid that is there but too fine to change the recording: a converter's own."""
    model = fit.model
    for i, e in enumerate(model.effects):
        if plays(e, Role.QUANTISER) and FAMILIES[e.family].rounding(e) * fit.data.count < FINE_GRID * fit.sigma2:
            return replace(fit, model=model.without(i))
    return fit


def _compare(finding: Finding) -> Fit | None:
    """Every found effect against its rivals; the fit with the one that explains most more, None where none does."""
    fit, nearest = finding.fit, []
    for i, effect in enumerate(fit.model.effects):
        if not finding.is_cause(effect):
            continue
        bare, rivals = ambiguity.rivals(fit, i, finding.known)
        if finding.data.late:  # cut short, they tell nothing
            break
        finding.worths[effect.key] = worth(fit, bare, rivals)
        nearest += [r for r in rivals[:1] if r.fit is not None and r.evidence < -SEARCH_MARGIN]
        if entry := ambiguity.open_beside(fit, effect, rivals):
            finding.ambiguous.append(entry)
    return min(nearest, key=lambda r: r.evidence).fit if nearest else None


def _settle(fit: Fit, finer: bool) -> Fit:
    """Let every number of what was found move (a drift, a Doppler), and note the floor that noise is told
    against."""
    scene = fit.data.scene
    effects = tuple(e if e.fixed else replace(e, free=FAMILIES[e.family].settled(scene, e)) for e in fit.model.effects)
    if any((a.free != b.free).any() for a, b in zip(effects, fit.model.effects, strict=True)):
        freed = refit(fit.data, replace(fit.model, effects=effects))
        if freed.likelihood > fit.likelihood - 1.0:
            fit = freed
    fit = noise.with_blur(jitter.of_a_wander(_finer(fit) if finer else fit))
    covariance = fit.covariance
    effects = []
    for i, e in enumerate(fit.model.effects):
        if FAMILIES[e.family].noise_like:
            e = replace(e, aux={**e.aux, "_floor": noise.floor_of(fit, e)})
        elif e.prior is not None:
            span = fit.model.span(i)
            e = FAMILIES[e.family].settled_law(scene, e, covariance[span, span])
        effects.append(e)
    return replace(fit, model=replace(fit.model, effects=tuple(effects)))


def _wanted_rms(fit: Fit) -> float:
    return float(np.sqrt(np.mean(np.abs(fit.chain.wanted[fit.data.use > 0]) ** 2)))


def _finer(fit: Fit) -> Fit:
    """The fit with what follows a course as fast as the search does in its finest forms, and under the laws that its numbers
    tell, where they are likelier."""
    models, scene = [], fit.data.scene
    for i, effect in enumerate(fit.model.effects):
        family = FAMILIES[effect.family]
        forms = [*family.finest(scene, effect)]
        if effect.prior is not None and not effect.fixed:
            own = fit.covariance[fit.model.span(i), fit.model.span(i)]
            forms += family.other_laws(scene, effect, own)
            for law, cycles in (pair for other in FAMILIES.values() for pair in other.instead_of(scene, effect, own)):
                models.append(_with_carrier(fit.model.replacing(i, law), cycles))
        models += [fit.model.replacing(i, form) for form in forms]
    return max([fit, *(refit(fit.data, model) for model in models)], key=lambda f: f.evidence)


def _with_carrier(model, cycles: np.ndarray):
    """The model with a carrier by so many cycles of offset and drift farther off, as far as these are free."""
    at = next((i for i, e in enumerate(model.effects) if plays(e, Role.CARRIER) and e.free.any()), None)
    return model if at is None else model.replacing(at, (e := model.effects[at]).moved(e.p + cycles * e.free))


def _kind(rest: residual.Leftover) -> str:
    """A test without the numbers that it found."""
    return re.split(r"[-\d]", rest.test)[0]


def _tests(fit: Fit) -> list[residual.Leftover]:
    """Every test of what a fit leaves."""
    fit = jitter.along(fit)
    inside = of_even_noise(fit)
    return [
        *residual.leftovers(fit, inside),
        *flatness.left(fit, inside),
        *evenness.left(fit, inside),
        *copies.left(fit, inside),
    ]


def _look_for_rest(finding: Finding) -> None:
    fit = finding.fit
    scene, found = fit.data.scene, fit.model.found
    bands = [FAMILIES[e.family].spectrum(scene, e) for e in found if FAMILIES[e.family].band(e)]
    louder = [FAMILIES[e.family].variance(scene, e, fit.chain.wanted) for e in found if is_apart(e)]
    # What a band of noise holds, or a stretch of louder noise, is no signal that was explained.
    louder = np.prod(louder, axis=0) * np.ones(fit.data.y.shape)
    level = fit.sigma2 * np.mean(np.prod(bands, axis=0)) * np.mean(louder[fit.data.use > 0])
    explained = max(0.0, finding.twin.sigma2 / level - 1) * fit.data.count
    beyond = [_beyond(finding, i) for i, e in enumerate(fit.model.effects) if FAMILIES[e.family].beyond]
    finding.tested = _tests(fit)
    # What is fitted, and no cause, is measured as causes are: in nats.
    finding.explained_nats = fit.data.count * float(np.log1p(explained / fit.data.count))
    for rest, against in [*((r, explained) for r in finding.tested), *((r, finding.explained_nats) for r in beyond)]:
        if rest.p_value < UNEXPLAINED_P and rest.nats > max(UNEXPLAINED_NATS, UNEXPLAINED_SHARE * against):
            finding.left.append(rest)
    finding.left += [jump for jump in residual.jumps(fit) if jump.p_value < UNEXPLAINED_P]
    finding.left += blanks.left(fit)
    finding.left += doubts(finding)
    later = finding.observation.first / finding.scene.sample_rate_hz
    for rest in finding.left:
        if "time_s" in rest.where:
            rest.where["time_s"] = [later + t for t in rest.where["time_s"]]


def _beyond(finding: Finding, index: int) -> residual.Leftover:
    """An effect that is no cause of the contract, as what is left."""
    nats, family = finding.gain_of(index), FAMILIES[finding.fit.model.effects[index].family]
    values, constants = numbers(finding, index)
    plain = {k: v["value"] for k, v in values.items()}
    where = {"time_s": [0.0, finding.scene.duration_s], **family.where(finding.scene, finding.fit.model.effects[index], plain)}
    sentence = family.describe(Words(values, constants))
    return residual.Leftover(test=sentence.rstrip("."), p_value=float(np.exp(-max(nats, 0.0))), nats=nats, where=where)


def predict_only(case, observation, entries, findings, deadline: float = np.inf) -> tuple[float, float, float]:
    """(twin, corrected, noise) NMSE of a recording for the vault: by the twin, and by the twin with the entries of what was found
    in others, as `twin_corrected.yaml` has them."""
    twin, corrected = (_foretold(c, observation, deadline) for c in (case, replace(case, effects=(*case.effects, *entries))))
    alike = lambda f: (f.observation.receiver == observation.receiver, set(f.observation.on_air) == set(observation.on_air))  # noqa: E731
    told = twin.data.noise_power or max(findings, key=alike).fit.sigma2
    power = float(np.mean(np.abs(twin.data.y) ** 2))
    return (*(nmse(fit.data, fit.chain.y, fit.data.vault) for fit in (twin, corrected)), told / power)


def _foretold(case, observation, deadline: float) -> Fit:
    """What a twin predicts of a recording for the vault: its own delay and gain alone are fitted."""
    part, near = align.parts_of(case, observation)[0]
    _, data, model = align.build(case, part, near=near)
    frozen = tuple(replace(e, free=np.zeros(len(e.p), bool)) for e in model.effects)
    data = replace(data, use=data.vault.astype(float), deadline=deadline)
    return refit(data, told_on_its_side(data, replace(model, effects=frozen)))


@dataclass(kw_only=True)
class Diagnosis:
    """What `write` turns into files: the contract's document and the findings behind it; `deadline`, on time.thread_time(): a
    report draws no picture after it."""

    case: object
    document: dict
    findings: list[Finding]
    deadline: float = np.inf


def diagnose(case, *, budget_s: float = BUDGET_S, progress=lambda where: None) -> Diagnosis:
    """Diagnose a case within `budget_s` seconds of processor time, so that a loaded machine says what an idle one says: when they
    are over, the verdict is `unexplained` with what was found so far. `progress` is called with where the diagnosis stands."""
    begun, woken = time.thread_time(), time.monotonic()
    fitted = [o for o in case.observations if not o.vault]
    findings = []
    for k, observation in enumerate(fitted):
        share = (RECORDINGS * budget_s - (time.thread_time() - begun)) / (1 + (len(fitted) - k - 1) / HUNGRY)
        findings += examine(case, observation, deadline=time.thread_time() + share, progress=progress)
        for finding in findings:
            _light(finding, begun + budget_s)
    heard = [f for f in findings if not f.absent]
    agree_on_sides(heard)
    agree_on_wander(heard)
    agree_on_families(heard)
    for finding in heard:
        finding.fit = floor.without_rounding(finding.fit)

    def vault(entries):
        return [predict_only(case, o, entries, findings, begun + budget_s) for o in case.observations if o.vault]

    document = conclude(case, findings, vault)
    document["seconds"] = round(time.monotonic() - woken, 3)
    return Diagnosis(case=case, document=document, findings=findings, deadline=begun + PICTURES * budget_s)
