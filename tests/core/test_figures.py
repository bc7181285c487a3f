# SPDX-License-Identifier: GPL-3.0-or-later
import pytest
from gr_cast.core.figures import fixed, with_error


@pytest.mark.parametrize(
    "value, std, text",
    [
        (-3.00241, 0.0123, "-3.002 ± 0.012"),
        (1234.56, 78.9, "1235 ± 79"),
        (0.5, 3.0, "0.5 ± 3.0"),
        (-1e-9, 1e-7, "0.0000 ± <0.0001"),
        (-0.0004, 0.02, "0.000 ± 0.020"),
        (20.0, None, "20.00"),
        (20.0, float("inf"), "20.00"),
        (20.0, 0.0, "20.0000 ± <0.0001"),
    ],
)
def test_a_figure_has_as_many_digits_as_its_error_and_never_a_zero_error(value, std, text):
    assert with_error(value, std) == text


def test_what_rounds_to_zero_has_no_sign():
    assert (fixed(-0.04, 1), fixed(-0.06, 1), fixed(0.0, 2)) == ("0.0", "-0.1", "0.00")
