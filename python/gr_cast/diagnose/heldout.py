# SPDX-License-Identifier: GPL-3.0-or-later
"""What a fit is worth on the vault: samples that nothing was fitted to and nothing was chosen on."""

import numpy as np
from scipy import fft as sp_fft

from ..effects import FAMILIES
from .fit import Fit


def log_likelihood(fit: Fit) -> float:
    """ln L of the vault's samples, with the noise's level, shape and colour as the other samples gave them."""
    data, vault = fit.data, fit.data.vault
    r, variance = fit.residual, np.full(int(vault.sum()), fit.sigma2)
    if data.variance is not None:
        variance = variance * data.variance[vault]
    log_shape = np.log(np.pi * variance).sum()
    if data.spectrum is not None:
        r = sp_fft.ifft(sp_fft.fft(r * ((data.use > 0) | vault)) / np.sqrt(data.spectrum))
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
