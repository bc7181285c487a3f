# SPDX-License-Identifier: GPL-3.0-or-later
"""Least squares of a model on a recording (Gauss-Newton with damped steps), and the evidence for it.

Noise is circular with power σ²·v[n] per sample; ln L = −Σ |r|²/(σ²v) − Σ ln(π σ² v) (Kay, Estimation
Theory, ch. 15).
Evidence takes off ½·ln N for every free number (Schwarz 1978), the Occam factor of priors, and ln of the
places tried.
"""

import time
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import fft as sp_fft
from scipy import linalg

from ..twin.columns import Dense, Lags, against, gram
from ..twin.effects import FAMILIES, Role, is_coarse, plays, stage_of
from ..twin.effects.base import RX_FILTER, RX_GAIN
from ..twin.effects.noise_family import LOUD, filled
from ..twin.model import Model, derivatives, predict, traced
from .policy import (
    COLOUR_ORDERS,
    DAMPINGS,
    KEPT_PROMISE,
    LARGE,
    LEAST_HEARD,
    SMALL,
    VALLEY_DAMPING,
    VALLEY_LEAST_NATS,
    VALLEY_STEPS,
)


@dataclass(frozen=True, kw_only=True)
class Data:
    """A recording with its scene. `use` (n,) 0 or 1: samples to fit; `vault` (n,) bool: samples that nothing is
    fitted to or chosen on; `variance` (n,) and `spectrum` (n,): shape of the noise."""

    scene: object
    y: np.ndarray
    use: np.ndarray
    vault: np.ndarray
    noise_power: float | None = None  # the twin's
    rounding: float = 0.0  # power that the steps of the file add, behind all else
    variance: np.ndarray | None = None
    spectrum: np.ndarray | None = None
    loud: bool = False  # whether gaps would spread a band of it over the rest
    impulses: tuple | None = None  # (effect, weight of every sample (n,)) where some hold an impulse
    deadline: float = np.inf  # on time.thread_time(): from then on fits stay where they are

    @property
    def late(self) -> bool:
        return time.thread_time() > self.deadline

    def whitened(self, signal: np.ndarray) -> np.ndarray:
        """Signals (…, n) divided by the noise's shape, zero where a sample is not used."""
        return self.even(signal, self.use > 0) * self.root

    def white(self, columns):
        """Derivatives as `whitened` makes them; of lags the signals alone are filtered, before the shift."""
        signals = self.even(columns.signals, self.use > 0)
        if isinstance(columns, Lags):
            return replace(columns, signals=signals, window=self.root)
        return replace(columns, signals=signals * self.root)

    def even(self, signal, inside):
        """Signals (…, n) divided by the noise's spectrum, of the samples `inside` (n,) bool alone."""
        if self.spectrum is None:
            return signal
        signal = filled(signal, inside, self.spectrum) if self.loud else signal * inside
        return sp_fft.ifft(sp_fft.fft(signal, axis=-1) / np.sqrt(self.spectrum), axis=-1)

    @property
    def root(self) -> np.ndarray:
        return np.sqrt(self.use) if self.variance is None else np.sqrt(self.use / self.variance)

    @property
    def count(self) -> float:
        return float(self.use.sum())

    def log_shape(self) -> float:
        """Σ ln of the noise's shape: what the likelihood pays for it."""
        total = 0.0 if self.variance is None else float(np.log(self.variance[self.use > 0]).sum())
        return total + (0.0 if self.spectrum is None else float(np.log(self.spectrum).mean() * self.count))


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A model at its optimum. `covariance` is that of the model's vector; nats are natural logarithms."""

    model: Model
    data: Data
    chain: object
    residual: np.ndarray
    sigma2: float
    columns: list  # whitened derivatives
    hessian: np.ndarray
    likelihood: float
    evidence: float
    notes: dict = field(default_factory=dict, compare=False)  # what was worked out about it once

    @cached_property
    def covariance(self) -> np.ndarray:
        return invert(self.hessian + np.diag(self.model.prior_precision()))

    def came(self, signal: np.ndarray) -> np.ndarray:
        """A signal of the recording as it came in, before the receiver's inversion where there is one."""
        return np.conj(signal) if self.chain.facing < 0 else signal


def invert(matrix: np.ndarray, blind: float = 0.0) -> np.ndarray:
    """Inverse of a symmetric matrix, scaled to unit diagonal first; directions with less than `blind` of
    information are
    left out, others without information get a large variance."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    if len(matrix) > LARGE and not blind and (factor := _factor(matrix, scale)) is not None:
        inverse, _ = linalg.lapack.dpotri(factor, lower=1)
        return (np.tril(inverse) + np.tril(inverse, -1).T) * np.outer(scale, scale)
    values, vectors = linalg.eigh(matrix * np.outer(scale, scale))
    inverse = np.where(values > blind, 1 / np.maximum(values, 1e-12), 0.0)
    return (vectors * inverse) @ vectors.T * np.outer(scale, scale)


def _factor(matrix: np.ndarray, scale: np.ndarray) -> np.ndarray | None:
    """The lower Cholesky factor of a symmetric matrix of unit diagonal under `scale`; None where it is not positive: one of many
    numbers is held by priors."""
    try:
        return linalg.cholesky(matrix * np.outer(scale, scale) + 1e-12 * np.eye(len(matrix)), lower=True)
    except linalg.LinAlgError:
        return None


def _solved(matrix: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """`invert(matrix) @ slope`, without the inverse where that is large."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    if len(matrix) > LARGE and (factor := _factor(matrix, scale)) is not None:
        return linalg.cho_solve((factor, True), slope * scale) * scale
    return invert(matrix) @ slope


def misfit(data: Data, y: np.ndarray) -> float:
    r = data.whitened(data.y - y)
    return float(np.vdot(r, r).real)


class _Stand:
    """Where a fit stands, with what its next step and its end need, each worked out once."""

    def __init__(self, data: Data, model: Model):
        self.data, self.model = data, model
        self.chain, self.before = traced(data.scene, model)
        self.left = data.whitened(data.y - self.chain.y)
        self.cost = float(np.vdot(self.left, self.left).real)

    @cached_property
    def white(self) -> list:
        """Whitened derivatives."""
        return [self.data.white(columns) for columns in derivatives(self.data.scene, self.model, self.before)]

    @cached_property
    def gram(self) -> np.ndarray:
        return gram(self.white)

    def slopes(self) -> np.ndarray:
        return against(self.white, Dense(signals=self.left[None]))[:, 0]

    def bends(self, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """(curvature of −ln L, slope of ln L and of the prior) by the vector of the model; None where either is no number."""
        return self.bends_by(self.gram, self.slopes(), prior, self.model.vector())

    def bends_by(self, products, slopes, prior, vector) -> tuple[np.ndarray, np.ndarray] | None:
        """The same by some numbers of the vector, of the inner products of their derivatives with each other and what is left."""
        precision = 2 / (self.cost / self.data.count)
        hessian, slope = precision * products, precision * slopes - prior * vector
        return (hessian, slope) if np.isfinite(hessian).all() and np.isfinite(slope).all() else None


def solve(data: Data, model: Model, *, iterations: int = 8, tolerance: float = 0.05) -> Fit:
    """The model at the nearest optimum of the likelihood, from where it stands."""
    prior, here, n = model.prior_precision(), _Stand(data, model), data.count
    for _ in range(iterations if len(prior) < 40 or n < SMALL else min(iterations, 3)):
        if data.late:
            break
        if (bends := here.bends(prior)) is None:
            break
        (hessian, slope), vector = bends, here.model.vector()
        best, least = here, _objective(here, prior)
        for damping in DAMPINGS:
            step = _solved(hessian + np.diag(prior + damping * np.diag(hessian)), slope)
            if not damping and 0.5 * slope @ step < tolerance:
                return _finish(here)
            to = _limited(here.model, step)
            promised = slope @ (to - vector) - 0.5 * (to - vector) @ (hessian + np.diag(prior)) @ (to - vector)
            trial = _Stand(data, here.model.at(to))
            if not damping and _gained(here, trial, prior) <= KEPT_PROMISE * promised:
                trial = _in_its_valley(trial, prior)
            left = _objective(trial, prior)
            if left >= least and best is not here:
                break
            if left < least:
                best, least = trial, left
                if _gained(here, trial, prior) > KEPT_PROMISE * promised:
                    break
        if best is here:
            break
        here = best
    return _finish(here)


def _gained(here: _Stand, there: _Stand, prior: np.ndarray) -> float:
    """Nats, at the noise's level as it is here, by which another stand is better."""
    of_prior = 0.5 * float(np.sum(prior * (here.model.vector() ** 2 - there.model.vector() ** 2)))
    return (here.cost - there.cost) * here.data.count / here.cost + of_prior


def _objective(stand: _Stand, prior: np.ndarray) -> float:
    """−ln L and what priors make of it, but for a constant; infinite where the prediction is no number."""
    if not np.isfinite(stand.cost):
        return np.inf
    return stand.data.count * np.log(stand.cost) + 0.5 * float(np.sum(prior * stand.model.vector() ** 2))


def _in_its_valley(stand: _Stand, prior: np.ndarray) -> _Stand:
    """Where a fit stands once gains and rows of taps suit its delay and all else: a step along the tangent of all of them leaves
    the narrow curved valley of delays and taps that do the same (variable projection, Golub and Pereyra 1973)."""
    data, model = stand.data, stand.model
    rows = [i for i, e in enumerate(model.effects) if e.free.any() and FAMILIES[e.family].row_of_taps]
    moves = np.concatenate([np.arange(len(prior))[span] for span in (slice(1, len(model.base)), *map(model.span, rows))])
    for _ in range(VALLEY_STEPS if rows and np.isfinite(stand.cost) else 0):
        white = [data.white(columns) for columns in derivatives(data.scene, stand.model, stand.before, rows)]
        slopes, vector = against(white, Dense(signals=stand.left[None]))[1:, 0], stand.model.vector()
        if (bends := stand.bends_by(gram(white)[1:, 1:], slopes, prior[moves], vector[moves])) is None:
            break
        hessian, slope = bends
        vector[moves] += _solved(hessian + np.diag(prior[moves] + VALLEY_DAMPING * np.diag(hessian)), slope)
        further = _Stand(data, stand.model.at(vector))
        gained = _objective(stand, prior) - _objective(further, prior)
        stand = further if gained > 0 else stand
        if gained < VALLEY_LEAST_NATS:
            break
    return stand


def _limited(model: Model, step: np.ndarray) -> np.ndarray:
    """The vector after a step; delays and frequencies move by less than their neighbourhood of linearity."""
    limit = np.full(len(step), np.inf)
    limit[0] = 0.7
    for i, effect in enumerate(model.effects):
        if effect.prior is None and not FAMILIES[effect.family].linear:
            limit[model.span(i)] = FAMILIES[effect.family].limits(effect)[effect.free]
    return model.vector() + np.clip(step, -limit, limit)


def _finish(here: _Stand) -> Fit:
    data, n = here.data, here.data.count
    sigma2 = max(here.cost / n, 1e-30)
    hessian = np.nan_to_num(2 / sigma2 * here.gram)
    likelihood = -n * (np.log(sigma2) + 1) - data.log_shape()
    if data.impulses:
        effect, weight = data.impulses
        used = data.use > 0
        energy = np.abs(here.left[used]) ** 2 / weight[used] / sigma2
        both = FAMILIES[effect.family].likelihood(effect, energy).sum() - np.log(weight[used]).sum()
        likelihood = float(both - n * np.log(sigma2) - data.log_shape())
    return Fit(
        model=here.model,
        data=data,
        chain=here.chain,
        residual=data.y - here.chain.y,
        sigma2=sigma2,
        columns=here.white,
        hessian=hessian,
        likelihood=likelihood,
        evidence=likelihood - price(here.model, hessian, n),
    )


def price(model: Model, hessian: np.ndarray, count: float) -> float:
    """Nats that the found effects cost: their free numbers, priors and places tried."""
    total = 0.0
    for i, effect in enumerate(model.effects):
        if effect.fixed:
            continue
        span = model.span(i)
        total += np.log(effect.trials)
        if effect.prior is None:
            total += 0.5 * np.log(count) * (span.stop - span.start + FAMILIES[effect.family].hidden(effect))
        else:
            p, variance = effect.p[effect.free], effect.prior[effect.free]
            block = hessian[span, span] * np.sqrt(np.outer(variance, variance))
            occam = 0.5 * np.sum(p**2 / variance) + 0.5 * np.linalg.slogdet(np.eye(len(p)) + block)[1]
            total += occam + 0.5 * np.log(count) * (1 + FAMILIES[effect.family].hidden(effect))
    if filters_noise(model):
        total += COLOUR_ORDERS * np.log(count)
    return total


def with_noise(fit: Fit, model: Model) -> Data:
    """The data with the noise's shape that the noise effects of `model` give around the prediction of
    `fit`."""
    spectrum = smooth_spectrum(fit.data, fit.residual) if filters_noise(model) else None
    variance, over, band, scattered, impulses, loud = shape_of_receiver(fit, model), 0.0, None, None, None, False
    for effect in model.effects:
        family = FAMILIES[effect.family]
        if family.noise_like:
            v, s = (
                family.variance(fit.data.scene, effect, fit.chain.wanted),
                family.spectrum(fit.data.scene, effect),
            )
            over = over if v is None else over + v - 1  # powers of noise add
            loud |= s is not None and s.max() > LOUD * np.median(s)
            band = s if band is None else band if s is None else band * s
        elif effect.fixed and family.random:
            told = fit.data.noise_power or fit.sigma2
            v = 1 + family.unfollowed(effect) * np.abs(fit.chain.wanted) ** 2 / told
            variance = v if variance is None else variance * v
        if family.scattered and not effect.fixed:
            scattered = effect
    if np.ndim(over):
        variance = 1 + over if variance is None else variance * (1 + over)
    if scattered is not None:
        weight = _weight(fit, scattered, replace(fit.data, variance=variance, spectrum=band, loud=loud))
        impulses = scattered, weight
        variance = 1 / weight if variance is None else variance / weight
    if band is not None:
        spectrum = band if spectrum is None else spectrum * band
    return replace(fit.data, variance=variance, spectrum=spectrum, loud=loud, impulses=impulses)


def _weight(fit: Fit, scattered, even: Data) -> np.ndarray:
    """(n,) what samples tell that may hold an impulse, beside noise as `even` has it; those held out know of each other alone."""
    used, family = even.use > 0, FAMILIES[scattered.family]

    def weight(inside):
        power = np.abs(even.even(fit.residual, inside)) ** 2
        return family.weight(scattered, power if even.variance is None else power / even.variance)

    return weight(used) if even.spectrum is None else np.where(even.vault, weight(used | even.vault), weight(used))


def smooth_spectrum(data: Data, residual: np.ndarray, orders: int = COLOUR_ORDERS) -> np.ndarray:
    """(n,) noise density of a residual relative to its geometric mean, from the first `orders` cepstral
    coefficients."""
    n, bins = len(residual), 128
    power = np.abs(sp_fft.fft(residual * (data.use > 0))) ** 2
    edges = np.linspace(0, n, bins + 1).astype(int)[:-1]
    log_power = np.log(np.add.reduceat(power, edges) / np.diff(np.append(edges, n)) + 1e-300)
    cepstrum = sp_fft.ifft(log_power)
    cepstrum[0] = 0.0
    cepstrum[orders + 1 : bins - orders] = 0.0
    turn = np.exp(2j * np.pi * np.arange(bins) * 0.5 / bins)  # a cell's middle lies half a cell above its edge
    wide = np.zeros(n, complex)
    keep = np.arange(-orders, orders + 1)
    wide[keep % n] = cepstrum[keep % bins] * np.where(keep >= 0, np.conj(turn[keep % bins]), turn[-keep % bins])
    return np.exp(np.clip(sp_fft.fft(wide).real, -6, 6))


def in_band(fit: Fit, size: int) -> np.ndarray:
    """(size,) bool: the bins of an FFT of the recording in which the wanted signals lie."""
    occupied = fit.data.scene.occupied
    occupied = occupied if fit.chain.facing > 0 else np.roll(occupied[::-1], 1)
    return occupied[np.arange(size) * len(occupied) // size]


def filters_noise(model: Model) -> bool:
    """Whether the receiver has a filter that noise passes too."""
    return any(stage_of(e) == RX_FILTER for e in model.effects)


def shape_of_receiver(fit: Fit, model: Model):
    """(n,) power over time that gain and quantiser of the receiver give to even noise, None where they do
    nothing; no gain changes what the file's own steps add."""
    shape = gain_of_receiver(fit, model)
    if shape is not None:
        steps = min(fit.data.rounding / fit.sigma2, 1.0)
        shape = steps + (1 - steps) * shape
    for effect in model.effects:
        if is_coarse(effect):
            predict(fit.data.scene, fit.model)  # leaves the prediction in front of the quantiser
            v = FAMILIES[effect.family].variance(fit.data.scene, effect, fit.chain.wanted)
            shape = v if shape is None else shape if v is None else shape * v
    return shape


def rounding_of_grids(fit: Fit) -> float:
    """Power that the steps of coarse converters add, of the twin's and of found ones, beside the file's own."""
    return sum(FAMILIES[e.family].rounding(e) for e in fit.model.effects)


def off_the_rails(fit: Fit, among: np.ndarray | None = None) -> np.ndarray:
    """(n,) bool: samples, used or `among` others, whose prediction stays three noise deviations inside the rails, which eat noise
    in step with the code; none where they leave too few to tell anything of the noise."""
    inside = fit.data.use > 0 if among is None else among
    for e in fit.model.effects:
        if plays(e, Role.RAILS):
            level = e.p[0] - 3 * np.sqrt(fit.sigma2 / 2)
            inside = inside & (np.abs(fit.chain.y.real) < level) & (np.abs(fit.chain.y.imag) < level)
    return inside & (among is not None or inside.sum() >= LEAST_HEARD)


def of_even_noise(fit: Fit) -> np.ndarray:
    """(n,) bool: samples `off_the_rails` in which no impulse is likelier than none: an impulse has a colour of its own."""
    inside = off_the_rails(fit)
    return inside if fit.data.impulses is None else inside & (fit.data.impulses[1] > 0.5)


def within(fit: Fit, inside: np.ndarray) -> Fit:
    """A fit as a test of its noise sees it: the samples `inside` (n,) bool alone, and the level that the noise has there."""
    if np.array_equal(inside, fit.data.use > 0) or not inside.any():
        return fit
    sigma2 = float(np.mean(np.abs(fit.data.whitened(fit.residual)[inside]) ** 2))
    return replace(fit, data=replace(fit.data, use=np.where(inside, fit.data.use, 0.0)), sigma2=sigma2, notes={})


def gain_of_receiver(fit: Fit, model: Model):
    """Noise enters before the receiver's gain, so that a change of gain scales it too; None where there is
    none."""
    chain = type(fit.chain)(scene=fit.data.scene, delay=0.0, ports={}, u=fit.chain.u)
    chain.y = chain.wanted = np.ones(fit.data.scene.count)
    changed = False
    for effect in model.effects:
        if stage_of(effect) == RX_GAIN:
            FAMILIES[effect.family].apply(chain, effect)
            changed = True
    return np.maximum(chain.y**2, 1e-6) if changed else None
