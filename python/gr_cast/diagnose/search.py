# SPDX-License-Identifier: GPL-3.0-or-later
"""Which effects: score tests of every family on the residual, joint refits of the best, a small beam,
backward elimination."""

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft as sp_fft

from ..effects import FAMILIES, Effect, stage_of
from ..effects.base import RX_FILTER, RX_GAIN, start
from ..effects.basis import cosines
from . import noise
from .fit import COLOUR_ORDERS, Data, Fit, invert, misfit, real_rows, smooth_spectrum, solve, with_noise
from .model import Model, _run, _start_chain, _steps, derivative_units, effect_columns, predict
from .view import View

MARGIN = 5.0  # nats of evidence that an effect must bring beyond its price
BEAM = 2
REFITS = 3
MOST_EFFECTS = 4
SEEN = 1e-5  # share of a derivative that must be left when what other parameters can do is taken out
FEW_NATS = 10.0  # a flexible family is tried when no simple one comes this near


@dataclass(frozen=True, kw_only=True)
class Score:
    net: float
    effect: Effect


@dataclass(frozen=True, kw_only=True)
class Gram:
    """Inner products of an effect's derivatives: among themselves, with those of the fit, with the residual
    (in nats)."""

    h_cc: np.ndarray
    h_cj: np.ndarray
    slope: np.ndarray

    def part(self, index) -> "Gram":
        return Gram(h_cc=self.h_cc[np.ix_(index, index)], h_cj=self.h_cj[index], slope=self.slope[index])


def _gram(data: Data, rows, residual, sigma2, columns) -> Gram:
    c = real_rows(data.whitened(np.array(columns))).astype(np.float32)
    return Gram(
        h_cc=(2 / sigma2 * (c @ c.T)).astype(float),
        h_cj=2 / sigma2 * (c @ rows.T.astype(np.float32)).astype(float),
        slope=2 / sigma2 * (c @ residual.astype(np.float32)).astype(float),
    )


def _gram_of_courses(data: Data, rows, residual, sigma2, units, orders) -> Gram:
    """The same for units × cosines, from sums over blocks in which the cosines hardly move."""
    n = data.scene.count
    edges = np.unique(np.linspace(0, n, min(n // 8, 16 * orders) + 1).astype(int))[:-1]
    middle = (edges + np.append(edges[1:], n)) / 2 / n
    basis = cosines(middle, orders)  # (orders, blocks)
    white = data.whitened(units)
    k = len(units)

    def blocks(a, b):
        return np.add.reduceat((np.conj(a) * b).real, edges)

    h_cc = np.zeros((orders, k, orders, k))
    for i in range(k):
        for j in range(i, k):
            e = blocks(white[i], white[j])
            h_cc[:, i, :, j] = (basis * e) @ basis.T
            h_cc[:, j, :, i] = h_cc[:, i, :, j].T
    others = np.vstack([rows, residual[None]]).view(complex)
    cross = np.array([[basis @ blocks(white[i], other) for other in others] for i in range(k)])  # (k, others, orders)
    cross = 2 / sigma2 * cross.transpose(2, 0, 1).reshape(orders * k, -1)
    return Gram(h_cc=2 / sigma2 * h_cc.reshape(orders * k, orders * k), h_cj=cross[:, :-1], slope=cross[:, -1])


def score(fit: Fit, effect: Effect, grams: dict | None = None) -> Score:
    """Predicted gain in evidence of adding an effect, by one Gauss-Newton step from its start (Rao's score
    test)."""
    data, scene, family = fit.data, fit.data.scene, FAMILIES[effect.family]
    n, sigma2, grams = data.count, fit.sigma2, {} if grams is None else grams
    nest = family.nest(scene, effect)
    saved, gram = 0.0, None
    rows, inverse = (
        fit.rows,
        grams.setdefault("inverse", invert(fit.hessian + np.diag(fit.model.prior_precision()))),
    )
    residual = grams.setdefault("residual", real_rows(data.whitened(fit.residual[None]))[0])
    key = (effect.family, nest[0]) if nest else None
    if key not in grams or nest is None:
        probe = nest[1] if nest else effect
        model = fit.model.adding(probe)
        index = next(i for i, e in enumerate(model.effects) if e is probe)
        snapshots = []
        chain = _run(scene, model.base, model.effects, _start_chain(scene, model.base), 0, snapshots)
        before = snapshots[_steps(model.effects).index(index)]
        change = chain.y - fit.chain.y
        if float(np.vdot(change, change).real) > 1e-12 * float(np.vdot(fit.chain.y, fit.chain.y).real):
            # The start is elsewhere: gain and phase are set free there, the rest of the model stands still.
            residual = real_rows(data.whitened((data.y - chain.y)[None]))[0]
            rows = real_rows(data.whitened(np.stack([chain.y, 1j * chain.y])))
            saved = misfit(data, fit.chain.y) / sigma2 - float(residual @ residual) / sigma2
            inverse = invert(2 / sigma2 * rows @ rows.T)
        units = derivative_units(scene, model, index, chain, before)
        if units is not None:
            gram = _gram_of_courses(data, rows, residual, sigma2, *units)
        elif probe.free.any():
            gram = _gram(data, rows, residual, sigma2, effect_columns(scene, model, index, chain, before))
        if nest:
            grams[key] = gram
    if nest:
        gram = grams[key].part(nest[2])
    b_j = 2 / sigma2 * rows @ residual if saved else np.zeros(len(rows))
    gain = saved + 0.5 * b_j @ inverse @ b_j
    p, prior, occam = effect.p.copy(), None, 0.0
    if gram is not None:
        schur = gram.h_cc - gram.h_cj @ inverse @ gram.h_cj.T
        slope = gram.slope - gram.h_cj @ inverse @ b_j
        scale = np.diag(gram.h_cc)
        live = np.diag(schur) > SEEN * np.maximum(scale, 1e-9 * scale.max() + 1e-300)
        free = np.flatnonzero(effect.free)[live]
        if live.any():
            schur, slope = schur[np.ix_(live, live)], slope[live]
            if effect.prior is None:
                step = invert(schur, SEEN) @ slope
                gain += 0.5 * slope @ step
                p[free] += step
            else:
                more, occam, step, prior = _with_prior(schur, slope, effect.prior[free])
                gain += more
                p[free] += step
    if effect.prior is None:
        cost = 0.5 * np.log(n) * (effect.free.sum() + family.hidden(effect))
    else:
        cost = occam + 0.5 * np.log(n)
    gain = -n * np.log(max(1 - gain / n, 1e-12))  # the noise level is fitted too
    found = replace(effect, p=p)
    if stage_of(effect) == RX_FILTER:
        net = gain - cost - np.log(effect.trials)
        colour = grams.setdefault("colour", _colour_gain(fit))
        gain += colour if net > 0 else min(colour, 0.0)
    if prior is not None:
        full = effect.prior.copy()
        full[free] = prior
        found = replace(found, prior=full)
    return Score(net=float(gain - cost - np.log(effect.trials)), effect=found)


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


def _again(fit: Fit, effect: Effect) -> Effect:
    """A noise effect with its strength fitted to the residual; others as they are."""
    if effect.fixed or effect.family not in noise.TESTED:
        return effect
    _, found = FAMILIES[effect.family].find(noise.view_of(fit), near=effect)
    return effect if found is None else replace(found, trials=effect.trials)


def candidates(fit: Fit) -> list[Score]:
    """Every family's score on a fit, best first, at most two starts of a family."""
    view = View(fit)
    scores, grams = [], {}
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
            scores.append(score(fit, effect, grams))
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


def search(data: Data, model: Model, *, deadline: float = np.inf) -> list[Fit]:
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
            if time.monotonic() > deadline:
                break
            for s in _worth_trying(candidates(fit)):
                if time.monotonic() > deadline:
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
    return [eliminate(data, ranked[0]), *ranked[1:]]


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
    found = [model.adding(offset)]
    if scene.carrier_hz:
        gained = cycles / scene.duration_s / scene.carrier_hz * scene.count
        if abs(gained) > 0.05:
            found.append(found[0].adding(start(FAMILIES["sample_clock_offset"], [gained])))
    return found


def eliminate(data: Data, fit: Fit) -> Fit:
    """Take out, one by one, every effect that no longer pays its price."""
    while fit.model.found:
        worst = None
        for i, effect in enumerate(fit.model.effects):
            if effect.fixed or "read" in effect.aux:
                continue
            less = refit(data, fit.model.without(i))
            if less.evidence > fit.evidence - MARGIN and (worst is None or less.evidence > worst.evidence):
                worst = less
        if worst is None:
            return fit
        fit = worst
    return fit
