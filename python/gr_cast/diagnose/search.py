# SPDX-License-Identifier: GPL-3.0-or-later
"""Which effects: score tests of every family on the residual, joint refits of the best, a small beam,
backward elimination."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft as sp_fft

from ..effects import FAMILIES, Effect, stage_of
from ..effects.base import RX_FILTER, RX_GAIN, start
from ..effects.columns import Dense, against, gram, inner, single
from . import noise
from .fit import COLOUR_ORDERS, Data, Fit, invert, misfit, smooth_spectrum, solve, with_noise
from .model import Model, _run, _start_chain, _steps, effect_columns, predict
from .view import View

MARGIN = 5.0  # nats of evidence that an effect must bring beyond its price
BEAM = 2
REFITS = 3
MOST_EFFECTS = 4
SEEN = 1e-5  # share of a derivative that must be left when what other parameters can do is taken out
CLEAR_NATS = 300.0  # a signal that promises more is fitted before the law of the noise is asked for
FEW_NATS = 10.0  # a flexible family is tried when no simple one comes this near


@dataclass(frozen=True, kw_only=True)
class Score:
    net: float
    effect: Effect


def score(fit: Fit, effect: Effect) -> Score:
    """Predicted gain in evidence of adding an effect, by one Gauss-Newton step from its start (Rao's score
    test)."""
    data, family = fit.data, FAMILIES[effect.family]
    n, sigma2 = data.count, fit.sigma2
    if "columns" not in fit.notes:
        fit.notes["columns"] = [single(b) for b in fit.columns]
        fit.notes["residual"] = single(Dense(signals=data.whitened(fit.residual[None])))
    blocks, residual, inverse, saved = fit.notes["columns"], fit.notes["residual"], fit.covariance, 0.0
    nest = family.nest(data.scene, effect)
    key = (effect.family, nest[0]) if nest else None
    if key is None or key not in fit.notes:
        probe = nest[1] if nest else effect
        chain, columns = _derivatives(fit, probe)
        change = chain.y - fit.chain.y
        if float(np.vdot(change, change).real) > 1e-12 * float(np.vdot(fit.chain.y, fit.chain.y).real):
            # The start is elsewhere: gain and phase are set free there, the rest of the model stands still.
            residual = Dense(signals=data.whitened((data.y - chain.y)[None]))
            blocks = [Dense(signals=data.whitened(np.stack([chain.y, 1j * chain.y])))]
            inverse = invert(2 / sigma2 * gram(blocks))
            saved = misfit(data, fit.chain.y) / sigma2 - float(inner(residual, residual)[0, 0]) / sigma2
        part = None
        if columns is not None:
            columns = single(data.white(columns))
            cross = against(blocks, columns).T
            part = 2 / sigma2 * inner(columns, columns), 2 / sigma2 * cross, 2 / sigma2 * inner(columns, residual)[:, 0]
        if nest:
            fit.notes[key] = part
    if nest:
        h_cc, h_cj, slope = fit.notes[key]
        part = h_cc[np.ix_(nest[2], nest[2])], h_cj[nest[2]], slope[nest[2]]
    b_j = 2 / sigma2 * against(blocks, residual)[:, 0]
    gain = saved + 0.5 * b_j @ inverse @ b_j
    p, prior, occam = effect.p.copy(), None, 0.0
    if part is not None:
        h_cc, h_cj, slope = part
        schur = h_cc - h_cj @ inverse @ h_cj.T
        slope = slope - h_cj @ inverse @ b_j
        scale = np.diag(h_cc)
        live = np.diag(schur) > SEEN * np.maximum(scale, 1e-9 * scale.max() + 1e-300)
        free = np.flatnonzero(effect.free)[live]
        if live.any():
            schur, slope = schur[np.ix_(live, live)], slope[live]
            if effect.prior is None:
                step = invert(schur, SEEN) @ slope
                gain += 0.5 * slope @ step
            else:
                more, occam, step, prior = _with_prior(schur, slope, effect.prior[free])
                gain += more
            if not family.linear:  # a linear one is fitted from its start, together with what it resembles
                p[free] += step
    if effect.prior is None:
        cost = 0.5 * np.log(n) * (effect.free.sum() + family.hidden(effect))
    else:
        cost = occam + 0.5 * np.log(n)
    gain = -n * np.log(max(1 - gain / n, 1e-12))  # the noise level is fitted too
    found = replace(effect, p=p)
    if stage_of(effect) == RX_FILTER:
        net = gain - cost - np.log(effect.trials)
        if "colour" not in fit.notes:
            fit.notes["colour"] = _colour_gain(fit)
        colour = fit.notes["colour"]
        gain += colour if net > 0 else min(colour, 0.0)
    if prior is not None:
        full = effect.prior.copy()
        full[free] = prior
        found = replace(found, prior=full)
    return Score(net=float(gain - cost - np.log(effect.trials)), effect=found)


def _derivatives(fit: Fit, probe: Effect):
    """(chain, derivatives or None) of the model with one more effect, at its start."""
    scene, model = fit.data.scene, fit.model.adding(probe)
    index = next(i for i, e in enumerate(model.effects) if e is probe)
    snapshots = []
    chain = _run(scene, model.base, model.effects, _start_chain(scene, model.base), 0, snapshots)
    before = snapshots[_steps(model.effects).index(index)]
    return chain, effect_columns(scene, model, index, chain, before) if probe.free.any() else None


def _colour_gain(fit: Fit) -> float:
    """Nats that a smooth colour of the noise gains, after its price: what a receiver's filter does to
    noise."""
    shape = smooth_spectrum(fit.data, fit.residual)
    power = np.abs(sp_fft.fft(fit.residual * fit.data.use)) ** 2
    n = fit.data.count
    gain = n * (np.log(power.mean()) - np.log((power / shape).mean()) - np.log(shape).mean())
    return float(gain - COLOUR_ORDERS * np.log(n))


def _with_prior(schur, slope, shape):
    """The scale of the prior that makes the data likeliest: (gain, Occam cost, step, prior)."""
    root = np.sqrt(shape)
    values, vectors = np.linalg.eigh(schur * np.outer(root, root))
    values = np.maximum(values, 0)
    b = vectors.T @ (slope * root)
    best = (-np.inf,)
    for scale in np.geomspace(1e-9, 10, 41):
        gain = 0.5 * np.sum(b**2 * scale / (1 + scale * values))
        occam = 0.5 * np.sum(np.log1p(scale * values))
        if gain - occam > best[0]:
            best = (gain - occam, gain, occam, scale)
    _, gain, occam, scale = best
    step = root * (vectors @ (b * scale / (1 + scale * values)))
    return gain, occam, step, shape * scale


def refit(data: Data, model: Model, near: Fit | None = None, rounds: int = 2) -> Fit:
    """Signal and noise law at their joint optimum. `near`: a fit whose signal part is already close."""
    white = replace(data, variance=None, spectrum=None)
    noisy = any(FAMILIES[e.family].noise_like and not e.fixed for e in model.effects)
    shaped = noisy or any(
        stage_of(e) in (RX_GAIN, RX_FILTER) or e.family == "quantization" and e.p[2] < 0.7 for e in model.effects
    )
    if not noisy or near is None:
        fit = solve(white, model)
    if not shaped:
        return fit
    if near is not None and noisy:
        fit = replace(near, model=model)
    for _ in range(rounds if noisy else 1):
        model = replace(
            model if noisy else fit.model,
            effects=tuple(_again(fit, e) for e in (model if noisy else fit.model).effects),
        )
        fit = solve(with_noise(replace(fit, data=white), model), model)
        model = fit.model
    return fit


def refit_or_known(data: Data, model: Model, known, near: Fit | None = None) -> Fit:
    """`refit`, or a fit of the same effects in `known`, where that is made already."""
    same = [f for f in known if f.model.signature == model.signature]
    return max(same, key=lambda f: f.evidence) if same else refit(data, model, near=near)


def _again(fit: Fit, effect: Effect) -> Effect:
    """A noise effect with its strength fitted to the residual; others as they are."""
    if effect.fixed or effect.family not in noise.TESTED:
        return effect
    _, found = FAMILIES[effect.family].find(noise.view_of(fit), near=effect)
    return effect if found is None else replace(found, trials=effect.trials)


def candidates(fit: Fit) -> list[Score]:
    """Every family's score on a fit, best first, at most two starts of a family; worked out once for a fit."""
    if "candidates" not in fit.notes:
        fit.notes["candidates"] = _candidates(fit)
        for heavy in [k for k in fit.notes if k != "candidates"]:
            del fit.notes[heavy]
    return fit.notes["candidates"]


def _candidates(fit: Fit) -> list[Score]:
    view = View(fit)
    scores = []
    have = {(e.family, str(sorted((k, str(v)) for k, v in e.aux.items()))) for e in fit.model.effects}
    for family in FAMILIES.values():
        if family.noise_like:
            continue
        for effect in family.starts(view):
            if (
                effect.family,
                str(sorted((k, str(v)) for k, v in effect.aux.items())),
            ) in have and effect.family not in REPEATABLE:
                continue
            if effect.family in ONCE and any(e.family == effect.family for e in fit.model.effects):
                continue
            scores.append(score(fit, effect))
    if max((s.net for s in scores), default=0.0) < CLEAR_NATS:  # else what is left is not the noise's yet
        scores += [Score(net=net, effect=effect) for net, effect in noise.starts(fit)]
    scores.sort(key=lambda s: -s.net)
    kept, per_family = [], {}
    for s in scores:
        if per_family.get(s.effect.family, 0) < 2:
            per_family[s.effect.family] = per_family.get(s.effect.family, 0) + 1
            kept.append(s)
    return kept


REPEATABLE = {"extra_path", "tone_interference", "sample_loss", "second_transmitter", "gain_step"}
ONCE = {
    "carrier_frequency_offset",
    "front_end_filter",
    "pa_nonlinearity",
    "phase_noise",
    "diffuse_tail",
    "gain_drift",
    "sample_clock_offset",
    "dc_offset",
}


def _worth_trying(scores: list[Score]) -> list[Score]:
    """The simple families that promise most, flexible ones where they promise more, and the laws of noise."""
    options = [s for s in scores if s.net > 0]
    simple = [s for s in options if not FAMILIES[s.effect.family].flexible and not FAMILIES[s.effect.family].noise_like]
    best = simple[0].net if simple else 0.0
    flexible = [s for s in options if FAMILIES[s.effect.family].flexible and s.net > best + FEW_NATS]
    noises = [s for s in options if FAMILIES[s.effect.family].noise_like and s.net > best]
    return simple[:REFITS] + flexible[:2] + noises[:2]


def search(data: Data, model: Model) -> list[Fit]:
    """Fits by falling evidence, the best first; every effect of the best has paid its price."""
    first = refit(data, model)
    beam = [first, *(refit(data, other) for other in _gross_offsets(data, model))]
    done = {}
    for fit in sorted(beam, key=lambda f: f.evidence):
        done[fit.model.families] = fit
    beam = [f for f in beam if f.evidence > max(g.evidence for g in beam) - 10.0][:BEAM]
    for _ in range(MOST_EFFECTS + 1):
        grown = []
        for fit in beam:
            if data.late:
                break
            for s in _worth_trying(candidates(fit)):
                if data.late:
                    break
                trial = refit(
                    data,
                    fit.model.adding(s.effect),
                    near=fit if FAMILIES[s.effect.family].noise_like else None,
                )
                if trial.evidence > fit.evidence + MARGIN and plausible(trial.model):
                    grown.append(trial)
        for trial in grown:
            key = trial.model.families
            if key not in done or done[key].evidence < trial.evidence:
                done[key] = trial
        unique = {}
        for trial in sorted(grown, key=lambda f: -f.evidence):
            unique.setdefault(trial.model.families, trial)
        leader = max(f.evidence for f in done.values())
        gained = leader - first.evidence
        beam = [f for f in list(unique.values())[:BEAM] if f.evidence > leader - max(30.0, 0.2 * gained)]
        if not beam or all(f.evidence < leader - 1e-9 for f in beam):
            break
    ranked = sorted(done.values(), key=lambda f: -f.evidence)
    return [eliminate(data, _polished(data, ranked[0]), ranked), *ranked]


def _polished(data: Data, fit: Fit) -> Fit:
    """The fit with the amplifier and the filter in the forms that suit each other: the memory of one imitates the
    other, and only together the order of the two matters."""
    if not {"pa_nonlinearity", "front_end_filter"} <= {e.family for e in fit.model.found}:
        return fit
    for family in ("pa_nonlinearity", "front_end_filter"):
        i = next(i for i, e in enumerate(fit.model.effects) if e.family == family and not e.fixed)
        rest = fit.model.without(i)
        for form in FAMILIES[family].forms(data.scene, fit.model.effects[i]):
            if not data.late:
                fit = max(fit, refit(data, rest.adding(form)), key=lambda f: f.evidence)
    return fit


def plausible(model: Model) -> bool:
    return all(FAMILIES[e.family].plausible(e) for e in model.effects)


def _gross_offsets(data: Data, model: Model) -> list[Model]:
    """Where the recording turns fast against the twin: with that carrier offset, alone and with the sample
    clock of the
    same oscillator."""
    if any(e.family == "carrier_frequency_offset" and not e.fixed for e in model.effects):
        return []
    scene = data.scene
    chain = predict(scene, model)
    y, wanted = data.y, chain.wanted
    if any(e.family == "spectral_inversion" for e in model.effects):
        y, wanted = np.conj(y), np.conj(wanted)
    product = y * np.conj(wanted) * data.use
    size = sp_fft.next_fast_len(4 * len(product))
    spectrum = np.abs(sp_fft.fft(product, size))
    k = int(np.argmax(spectrum))
    cycles = (k if k < size // 2 else k - size) * len(product) / size
    if abs(cycles) < 1.0 or spectrum[k] < 2 * spectrum[0]:
        return []
    offset = start(FAMILIES["carrier_frequency_offset"], [cycles, 0.0], trials=len(product))
    offset = replace(offset, free=FAMILIES[offset.family].settled(scene, offset))
    found = [model.adding(offset)]
    if scene.carrier_hz:
        gained = cycles / scene.duration_s / scene.carrier_hz * scene.count
        if abs(gained) > 0.05:
            found.append(found[0].adding(start(FAMILIES["sample_clock_offset"], [gained])))
    return found


def eliminate(data: Data, fit: Fit, known=()) -> Fit:
    """Take out, one by one, every effect that no longer pays its price."""
    while fit.model.found:
        worst = None
        for i, effect in enumerate(fit.model.effects):
            if effect.fixed or "read" in effect.aux or data.late:
                continue
            less = refit_or_known(data, fit.model.without(i), known)
            if less.evidence > fit.evidence - MARGIN and (worst is None or less.evidence > worst.evidence):
                worst = less
        if worst is None:
            return fit
        fit = worst
    return fit
