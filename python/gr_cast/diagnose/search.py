# SPDX-License-Identifier: GPL-3.0-or-later
"""Which effects: score tests of every family on the residual, joint refits of the best, a small beam,
backward elimination."""

import functools
import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft as sp_fft

from ..twin.columns import Dense, Lags, against, gram, inner
from ..twin.effects import FAMILIES, Effect, Multiplicity, Role, is_coarse, plays, stage_of, with_role
from ..twin.effects.base import RX_FILTER, RX_GAIN, RX_LO, start
from ..twin.model import RIDGE, Model, added, predict, traced
from . import heldout, noise, offsets
from .fit import Data, Fit, filters_noise, in_band, invert, misfit, off_the_rails, smooth_spectrum, solve, with_noise
from .policy import (
    ALIKE_NATS,
    ANOTHER_PATH,
    BEAM,
    CLEAR_NATS,
    CLEAR_SHARE,
    COLOUR_ORDERS,
    ELSEWHERE,
    ENOUGH_DEVIATIONS,
    FAR_SHARE,
    FULLER,
    INDEPENDENT,
    LAWS_ROUNDS,
    LEAP_STEPS,
    LEAST_COUNTED,
    LEAST_HELD_OUT,
    LEAST_JUMP,
    LEAST_OF_A_STEP,
    LEAST_OF_NOISE,
    LEAST_STEPS,
    LEAST_STRETCH,
    LEAST_TURN,
    LOUDEST,
    MANY,
    MOST_AT_ONE_PLACE,
    MOST_EFFECTS,
    NOISIEST,
    PRIOR_STEPS,
    PROOF_STEPS,
    REFITS,
    ROUGH_NATS,
    ROUGH_SHARE,
    SAME_PLACE,
    SEARCH_MARGIN,
    SEARCH_SURE_NATS,
    SEEN,
    SETTLED,
    SOFTENED_STEPS,
    STILL_NATS,
)
from .view import View


@dataclass(frozen=True, kw_only=True)
class Score:
    net: float
    effect: Effect


@dataclass(frozen=True, kw_only=True)
class Others:
    """Whitened derivatives of a fit, and all that are rows `together`, with the residual as the last one."""

    columns: list
    together: Dense

    @staticmethod
    def of(fit: Fit) -> "Others":
        columns = [replace(c, kept=True) if isinstance(c, Lags) else c for c in fit.columns]
        rows = [c.signals for c in columns if isinstance(c, Dense)]
        residual = fit.data.whitened(fit.residual[None])
        return Others(columns=columns, together=Dense(signals=np.concatenate([*rows, residual])))

    def against(self, columns) -> tuple[np.ndarray, np.ndarray]:
        """Inner products of `columns` with all derivatives (k, parameters), and with the residual (k,)."""
        products, at, found = inner(columns, self.together), 0, []
        for own in self.columns:
            if isinstance(own, Dense):
                found.append(products[:, at : at + len(own)])
                at += len(own)
            else:
                found.append(inner(columns, own))
        return np.concatenate(found, axis=1), products[:, -1]

    def slopes(self) -> np.ndarray:
        residual = Dense(signals=self.together.signals[-1:])
        return against(self.columns, residual)[:, 0]


def score(fit: Fit, effect: Effect) -> Score:
    """Predicted gain in evidence of adding an effect, by one Gauss-Newton step from its start (Rao's score
    test)."""
    data, family = fit.data, FAMILIES[effect.family]
    n, sigma2 = data.count, fit.sigma2
    if family.leaps:
        there = solve(data, fit.model.adding(effect), iterations=LEAP_STEPS)
        return Score(net=there.evidence - fit.evidence, effect=effect)
    if "others" not in fit.notes:
        fit.notes["others"] = others = Others.of(fit)
        _, fit.notes["before"] = traced(data.scene, fit.model)
        # What is left of the slope at the optimum: small, but not where a direction is all but one of the fit's own.
        fit.notes["slopes"] = 2 / sigma2 * others.slopes() - fit.model.prior_precision() * fit.model.vector()
    others, b_j, inverse, saved = fit.notes["others"], fit.notes["slopes"], fit.covariance, 0.0
    nest = family.nest(data.scene, effect)
    key = (effect.family, nest[0]) if nest else None
    if key is None or key not in fit.notes:
        probe = nest[1] if nest else effect
        chain, derivatives = added(data.scene, fit.model, fit.notes["before"], probe)
        change = chain.y - fit.chain.y
        if float(np.vdot(change, change).real) > ELSEWHERE * float(np.vdot(fit.chain.y, fit.chain.y).real):
            # The start is elsewhere: gain and phase are set free there, the rest of the model stands still.
            residual = data.whitened((data.y - chain.y)[None])
            rows = data.whitened(np.stack([chain.y, 1j * chain.y]))
            others = Others(columns=[Dense(signals=rows)], together=Dense(signals=np.concatenate([rows, residual])))
            inverse, b_j = invert(2 / sigma2 * gram(others.columns)), 2 / sigma2 * others.slopes()
            saved = (misfit(data, fit.chain.y) - float(np.vdot(residual, residual).real)) / sigma2
        part = None
        if probe.free.any():
            columns = data.white(derivatives())
            h_cj, slope = others.against(columns)
            part = 2 / sigma2 * inner(columns, columns), 2 / sigma2 * h_cj, 2 / sigma2 * slope
        if nest:
            fit.notes[key] = part, inverse, b_j, saved
    if nest:
        (h_cc, h_cj, slope), inverse, b_j, saved = fit.notes[key]
        part = h_cc[np.ix_(nest[2], nest[2])], h_cj[nest[2]], slope[nest[2]]
    gain = saved + 0.5 * b_j @ inverse @ b_j
    p, prior, occam = effect.p.copy(), None, 0.0
    if part is not None:
        h_cc, h_cj, slope = part
        schur = h_cc - h_cj @ inverse @ h_cj.T
        slope = slope - h_cj @ inverse @ b_j
        scale = np.diag(h_cc)
        if family.linear and effect.prior is None:
            schur = schur + RIDGE * np.eye(len(schur))
        live = np.diag(schur) > SEEN * np.maximum(scale, 1e-9 * scale.max() + 1e-300)
        free = np.flatnonzero(effect.free)[live]
        if live.any():
            schur, slope, whole = schur[np.ix_(live, live)], slope[live], h_cc[np.ix_(live, live)]
            if effect.prior is None:
                step = invert(schur, 0.0 if family.linear else SEEN) @ slope
                gain += 0.5 * slope @ step
            else:
                more, occam, step, prior = _with_prior(schur, slope, whole, effect.prior[free], family.entangled)
                gain += more
            if not family.linear:  # a linear one is fitted from its start, together with what it resembles
                move = np.zeros_like(p)
                move[free] = step
                p[free] = family.stepped(p, move)[free]
    if effect.prior is None:
        cost = 0.5 * np.log(n) * (effect.free.sum() + family.hidden(effect))
    else:
        cost = occam + 0.5 * np.log(n) * (1 + family.hidden(effect))
    gain = -n * np.log(max(1 - gain / n, 1e-12))  # the noise level is fitted too
    found = replace(effect, p=p)
    if prior is not None:
        full = effect.prior.copy()
        full[free] = prior
        found = replace(found, prior=full)
    return Score(net=float(gain - cost - np.log(effect.trials)), effect=found)


def roughness(net: float) -> float:
    """Nats by which a score may be off: a flexible family is tried when no simple one comes this near."""
    return ROUGH_NATS + ROUGH_SHARE * net


def _colour(fit: Fit) -> float:
    """Nats that a receiver's filter brings by the colour that it gives the noise, its price paid; a filter that leaves the
    signal as it is only takes away beside it."""
    if fit.data.spectrum is not None or filters_noise(fit.model):
        return 0.0
    residual = noise.of_noise(fit).residual
    power, n = np.abs(sp_fft.fft(residual * (fit.data.use > 0))) ** 2, fit.data.count
    colour = smooth_spectrum(fit.data, residual)
    if colour.max() > LOUDEST * np.median(colour[in_band(fit, len(colour))]):
        return 0.0
    gain = n * np.log(power.mean() / np.mean(power / colour))
    return max(0.0, float(gain - COLOUR_ORDERS * np.log(n)))


def _with_prior(schur, slope, whole, shape, entangled: bool):
    """The scale of the prior that makes the data likeliest: (gain, Occam cost, step, prior). `schur` is what other parameters
    leave of the curvature `whole`."""
    root = np.sqrt(shape)
    if len(shape) <= MANY or entangled or _share_much(schur):
        values, vectors = np.linalg.eigh(schur * np.outer(root, root))
        alone = np.sum(vectors * (whole * np.outer(root, root) @ vectors), axis=0)
        b = vectors.T @ (slope * root) * (values > SEEN * alone)  # what the fit can do itself has a slope of rounding
        values = np.maximum(values, 0)
    else:  # that many cosines of a signal that is always there are all but independent
        values, vectors, b = np.diag(schur) * shape, None, slope * root
    best = (-np.inf,)
    for scale in np.geomspace(1e-9, 10, 41):
        gain = 0.5 * np.sum(b**2 * scale / (1 + scale * values))
        occam = 0.5 * np.sum(np.log1p(scale * values))
        if gain - occam > best[0]:
            best = (gain - occam, gain, occam, scale)
    _, gain, occam, scale = best
    step = b * scale / (1 + scale * values)
    step = root * (step if vectors is None else vectors @ step)
    return gain, occam, step, shape * scale


def _share_much(curvature: np.ndarray) -> bool:
    """Whether numbers say much of each other: of a signal that comes and goes two cosines are much alike."""
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    return float(np.sum((curvature / np.outer(scale, scale)) ** 2)) > (1 + INDEPENDENT) * len(curvature)


def refit(data: Data, model: Model, near: Fit | None = None, rounds: int = 2, iterations: int = 8) -> Fit:
    """Signal and noise law at their joint optimum. `near`: a fit whose signal part is already close, or that lacks one
    effect, with the shape of its noise."""
    white = replace(data, variance=None, spectrum=None, impulses=None)
    begun = white if near is None else replace(near.data, deadline=data.deadline)
    if near is None and data.scene.free_ports:
        model = _with_ports(begun, model)
    if data.late:  # it stays where it stands: no shape of the noise is worth its time
        return solve(begun, model)
    noisy = any(FAMILIES[e.family].noise_like and not e.fixed for e in model.effects)
    shaped = noisy or any(stage_of(e) in (RX_GAIN, RX_FILTER) or is_coarse(e) for e in model.effects)
    if not noisy or near is None:
        fit = solve(begun if shaped else white, model, iterations=iterations)
        fit = _softened(_under_likely_priors(fit, iterations))
    if not shaped:
        return fit
    if near is not None and noisy:
        fit = replace(near, model=model)
    rounds = LAWS_ROUNDS if len(noise.laws(model)) > 1 else rounds  # each of which is fitted to what the others leave
    for _ in range(rounds if noisy else 1):
        model = replace(
            model if noisy else fit.model,
            effects=tuple(_again(fit, e) for e in (model if noisy else fit.model).effects),
        )
        fit = solve(with_noise(replace(fit, data=white), model), model, iterations=iterations)
        model = fit.model
    return fit


def _with_ports(data: Data, model: Model) -> Model:
    """The model with the gains of all ports at their joint least squares where that is nearer: far from there no small step of a
    product of two gains leads back."""
    return min((model, offsets.with_gains(data, model)), key=lambda m: misfit(data, predict(data.scene, m).y))


def _softened(fit: Fit) -> Fit:
    """The fit with the converter's rails as soft as the noise in front of them makes them; under a grid that has the noise
    in it they are hard."""
    at = fit.model.index_of(Role.RAILS)
    if at is None:
        return fit
    level, before = fit.model.effects[at].p
    sigma = min(np.sqrt(np.mean(np.abs(fit.residual[_heard(fit)]) ** 2) / 2), NOISIEST * level)
    if any(is_coarse(e) for e in fit.model.effects):
        sigma = 0.0
    if abs(sigma - before) <= SETTLED * sigma:
        return fit
    effect = fit.model.effects[at].moved(np.array([level, sigma]))
    return solve(fit.data, fit.model.replacing(at, effect), iterations=SOFTENED_STEPS)


def _heard(fit: Fit) -> np.ndarray:
    """(n,) bool: used samples off the rails, all where those are too few."""
    inside = off_the_rails(fit)
    return inside if inside.any() else fit.data.use > 0


def _under_likely_priors(fit: Fit, iterations: int) -> Fit:
    """The fit under the priors that make it likeliest, step by step: what a step too few leaves behind, the next effect would
    seem to bring."""
    for _ in range(PRIOR_STEPS):
        likely = _with_likely_priors(fit)
        if likely is fit.model:
            break
        before, fit = fit, solve(fit.data, likely, iterations=iterations)
        if fit.evidence < before.evidence + LEAST_OF_A_STEP:
            return max(before, fit, key=lambda f: f.evidence)
    return fit


def _with_likely_priors(fit: Fit) -> Model:
    """The model with the priors that the courses under them make likeliest."""
    model = fit.model
    for i, e in enumerate(model.effects):
        if e.prior is not None and not e.fixed and e.free.all():
            span = model.span(i)
            likelier = FAMILIES[e.family].likelier(e, fit.covariance[span, span])
            model = model if likelier is e else model.replacing(i, likelier)
    return model


def refit_or_known(data: Data, model: Model, known: list[Fit], near: Fit | None = None) -> Fit:
    """`refit`, or the fit of the same effects at about the same delay in `known`, to which a new one is added; with the deadline
    of `data`."""
    same = [f for f in known if f.model.signature == model.signature and _late(data.scene, f.model, model) < LEAST_JUMP]
    if not same:
        same = [refit(data, model, near=near)]
        known.extend(same)
    best = max(same, key=lambda f: f.evidence)
    return replace(best, data=replace(best.data, deadline=data.deadline))


def _late(scene, model: Model, other: Model) -> float:
    """Samples by which two models differ in their delay."""
    late = abs(float(model.base[0] - other.base[0]))
    if not all(s.repeat for s in scene.sources):
        return late
    period = math.lcm(*(len(s.samples) for s in scene.sources))
    return min(late % period, -late % period)


def _again(fit: Fit, effect: Effect) -> Effect:
    """A noise effect with its strength fitted to the residual; others as they are."""
    if effect.fixed or effect.family not in noise.TESTED:
        return effect
    found = noise.found_again(fit, effect)
    if found is None:
        return effect
    settled = {"_floor": noise.floor_of(fit, effect)} if "_floor" in effect.aux else {}
    return replace(found, aux={**found.aux, **settled})


def candidates(fit: Fit) -> list[Score]:
    """Every family's score on a fit, best first, at most two starts of a family; worked out once for a fit."""
    if "candidates" not in fit.notes:
        found = _candidates(fit)
        if fit.data.late:  # these are not all
            return found
        fit.notes["candidates"] = found
        for heavy in [k for k in fit.notes if k != "candidates"]:
            del fit.notes[heavy]
    return fit.notes["candidates"]


def _view(fit: Fit) -> View:
    """One for all that look at a fit: what it has worked out is kept until `candidates` are known."""
    if "view" not in fit.notes:
        fit.notes["view"] = View(fit)
    return fit.notes["view"]


def _candidates(fit: Fit) -> list[Score]:
    view, scores = _view(fit), []
    told = [e for e in fit.model.effects if not _of_another_radio(e)]
    have, families = {_what(e) for e in told}, {e.family for e in told}
    for family in FAMILIES.values():
        if family.noise_like or fit.data.late or family.multiplicity is Multiplicity.ONE and family.name in families:
            continue
        for effect in _of_every_side(fit.data.scene, family, family.starts(view)):
            if family.multiplicity is Multiplicity.MANY or _what(effect) not in have:
                scores.append(score(fit, effect))
    if not fit.data.late:
        promised = max((s.net for s in scores), default=0.0)
        noises = [Score(net=net, effect=effect) for net, effect in noise.starts(fit, promised)]
        colour = 0.0 if promised > CLEAR_NATS else _colour(fit)
        if colour > max((s.net for s in noises), default=0.0):
            scores = [replace(s, net=s.net + colour * (stage_of(s.effect) == RX_FILTER)) for s in scores]
        scores += noises
    scores.sort(key=lambda s: -s.net)
    kept: list[Score] = []
    for s in scores:
        same = [k.effect for k in kept if k.effect.family == s.effect.family]
        if len(same) < 2 and not any(_one_course(s.effect, other) for other in same):
            kept.append(s)
    return kept


def _of_every_side(scene, family, starts: Iterable[Effect]) -> Iterable[Effect]:
    """Starts of a family, those of a carrier or a gain over time as each transmitter's too where several are heard at once: the
    receiver's explains next to nothing of it."""
    evenly = family.either_side and family.stage in (RX_GAIN, RX_LO) and not family.wanders
    several = evenly and len(scene.sources) > 1
    return itertools.chain.from_iterable((effect, *_as_sent(scene, effect)) if several else (effect,) for effect in starts)


def _of_another_radio(effect: Effect) -> bool:
    """Whether it is of one radio and leaves the other's open, in one number at least: what a twin knows to the last digit of a
    transmitter's clock says nothing of the receiver's."""
    told = np.asarray(effect.aux.get("_told", np.ones(len(effect.p))))
    closed = not effect.free.any() or bool((~effect.free & (told == 0)).any())
    return effect.fixed and closed and {"tx", "rx"} <= set(FAMILIES[effect.family].owners)


def _one_course(a: Effect, b: Effect) -> bool:
    """Whether two random courses differ in their laws alone: how far they follow matters more, and a score is rough in that."""
    return bool(FAMILIES[a.family].wanders) and len(a.p) == len(b.p) and a.aux.get("tap") == b.aux.get("tap")


def _what(effect: Effect) -> tuple[str, str]:
    """What an effect acts on, whatever its numbers."""
    return effect.family, str(sorted((k, str(v)) for k, v in effect.aux.items()))


def _worth_trying(scores: list[Score]) -> list[Score]:
    """The simple families that promise most, flexible ones where they promise more, and the laws of noise."""
    options = [s for s in scores if s.net > 0]
    best = {s.effect.family: s.net for s in reversed(options)}  # of a family, what scores far less is not its best start
    options = [s for s in options if s.net > best[s.effect.family] - max(CLEAR_NATS, CLEAR_SHARE * best[s.effect.family])]
    simple = [s for s in options if not FAMILIES[s.effect.family].flexible and not FAMILIES[s.effect.family].noise_like]
    best = simple[0].net if simple else 0.0
    simple = [s for s in simple if s.net > best - max(CLEAR_NATS, FAR_SHARE * best)]
    flexible = [s for s in options if FAMILIES[s.effect.family].flexible and s.net > best + roughness(best)]
    noises = [s for s in options if FAMILIES[s.effect.family].noise_like and s.net > best]
    return simple[:REFITS] + flexible[:2] + noises[:2]


def _to_try(fit: Fit) -> Iterator[Iterable[Model]]:
    """Models with more effects: those that promise most, and, for where none keeps its promise, those that stood behind it."""
    together, scores = _all_at_once(fit), candidates(fit)  # in this order: they share a view
    trying = _worth_trying(scores)
    yield itertools.chain(together, (more for s in trying for more in _adding(fit, s.effect)))
    while trying:
        scores = [s for s in scores if s.net > STILL_NATS and not any(s is other for other in trying)]
        trying = _worth_trying(scores)
        yield (more for s in trying for more in _adding(fit, s.effect))


def _likelier(data: Data, fit: Fit, models: Iterable[Model]) -> list[Fit]:
    """The fits of models with more effects that are likelier than the fit that they grew from, by their price, and plausible."""
    found = []
    for more in models:
        if data.late:
            break
        trial = _on_either_side(data, fit, refit(data, more, near=fit))
        if trial.evidence > fit.evidence + _least(fit, more) and plausible(trial.model):
            found.append(trial)
    return found


def search(data: Data, beam: list[Fit], proof_deadline: float = np.inf) -> list[Fit]:
    """Fits by falling evidence, the best first, grown from those of `beam`; every effect of the best has paid its price. What was
    found by the data's deadline has until `proof_deadline` to prove itself; the note `cut` of the best says whether that ended
    too soon."""
    done = {fit.model.families: fit for fit in reversed(beam)}
    rounds = 0  # since the leader changed
    while not data.late and rounds < 2:
        before, grown = max(f.evidence for f in done.values()), {}
        for fit in beam:
            if data.late:
                break
            better = []
            for models in _to_try(fit):
                better = _likelier(data, fit, models)
                for trial in better:
                    key = trial.model.families
                    if key not in done or done[key].evidence < trial.evidence:
                        done[key] = grown[key] = trial
                if better or data.late:
                    break
            if not better and all(fit.evidence >= f.evidence for f in done.values()) and _is_enough(fit):
                grown.clear()
                break
        leader = max(done.values(), key=lambda f: f.evidence)
        rounds = 0 if leader.evidence > before else rounds + 1
        if causes(leader.model) >= MOST_EFFECTS:
            break
        beam = _best(grown.values(), leader, leader.evidence - before)
        if not any(f is leader or not f.model.flexible for f in beam):
            break
        beam = [quantiser_again(data, _on_their_sides(data, counted_again(data, f))) for f in beam]
        done |= {f.model.families: f for f in beam if f.evidence >= done.get(f.model.families, f).evidence}
    ranked = sorted(done.values(), key=lambda f: -f.evidence)
    cut, data = data.late, replace(data, deadline=max(data.deadline, proof_deadline))
    best = _on_their_sides(data, proven(data, eliminate(data, _polished(data, ranked[0]), ranked), ranked), again=True)
    best.notes["cut"] = cut or data.late
    return [best, *ranked]


def _is_enough(fit: Fit) -> bool:
    """Whether one cause leaves no more than the noise that the twin tells: no list of several is likelier."""
    told = fit.data.noise_power
    most = 1 + ENOUGH_DEVIATIONS / np.sqrt(fit.data.count)
    return causes(fit.model) == 1 and told is not None and fit.sigma2 < most * (told + fit.data.rounding)


def _on_either_side(data: Data, fit: Fit, trial: Fit) -> Fit:
    """A trial, or, where it makes nothing likelier than the fit that it grew from, one with its new gain at the transmitter: a
    receiver's gain changes the noise too, which may speak against it louder than the signal speaks for it."""
    new = trial.model.effects[-1]
    if trial.evidence > fit.evidence or new.fixed or stage_of(new) != RX_GAIN:
        return trial
    rest = trial.model.without(len(trial.model.effects) - 1)
    others = (refit(data, rest.adding(form)) for form in _as_sent(data.scene, new))
    return max(trial, *others, key=lambda f: f.evidence)


def _all_at_once(fit: Fit) -> list[Model]:
    """The model of a fit with everything that happens in leaps: taken one by one, each hides in the others, and one alone may be
    hidden by what another family adds (a tone makes other delays likelier)."""
    models, data = [], replace(fit.data, variance=None, spectrum=None, impulses=None)
    for family in FAMILIES.values():
        if not family.leaps or data.late:
            continue
        later, found = family.at_once(_view(fit))
        if not found:
            continue
        models += _of_a_clock(fit, found)
        base = fit.model.base + later * np.eye(len(fit.model.base))[0]
        best = at_their_moments(data, solve(data, functools.reduce(_put, found, replace(fit.model, base=base))))
        for i, effect in enumerate(best.model.effects):
            if effect.family == family.name and not effect.fixed:
                others = (best.model.replacing(i, other) for other in family.another(effect))
                best = max(best, *(solve(data, m, iterations=LEAP_STEPS) for m in others), key=lambda f: f.evidence)
        models.append(at_their_moments(data, best).model)
    return models


def _of_a_clock(fit: Fit, slips: list[Effect]) -> list[Model]:
    """The model of a fit with the clock under which the delay moves evenly, where slips go the same way at every step."""
    joints, lost = np.array([e.p[:2] for e in slips if plays(e, Role.SLIP)]).T.reshape(2, -1)
    if (
        len(joints) < LEAST_STEPS
        or abs(lost.sum()) < np.abs(lost).sum()
        or fit.model.index_of(Role.CLOCK, found=True) is not None
    ):
        return []
    slope, first = np.polyfit(joints / fit.data.scene.span, np.cumsum(lost) - lost / 2, 1)  # a step is amid what it stands for
    base = fit.model.base - first * np.eye(len(fit.model.base))[0]
    return [replace(fit.model, base=base).adding(start(with_role(Role.CLOCK), [slope], trials=fit.data.scene.count))]


def _put(model: Model, effect: Effect) -> Model:
    """The model with an effect, joined with one that is at its place where there is one."""
    for i, other in enumerate(model.effects):
        one = FAMILIES[effect.family].joined(other, effect) if other.family == effect.family and not other.fixed else None
        if one is not None:
            return model.without(i).adding(one)
    return model.adding(effect)


def _least(fit: Fit, more: Model) -> float:
    """Nats that a model must bring over a fit that it grew from: as much more as the colour of the noise is priced at, where that
    is a receiver's filter's no longer, for the signal tells most of that colour anyway."""
    given_up = filters_noise(fit.model) and not filters_noise(more)
    return SEARCH_MARGIN + (COLOUR_ORDERS * np.log(fit.data.count) if given_up else 0.0)


def beginnings(data: Data, model: Model) -> list[Fit]:
    """The fits that a search begins with, the best first: as the twin has it, and with the offset at which the recording
    turns against it."""
    plain, *mirrored = ways = _ways_round(data.scene, model)
    turning = [form for way in ways for other in _gross_offsets(data, way) for form in _of_either_side(data.scene, other)]
    first, *others = (delayed_again(data, refit(data, one)) for one in (plain, *turning))
    fits = [first, *(_on_their_sides(data, other) for other in others)]
    elsewhere = [refit(data, model) for model in _at_another_path(data, first)]
    fits += elsewhere
    fits += [f for f in (refit(data, way) for way in mirrored) if f.evidence > fits[0].evidence + 2 * SEARCH_MARGIN]
    worth = {id(f): f.evidence - SEARCH_MARGIN * f.model.inverted for f in fits}
    fits.sort(key=lambda f: -worth[id(f)])
    kept = [f for f in fits if worth[id(f)] > worth[id(fits[0])] - 10.0][:BEAM]
    if not any(f is first for f in kept) and (any(fits[0] is one for one in elsewhere) or _leaps_further(first, fits[0])):
        kept = [*kept[: BEAM - 1], first]  # what seems to be missing may be something else
    return kept


def _leaps_further(first: Fit, best: Fit) -> bool:
    """Whether what happens in leaps, or a clock, brings the twin as it is further than the offset with which `best` begins: a
    recording whose delay moves turns against the twin too."""
    if best.model.index_of(Role.CARRIER, found=True) is None or first.model.index_of(Role.CLOCK, found=True) is not None:
        return False
    clocks = (first.model.adding(clock) for clock in with_role(Role.CLOCK).starts(_view(first)))
    return any(refit(first.data, model).evidence > best.evidence for model in itertools.chain(_all_at_once(first), clocks))


def _at_another_path(data: Data, fit: Fit) -> list[Model]:
    """The model of a fit as if its delay were that of another path, for the twin's strongest is gone or weak: those that leave
    far less, the best first."""
    found = []
    for late, effect in itertools.chain.from_iterable(f.elsewhere(data.scene) for f in FAMILIES.values()):
        base = fit.model.base - late * np.eye(len(fit.model.base))[0]
        model = offsets.with_gains(data, replace(fit.model, base=base).adding(effect))
        found.append((misfit(data, predict(data.scene, model).y), len(found), model))
    return [m for left, _, m in sorted(found)[:BEAM] if left < ANOTHER_PATH * misfit(data, fit.chain.y)]


def _of_either_side(scene, model: Model) -> list[Model]:
    """The model, and with its carrier offset as the transmitter's: what is late has turned less then, so that on the wrong side
    paths do not add up at any delay."""
    at = model.index_of(Role.CARRIER, found=True)
    if at is None or len(scene.taps) < 2 or len(scene.sources) > 1:
        return [model]
    return [model, *(model.replacing(at, form) for form in _as_sent(scene, model.effects[at]))]


def delayed_again(data: Data, fit: Fit) -> Fit:
    """The fit of a repeated waveform, or one at the delay at which the whole recording, turned back by the carrier offset, holds
    more of it: a delay is looked for in stretches that are shorter than a turn, and a chirp's at another one is an offset."""
    scene, period = data.scene, len(data.scene.sources[0].samples)
    if fit.chain.facing < 0 or not all(s.repeat and s.known.all() and len(s.samples) == period for s in scene.sources):
        return fit
    lo, at = View(fit).carrier, scene.wrap(period)
    heard, told = (np.zeros(period, complex) for _ in range(2))
    np.add.at(heard, at, data.y * data.use * np.conj(lo))
    np.add.at(told, at, fit.chain.y * data.use * np.conj(lo))
    held = np.abs(sp_fft.ifft(sp_fft.fft(heard) * np.conj(sp_fft.fft(told)))) ** 2
    later = int(np.argmax(held))
    if held[later] < FULLER * held[0]:
        return fit
    base = fit.model.base + later * np.eye(len(fit.model.base))[0]
    other = refit(data, replace(fit.model, base=np.concatenate([[base[0] % period], base[1:]])))
    return max(fit, other, key=lambda f: f.evidence)


def _ways_round(scene, model: Model) -> list[Model]:
    """The model, and with the spectrum the other way round where only a fit can tell: mirrored, a real waveform is itself,
    and what a transmitter's offset makes of late paths may look like the mirror image of them."""
    at = model.index_of(Role.ORIENTATION)
    known = at is not None and model.effects[at].fixed
    if known or len(scene.taps) < 2 or not all(s.on_one_line for s in scene.sources):
        return [model]
    return [model, model.adding(start(with_role(Role.ORIENTATION), [])) if at is None else model.without(at)]


def _on_their_sides(data: Data, fit: Fit, again: bool = False) -> Fit:
    """The fit with what either side may have on the sides that make the recording likelier: a gain that changes is a
    transmitter's where the noise does not change with it, and so is what changes later on late paths, or stretches them."""
    fit = _whose_clock(data, _whose_carrier(data, fit, again))
    for k, effect in enumerate(fit.model.effects):
        stage, family = stage_of(effect), FAMILIES[effect.family]
        of_either = stage == RX_GAIN or stage == RX_LO and family.linear and _is_late(fit, effect)
        if effect.fixed or data.late or not of_either:
            continue
        forms = _as_sent(data.scene, effect)
        forms += family.finer(data.scene, forms[0])
        best = max((refit(data, fit.model.without(k).adding(form)) for form in forms), key=lambda f: f.evidence)
        if best.evidence > fit.evidence + 1.0:
            return _on_their_sides(data, best)
    return fit


def at_their_moments(data: Data, fit: Fit) -> Fit:
    """The fit with what happens at a moment where all else that is known makes the recording likeliest."""
    scene = data.scene
    for i, effect in enumerate(fit.model.effects):
        family = FAMILIES[effect.family]
        now = None if effect.fixed or data.late else family.moment(scene, effect)
        if now is None:
            continue
        ends = (fit.model.replacing(i, family.happening(scene, effect, end)) for end in (np.inf, -np.inf))
        before, after = (np.abs(fit.data.whitened(data.y - predict(scene, model).y)) ** 2 for model in ends)
        cost = np.concatenate([[0.0], np.cumsum(before - after)])
        at = int(np.argmin(cost))
        if cost[at] < cost[int(np.searchsorted(scene.index, now))] - SEARCH_MARGIN * fit.sigma2:
            first = np.append(scene.index, scene.index[-1] + 1)[at]
            model = fit.model.replacing(i, family.happening(scene, effect, float(first)))
            fit = max(fit, refit(data, model, near=fit), key=lambda f: f.evidence)
    return fit


def counted_again(data: Data, fit: Fit) -> Fit:
    """The fit with what happens at its moments, and one more or less of what was counted there where that makes the recording
    likelier: while a carrier or a clock is off, a search miscounts."""
    fit = at_their_moments(data, fit)
    for i, effect in enumerate(fit.model.effects):
        for other in () if effect.fixed else FAMILIES[effect.family].another(effect):
            if data.late:
                return fit
            trial = at_their_moments(data, refit(data, fit.model.replacing(i, other), near=fit))
            if trial.evidence > fit.evidence + SEARCH_MARGIN:
                return counted_again(data, trial)
    return fit


def _as_sent(scene, effect: Effect) -> list[Effect]:
    """The effect as that of each transmitter."""
    return [replace(effect, aux={**effect.aux, "side": "tx", "source": i}) for i in range(len(scene.sources))]


def through_the_quantiser(data: Data, model: Model) -> Model:
    """The model with the noise in front of a coarse quantiser, in steps, under which its mean output fits best, the most of those
    that fit alike: much noise hides the grid. Itself where that is so."""
    at = model.index_of(Role.QUANTISER)
    if at is None:
        return model
    tries = []
    for sigma in (0.05, 0.07, 0.09, 0.11, 0.13, 0.16, 0.2, 0.25, 0.3, 0.36, 0.45, 0.6, 1.0):
        effect = model.effects[at].moved(np.array([*model.effects[at].p[:2], sigma]))
        other = model.replacing(at, effect)
        tries.append((misfit(data, predict(data.scene, other).y), sigma, other))
    best = min(cost for cost, *_ in tries)
    sigma, other = max(((s, m) for cost, s, m in tries if data.count * (cost - best) <= ALIKE_NATS * best), key=lambda t: t[0])
    return model if sigma == model.effects[at].p[2] else other


def quantiser_again(data: Data, fit: Fit) -> Fit:
    """The fit with the noise in front of a coarse quantiser that suits what else was found: much noise hides the grid's own
    error, and other effects would be found in its place."""
    model = through_the_quantiser(data, fit.model)
    if model is fit.model or data.late:
        return fit
    return max(fit, refit(data, model), key=lambda f: f.evidence)


def _filter_as_sent(fit: Fit) -> list[Model]:
    """The model of a fit with what a receiver filters as that of each transmitter; none without such a filter."""
    of_receiver = [i for i, e in enumerate(fit.model.effects) if stage_of(e) == RX_FILTER and not e.fixed]
    return [fit.model.without(i).adding(form) for i in of_receiver for form in _as_sent(fit.data.scene, fit.model.effects[i])]


def _is_late(fit: Fit, effect: Effect) -> bool:
    """Whether a course of the phase would differ between the paths of the one transmitter."""
    course = lambda late: fit.data.scene.course(effect.p, late)  # noqa: E731
    return len(fit.data.scene.sources) == 1 and fit.chain.late_by_its_path(0, [course])


def _whose_carrier(data: Data, fit: Fit, again: bool) -> Fit:
    """The fit with a carrier offset on the side that the phases of late paths tell, or the edges of the band; unsaid where
    they do not. `again`: also where a side was said before all else was known."""
    scene, model = data.scene, fit.model
    at = model.index_of(Role.CARRIER, found=True)
    if at is None or not again and "side" in model.effects[at].aux or data.late:
        return fit
    if scene.free_ports:  # ports of one transmitter have one oscillator
        return fit
    offset, delays = model.effects[at], [p.delay for p in fit.chain.paths]
    carrier, apart = abs(offset.p[0]) / scene.span, max(delays) - min(delays)
    if carrier * max(1.0, apart) < LEAST_TURN:
        return fit
    sent = offset.aux.get("side") == "tx"
    others = [_at_receiver(offset)] if sent else _as_sent(scene, offset)
    best = max((refit(data, model.without(at).adding(form)) for form in others), key=lambda f: f.evidence)
    if best.evidence > fit.evidence + SEARCH_MARGIN:
        return best
    if not sent and fit.evidence > best.evidence + SEARCH_MARGIN and carrier * apart > LEAST_TURN:
        return replace(fit, model=model.replacing(at, _at_receiver(offset)))
    return fit


def _whose_clock(data: Data, fit: Fit) -> Fit:
    """The fit with a sample clock on the side that the delays of late paths of the one transmitter tell, whose own stretches them
    too, or a carrier that the twin knows, which the receiver's counts by its own time; unsaid where they do not."""
    model = fit.model
    at = model.index_of(Role.CLOCK, found=True)
    if at is None or data.late:
        return fit
    clock = model.effects[at]
    forms = [form for form in _of_clocks(data.scene, model, clock, fit.chain.paths) if not _same_side(form, clock)]
    fits = [refit(data, model.replacing(at, form), near=fit) for form in forms]
    best = max(fits, key=lambda f: f.evidence, default=fit)
    if best.evidence > fit.evidence + SEARCH_MARGIN:
        return best
    if "side" not in clock.aux and len(fits) == 2:  # the other one is told by what it is not
        worse, better = sorted(fits, key=lambda f: f.evidence)
        if better.evidence > worse.evidence + SEARCH_MARGIN and better.evidence > fit.evidence - 1.0:
            return better
    return fit


def told_on_its_side(data: Data, model: Model) -> Model:
    """The model with a sample clock that the twin knows, but not what it stretches or counts, on the side that late paths tell,
    or the carrier."""
    at = model.index_of(Role.CLOCK)
    if at is None or "side" in model.effects[at].aux:
        return model
    models = [model.replacing(at, form) for form in _of_clocks(data.scene, model, model.effects[at], data.scene.taps)]
    fits = [refit(data, one) for one in models]
    best = max(fits, key=lambda f: f.likelihood, default=None)
    return best.model if best and best.likelihood > refit(data, model).likelihood + SEARCH_MARGIN else model


def _either(one: Effect, other: Effect) -> bool:
    return FAMILIES[one.family].excludes(one, other) or FAMILIES[other.family].excludes(other, one)


def _of_clocks(scene, model: Model, clock: Effect, paths) -> list[Effect]:
    """A sample clock as the one transmitter's and as the receiver's, where either shows."""
    stretches = _stretches(scene, clock, paths)
    known = sum(abs(e.p[0]) for e in model.effects if e.fixed and plays(e, Role.CARRIER))
    counts = abs(clock.p[0]) / scene.span * known >= LEAST_COUNTED
    return [
        *(_as_sent(scene, clock) if stretches else []),
        *([_at_receiver(clock)] if stretches or counts else []),
    ]


def _at_receiver(effect: Effect) -> Effect:
    return replace(effect, aux={**{key: value for key, value in effect.aux.items() if key != "source"}, "side": "rx"})


def _same_side(one: Effect, other: Effect) -> bool:
    return one.aux.get("side") == other.aux.get("side")


def _stretches(scene, clock: Effect, paths) -> bool:
    """Whether it shows between the paths of the one transmitter whose a sample clock is."""
    delays = [p.delay for p in paths]
    return len(scene.sources) == 1 and abs(clock.p[0]) / scene.span * (max(delays) - min(delays)) >= LEAST_STRETCH


def _adding(fit: Fit, effect: Effect) -> list[Model]:
    """The model of a fit with one more effect, with one of each owner's own in its place, and joined with one that is at its
    place; a band of noise is not also the colour of a receiver's filter, which may be a transmitter's then."""
    if FAMILIES[effect.family].noise_like:  # a cause takes the place of a law of the noise that is none
        fit = replace(fit, model=replace(fit.model, effects=tuple(e for e in fit.model.effects if not is_apart(e))))
    fit = replace(fit, model=replace(fit.model, effects=tuple(e for e in fit.model.effects if e.fixed or not _either(e, effect))))
    models = [fit.model.adding(effect)]
    if len((joined := _put(fit.model, effect)).effects) == len(fit.model.effects):
        models.append(joined)
    if FAMILIES[effect.family].band(effect):
        models += [m.adding(effect) for m in _filter_as_sent(fit)]
    own = FAMILIES[effect.family].apart(fit.data.scene, effect)
    if own and not any(claim_the_same(e, other) for e in own for other in fit.model.found):
        models.append(functools.reduce(Model.adding, own, fit.model))
    return models


def is_apart(effect: Effect) -> bool:
    """Whether an effect is a law of the noise that is no cause."""
    return FAMILIES[effect.family].noise_like and FAMILIES[effect.family].beyond


def _polished(data: Data, fit: Fit) -> Fit:
    """The fit with the amplifier and the filter, or with the filters of several transmitters, in the forms that suit each
    other: the memory of one imitates the other, and only together their order and their lengths matter. So does an amplifier's
    memory imitate, in a wrong form, whatever else is linear."""
    filters = [e for e in fit.model.found if plays(e, Role.FILTER)]
    amplifiers = [e for e in fit.model.found if plays(e, Role.AMPLIFIER)]
    if not amplifiers and len(filters) < 2:
        return fit
    for one in (*amplifiers, *filters, *(amplifiers if filters else ())):
        i = next(i for i, e in enumerate(fit.model.effects) if _same_part(e, one))
        rest = fit.model.without(i)
        for form in FAMILIES[one.family].forms(data.scene, fit.model.effects[i]):
            if not data.late:
                fit = max(fit, refit(data, rest.adding(form)), key=lambda f: f.evidence)
    return fit


def _same_part(a: Effect, b: Effect) -> bool:
    """Whether two effects are forms of one, of the same transmitter where there are several."""
    return a.family == b.family and not a.fixed and a.aux.get("source", 0) == b.aux.get("source", 0)


def _best(grown, leader: Fit, gained: float) -> list[Fit]:
    """The models to go on from: the best few, and the best that has no flexible family, which may take the place of
    several. `gained`: what the last effect of the leader brought."""
    ranked = sorted(grown, key=lambda f: -f.evidence)
    near = [f for f in ranked if f.evidence > leader.evidence - max(30.0, 0.3 * gained)]
    beam = near[: BEAM if len(leader.model.found) < 3 else 1]
    simple = [f for f in ranked if not f.model.flexible]
    if simple and not any(simple[0] is f for f in beam) and simple[0].evidence > leader.evidence - 0.7 * gained:
        beam.append(simple[0])
    return beam


def causes(model: Model) -> int:
    """How many effects were searched out: what was read off the samples is none, nor an inversion, under which the twin was
    found; carrier and sample clock are one."""
    searched = [e for e in model.found if "read" not in e.aux and not plays(e, Role.ORIENTATION)]
    oscillator = [any(plays(e, role) for e in searched) for role in (Role.CARRIER, Role.CLOCK)]
    return len(searched) - all(oscillator)


def claim_the_same(a: Effect, b: Effect) -> bool:
    """Whether two effects are of one family and one place."""
    return a.family == b.family and a.aux.get("tap") == b.aux.get("tap")


def plausible(model: Model) -> bool:
    """Whether every effect can be that of real equipment, and no more than MOST_AT_ONE_PLACE of those that there may be many of
    are in one place: so many are the course of one."""
    return all(FAMILIES[e.family].plausible(e) for e in model.effects) and _most_at_one_place(model) <= MOST_AT_ONE_PLACE


def _most_at_one_place(model: Model) -> int:
    """How many effects of one family, of which there may be many, are in one place."""
    many = [
        e for e in model.found if FAMILIES[e.family].multiplicity is Multiplicity.MANY and FAMILIES[e.family].place is not None
    ]
    near = lambda a, b: claim_the_same(a, b) and abs(_placed(a) - _placed(b)) < SAME_PLACE  # noqa: E731
    return max((sum(near(a, b) for b in many) for a in many), default=0)


def _placed(effect: Effect) -> float:
    family = FAMILIES[effect.family]
    return float(effect.p[family.place]) / family.place_step


def _gross_offsets(data: Data, model: Model) -> list[Model]:
    """Where the recording turns fast against the twin, or against what one of several transmitters sent: with that carrier
    offset, alone and with the sample clock of the same oscillator."""
    if model.index_of(Role.CARRIER, found=True) is not None:
        return []
    scene = data.scene
    if scene.at is not None:
        return offsets.models(data, model)
    found, told = [], predict(scene, model).wanted
    still = start(with_role(Role.CARRIER), [0.0, 0.0])
    if with_role(Role.CARRIER).settled(scene, still)[1] and (bent := offsets.drifting(data, model, told)) is not None:
        found.append(model.adding(start(with_role(Role.CARRIER), bent, trials=scene.span)))
    if (cycles := _turns(*offsets.turning(data, model, told))) is not None:
        found.append(model.adding(_gross(scene, cycles)))
        gained = cycles / scene.duration_s / scene.carrier_hz * scene.span if scene.carrier_hz else 0.0
        if abs(gained) > 0.05:
            found.append(found[-1].adding(start(with_role(Role.CLOCK), [gained])))
    for source, told in enumerate(offsets.sent_alone(scene, model.base, model.effects)) if len(scene.sources) > 1 else ():
        if (cycles := _turns(*offsets.turning(data, model, told))) is not None:
            found.append(model.adding(replace(_gross(scene, cycles), aux={"side": "tx", "source": source})))
    return found


def _turns(turns, spectrum) -> float | None:
    """Cycles over the recording of the line that stands far above what does not turn; None without one."""
    k = int(np.argmax(spectrum))
    return float(turns[k]) if abs(turns[k]) >= 1.0 and spectrum[k] >= 2 * spectrum[0] else None


def _gross(scene, cycles: float) -> Effect:
    """A carrier offset, with a drift where the recording is long enough for one."""
    offset = start(with_role(Role.CARRIER), [cycles, 0.0], trials=scene.span)
    return replace(offset, free=FAMILIES[offset.family].settled(scene, offset))


def eliminate(data: Data, fit: Fit, known: list[Fit]) -> Fit:
    """Take out, one by one, every effect that no longer pays its price."""
    while fit.model.found:
        worst = None
        for i, effect in enumerate(fit.model.effects):
            if effect.fixed or "read" in effect.aux or data.late:
                continue
            less = _lesser(data, fit, i, known)
            if less.evidence > fit.evidence - SEARCH_MARGIN and (worst is None or less.evidence > worst.evidence):
                worst = less
        if worst is None:
            return fit
        fit = worst
    return fit


def _lesser(data: Data, fit: Fit, index: int, known: list[Fit]) -> Fit:
    """The best fit without what effect `index` claims: without the effect, or with the part of it that claims less; samples lost
    before anything is heard, or behind it, are a delay."""
    effect, rest = fit.model.effects[index], fit.model.without(index)
    models = [rest, *(rest.adding(e) for e in FAMILIES[effect.family].less(data.scene, effect, rest.effects))]
    if plays(effect, Role.SLIP):
        other_end = effect.p[1] * (1 if effect.aux.get("later") else -1) * np.eye(len(rest.base))[0]
        models.append(replace(rest, base=rest.base + other_end))
    return max((refit_or_known(data, m, known) for m in models), key=lambda f: f.evidence)


def proven(data: Data, fit: Fit, known: list[Fit]) -> Fit:
    """Take out, one by one, every effect that makes samples likelier which were fitted and less likely others: it
    imitates something."""
    parts = heldout.folds(data)
    while not data.late:
        doubted = _doubted(data, fit, known)
        unseen = _unseen(parts, fit.model) if any(doubted.values()) else 0.0
        worth = {i: unseen - _unseen(parts, less.model) if less else -np.inf for i, less in doubted.items()}
        if not worth or min(worth.values()) > LEAST_HELD_OUT or data.late:
            break
        fit = _lesser(data, fit, min(worth, key=worth.get), known)
    return fit


def _doubted(data: Data, fit: Fit, known: list[Fit]) -> dict[int, Fit | None]:
    """The effects of a fit that must prove themselves, each with its `_lesser` fit; None where no proof can help."""
    doubted = {}
    for i, effect in enumerate(fit.model.effects):
        if effect.fixed or "read" in effect.aux:
            continue
        less = _lesser(data, fit, i, known)
        gain = fit.evidence - less.evidence
        if FAMILIES[effect.family].noise_like and gain < LEAST_OF_NOISE:
            doubted[i] = None
        elif gain < SEARCH_SURE_NATS or imitates(effect):
            doubted[i] = less
    return doubted


def _unseen(parts: list[Data], model: Model) -> float:
    """ln L of the samples that each part holds out, of `model` some steps from where it stands."""
    return sum(heldout.log_likelihood(refit(part, model, iterations=PROOF_STEPS)) for part in parts)


def imitates(effect: Effect) -> bool:
    """Whether an effect has the freedom to look like others, however much it explains."""
    family = FAMILIES[effect.family]
    return family.flexible or family.linear or family.noise_like or effect.prior is not None
