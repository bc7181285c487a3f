# SPDX-License-Identifier: GPL-3.0-or-later
"""What a fit is worth on samples that it has not seen: of the vault, which nothing is chosen on, and of folds, which
effects are chosen on."""

from dataclasses import replace

import numpy as np

from ..twin.effects import FAMILIES
from .fit import Data, Fit

FOLDS = 2
FOLD_RUN, FOLD_OF = 16, 4  # samples at a stretch that a fold leaves out, and of how many such runs one


def folds(data: Data) -> list[Data]:
    """`data` with other samples of its own held out each time, in the place of its vault."""
    used, rng = data.use > 0, np.random.default_rng(2)
    number = (np.cumsum(used) - 1) // FOLD_RUN
    order = rng.permuted(np.tile(np.arange(FOLD_OF), (number[-1] // FOLD_OF + 1, 1)), axis=1).ravel()[number]
    out = [used & (order == k) for k in range(FOLDS)]
    return [replace(data, use=data.use * ~held, vault=held) for held in out]


def log_likelihood(fit: Fit) -> float:
    """ln L of the vault's samples, with the noise's level, shape and colour as the other samples gave them."""
    data, vault = fit.data, fit.data.vault
    r, variance = fit.residual, np.full(int(vault.sum()), fit.sigma2)
    if data.variance is not None:
        variance = variance * data.variance[vault]
    log_shape = np.log(np.pi * variance).sum()
    if data.spectrum is not None:
        r = data.even(r, (data.use > 0) | vault)
        log_shape += np.log(data.spectrum).mean() * len(variance)
    energy = np.abs(r[vault]) ** 2 / variance
    if data.impulses is None:
        return float(-energy.sum() - log_shape)
    effect, weight = data.impulses  # what is expected of a sample does not know whether an impulse was in it
    both = FAMILIES[effect.family].likelihood(effect, energy / weight[vault])
    return float((both - np.log(weight[vault])).sum() - log_shape)


def of_variance(energy: np.ndarray, variance: np.ndarray) -> float:
    """Nats by which `variance` (n,) is likelier than 1 for samples of `energy` (n,) = |r|² of circular noise."""
    return float((energy - energy / variance - np.log(variance)).sum())
