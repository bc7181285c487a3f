# SPDX-License-Identifier: GPL-3.0-or-later
"""Tails of distributions against sums of exact fractions, where floats have long run out."""

from fractions import Fraction
from math import factorial, log

import numpy as np
import pytest
from gr_cast.core.tails import log_gamma_tail


@pytest.mark.parametrize("count", [1, 2, 16])
@pytest.mark.parametrize("energy", [3, 40, 700, 800, 5000])
def test_the_tail_of_a_whole_count_is_that_of_poissons_law(energy, count):
    """To 10⁻⁹, or by no more than Stirling's ½·ln(2πk) + ln(x/(x − k)) where the bound stands in for it."""
    total = sum(Fraction(energy**k, factorial(k)) for k in range(count))
    exact = log(total.numerator) - log(total.denominator) - energy
    near = 1e-9 * max(abs(exact), 1) if energy < 740 else 0.5 * np.log(2 * np.pi * count) + 0.1 + np.log(energy / count)
    assert log_gamma_tail(float(energy), float(count)) == pytest.approx(exact, abs=near)


def test_of_two_that_floats_cannot_hold_the_rarer_one_is_told():
    tails = log_gamma_tail(np.array([700.0, 760.0, 1e4, 1e6]), 4.0)
    assert np.isfinite(tails).all() and (np.diff(tails) < 0).all()


def test_nothing_is_as_sure_as_can_be():
    assert log_gamma_tail(0.0, 5.0) == 0.0
