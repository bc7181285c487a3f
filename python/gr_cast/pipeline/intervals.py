# SPDX-License-Identifier: GPL-3.0-or-later
"""Intervals of paired differences, and what they say against a tolerance."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import stats

FAMILY_ERROR = 0.01  # chance that any interval of one commit misses: some hundred commits for one false alarm


@dataclass(frozen=True, kw_only=True)
class Difference:
    """The mean of n paired differences, and the interval that holds it but for a chance that many intervals share."""

    mean: float
    low: float
    high: float
    std: float
    n: int

    def said(self, tolerance: float) -> str:
        """`within` the tolerance, `beyond` it, or `open`: the interval holds both."""
        if -tolerance <= self.low and self.high <= tolerance:
            return "within"
        return "beyond" if self.low > tolerance or self.high < -tolerance else "open"

    def worse(self, tolerance: float, better: str) -> str:
        """`said` of a change in the bad direction alone: what gets better is `within`."""
        low, high = (self.low, self.high) if better == "lower" else (-self.high, -self.low)
        return "beyond" if low > tolerance else "within" if high <= tolerance else "open"

    def repeats_wanted(self, tolerance: float) -> int:
        """How many repeats would settle what is open, if they spread as these do: the half width as far as the next limit."""
        gap = max(abs(abs(self.mean) - tolerance), 1e-3 * max(tolerance, abs(self.mean), 1e-12))
        half = (self.high - self.low) / 2
        return int(np.clip(np.ceil(self.n * (half / gap) ** 2), self.n + 1, 1000))


@lru_cache(maxsize=1024)
def _quantile(comparisons: int, freedom: int) -> float:
    return float(stats.t.ppf(1 - FAMILY_ERROR / (2 * comparisons), freedom))


def paired(a: np.ndarray, b: np.ndarray, comparisons: int) -> Difference:
    """b − a, (n,) each, repeat by repeat: Student's interval, as wide as so many comparisons at once need (Bonferroni).

    Where all differences are equal the interval is that one number.
    """
    d = np.asarray(b, float) - np.asarray(a, float)
    mean, std = float(np.mean(d)), float(np.std(d, ddof=1))
    half = _quantile(max(comparisons, 1), len(d) - 1) * std / np.sqrt(len(d))
    return Difference(mean=mean, low=mean - half, high=mean + half, std=std, n=len(d))
