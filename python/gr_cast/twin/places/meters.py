# SPDX-License-Identifier: GPL-3.0-or-later
"""What a meter of received power makes of it: fading about the mean that the paths give, and where its scale ends."""

from dataclasses import dataclass

import numpy as np
from scipy.special import digamma, polygamma

from ...core.units import power_from_db

DB_PER_NEPER = 10 / np.log(10)  # of power


@dataclass(frozen=True, kw_only=True)
class Meter:
    """A receiver's scale: it reads no more than `top_db`, no less than `floor_db`, in multiples of `step_db`, and its own noise,
    `noise_db`, along with what comes."""

    noise_db: float = -np.inf
    top_db: float = np.inf
    floor_db: float = -np.inf
    step_db: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Fading:
    """Rician power of mean 1 on a link: K, and the way over which its diffuse part keeps 1/e of its correlation."""

    k_factor_db: float
    coherence_m: float

    def moments_db(self) -> tuple[float, float]:
        """Mean and variance of the power in dB: (K + 1)·X is a Gamma of order 1 + n, n Poisson of mean K."""
        k = power_from_db(self.k_factor_db)
        n = np.arange(int(min(max(40.0, k + 12 * np.sqrt(k)), 2000)) + 1)
        weight = np.exp(n * np.log(k) - k - np.concatenate([[0.0], np.cumsum(np.log(n[1:]))]))
        mean = digamma(1.0 + n)
        first = (weight * mean).sum()
        second = (weight * (polygamma(1, 1.0 + n) + mean**2)).sum()
        return DB_PER_NEPER * (first - np.log1p(k)), DB_PER_NEPER**2 * (second - first**2)

    def covariance_db2(self, gap_m: np.ndarray) -> np.ndarray:
        """Of readings that are `gap_m` apart: that of power, with the variance of its dB."""
        k = power_from_db(self.k_factor_db)
        ray = np.exp(-((gap_m / self.coherence_m) ** 2))
        return self.moments_db()[1] * (2 * k * ray + ray**2) / (2 * k + 1)
