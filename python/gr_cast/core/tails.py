# SPDX-License-Identifier: GPL-3.0-or-later
"""Tails of distributions, as logarithms that tell the rarer of two events however rare both are."""

import numpy as np
from scipy import stats


def log_gamma_tail(energy: np.ndarray, count: np.ndarray | float) -> np.ndarray:
    """ln of the probability that the energy of `count` circular Gaussian samples of unit power is `energy` or more: of the gamma
    law's tail, and Chernoff's bound of it (1952) where that is less than floats can be."""
    log_p = stats.gamma.logsf(energy, count)
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = count - energy + count * np.log(energy / count)
    return np.where(np.isfinite(log_p), log_p, bound)
