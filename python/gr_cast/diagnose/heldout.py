# SPDX-License-Identifier: GPL-3.0-or-later
"""What a fit is worth on samples that it has not seen: of the vault, which nothing is chosen on, and of folds, which
effects are chosen on."""

from dataclasses import replace

import numpy as np

from ..twin.effects import FAMILIES
from ..twin.model import derivatives, traced
from .fit import Data, Fit
from .policy import FOLD_OF, FOLD_RUN, FOLDS, OFF, STRETCH


def folds(data: Data) -> list[Data]:
    """`data` with other samples of its own held out each time, in the place of its vault."""
    used, rng = data.use > 0, np.random.default_rng(2)
    number = (np.cumsum(used) - 1) // FOLD_RUN
    order = rng.permuted(np.tile(np.arange(FOLD_OF), (number[-1] // FOLD_OF + 1, 1)), axis=1).ravel()[number]
    out = [used & (order == k) for k in range(FOLDS)]
    return [replace(data, use=data.use * ~held, vault=held) for held in out]


def log_likelihood(fit: Fit) -> float:
    """ln L of the vault's samples, with the noise's level, shape and colour as the other samples gave them."""
    energy, log_shape = _foretold(fit)
    return float(-energy.sum() - log_shape.sum())


def gained(fit: Fit, without: Fit) -> float:
    """Nats by which the vault's samples are likelier under one fit than under another. The noise's level is known from so many
    samples only, so that energies follow Student's law and wild ones say no more than the others can (Gelman, BDA3, ch. 3).
    Samples around a moment say nothing, for it was placed without them."""
    unplaced = _around_moments(fit) | _around_moments(without)
    apart = (replace(f, data=replace(f.data, vault=f.data.vault & ~unplaced)) for f in (fit, without))
    there, not_there = (_student(f) for f in apart)
    return there - not_there


def spread(fit: Fit, without: Fit) -> float:
    """Standard deviation of `gained` where few stretches of the recording hold all that is gained, by what those of the fitted
    samples gain: how many of them fall into the vault is left to chance (Poisson)."""
    used = fit.data.use > 0
    gains = [-energy - log_shape for energy, log_shape in (_seen(f, used) for f in (fit, without))]
    stretches = np.add.reduceat(gains[0] - gains[1], np.arange(0, int(used.sum()), STRETCH))
    return float(np.sqrt(np.sum(stretches**2) * fit.data.vault.sum() / fit.data.count))


def _around_moments(fit: Fit) -> np.ndarray:
    """(n,) bool: samples between the fitted ones that surely lie before a moment of what was found and surely behind it."""
    scene, used = fit.data.scene, np.flatnonzero(fit.data.use > 0)
    around = np.zeros(len(fit.data.use), bool)
    for effect in fit.model.found:
        if (moment := FAMILIES[effect.family].moment(scene, effect)) is not None:
            first = np.searchsorted(scene.index, moment)
            before, behind = used[used < first - OFF], used[used >= first + OFF]
            around[before[-1] + 1 if len(before) else 0 : behind[0] if len(behind) else None] = True
    return around


def _student(fit: Fit) -> float:
    (energy, log_shape), count = _foretold(fit), fit.data.count
    return float(-(count + len(energy)) * np.log1p(max(energy.sum(), 1 - count) / count) - log_shape.sum())


def _foretold(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """`_seen` of the vault's samples, whose random courses are known less well than those that were fitted."""
    return _seen(fit, fit.data.vault, _left_open(fit)[fit.data.vault])


def _left_open(fit: Fit) -> np.ndarray:
    """(n,) variance that what is not known of random courses leaves in the prediction."""
    scene, model, total = fit.data.scene, fit.model, np.zeros(len(fit.data.use))
    courses = [i for i, e in enumerate(model.effects) if e.prior is not None and FAMILIES[e.family].wanders and e.free.any()]
    if not courses:
        return total
    for i, columns in zip(courses, derivatives(scene, model, traced(scene, model)[1], courses)[1:], strict=True):
        span = model.span(i)
        total += columns.spread(fit.covariance[span, span])
    return total


def _seen(fit: Fit, inside: np.ndarray, left_open: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """(energy over its expectation, the rest of −ln L) of samples `inside` (n,) bool, with a variance of the prediction there."""
    data, r = fit.data, fit.residual
    variance = np.full(int(inside.sum()), fit.sigma2)
    if data.variance is not None:
        variance = variance * data.variance[inside]
    variance = variance + left_open
    log_shape = np.log(np.pi * variance)
    if data.spectrum is not None:
        r = data.even(r, (data.use > 0) | data.vault)
        log_shape = log_shape + np.log(data.spectrum).mean()
    energy = np.abs(r[inside]) ** 2 / variance
    if data.impulses is None:
        return energy, log_shape
    effect, weight = data.impulses  # what is expected of a sample does not know whether an impulse was in it
    both = FAMILIES[effect.family].likelihood(effect, energy / weight[inside])
    return np.log(weight[inside]) - both, log_shape


def of_variance(energy: np.ndarray, variance: np.ndarray) -> float:
    """Nats by which `variance` (n,) is likelier than 1 for samples of `energy` (n,) = |r|² of circular noise; no more than the
    logarithm of how much stronger they are, for no level is known so well that more could be told."""
    if not len(energy):
        return 0.0
    nats = float((energy - energy / variance - np.log(variance)).sum())
    return min(nats, len(energy) * abs(float(np.log(energy.mean()))))
