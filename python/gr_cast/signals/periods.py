# SPDX-License-Identifier: GPL-3.0-or-later
"""The period of a waveform that repeats."""

import numpy as np

ALIKE = 1e-6  # of the largest magnitude, by which samples of one place in the period may differ: rounding to single precision


def one_period(samples: np.ndarray) -> np.ndarray:
    """The shortest beginning (p,) of a repeated waveform (n,) complex, p a divisor of n, whose repetition it is. A file may
    hold several periods; delays and lost samples are known modulo one. Unknown samples, NaN, are alike only where both are."""
    period, largest = len(samples), np.nanmax(np.abs(samples))
    for factor in _prime_factors(len(samples)):
        shorter = period // factor
        if np.allclose(samples[shorter:period], samples[: period - shorter], rtol=0, atol=ALIKE * largest, equal_nan=True):
            period = shorter
    return samples[:period]


def _prime_factors(number: int) -> list[int]:
    """With their multiplicity."""
    found, factor = [], 2
    while factor * factor <= number:
        while number % factor == 0:
            found.append(factor)
            number //= factor
        factor += 1
    return [*found, number] if number > 1 else found
