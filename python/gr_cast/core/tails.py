# SPDX-License-Identifier: GPL-3.0-or-later
"""Tails of distributions, as logarithms that tell the rarer of two events however rare both are."""

import numpy as np
from scipy import special


def log_gamma_tail(energy: np.ndarray, count: np.ndarray | float) -> np.ndarray:
    """ln of the probability that the energy of `count` circular Gaussian samples of unit power is `energy` or more: of the gamma
    law's tail, and of the first term of its expansion (DLMF 8.11.2), as a geometric series, where that is less than floats
    can be."""
    with np.errstate(divide="ignore"):
        log_p = np.log(special.gammaincc(count, energy))
    far = np.maximum(energy, count)
    first = (count - 1) * np.log(far) - far - special.gammaln(count) + np.log(far / (far - count + 1))
    return np.where(np.isfinite(log_p), log_p, first)
