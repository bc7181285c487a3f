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
    """To 10⁻⁹, and to 10⁻³ where the first term of the tail stands in for it."""
    total = sum(Fraction(energy**k, factorial(k)) for k in range(count))
    exact = log(total.numerator) - log(total.denominator) - energy
    near = 1e-9 * max(abs(exact), 1) if energy < 740 else 1e-3
    assert log_gamma_tail(float(energy), float(count)) == pytest.approx(exact, abs=near)


@pytest.mark.parametrize("count", [1.0, 2.5, 16.0, 100.0, 1e4])
def test_more_is_rarer_where_one_way_to_tell_it_ends_and_another_begins(count):
    tails = log_gamma_tail(count + np.linspace(0, 40 * np.sqrt(count) + 2000, 4000), count)
    assert np.isfinite(tails).all() and tails[-1] < -750 and np.diff(tails).max() < 0.1


def test_of_two_that_floats_cannot_hold_the_rarer_one_is_told():
    tails = log_gamma_tail(np.array([700.0, 760.0, 1e4, 1e6]), 4.0)
    assert np.isfinite(tails).all() and (np.diff(tails) < 0).all()


def test_nothing_is_as_sure_as_can_be():
    assert log_gamma_tail(0.0, 5.0) == 0.0
