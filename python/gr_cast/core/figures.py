# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers as people read them: no more digits than the error has, and no −0."""

import math


def digits_of(std: float, most: int) -> int:
    """Decimals that show two digits of an error, at most `most`."""
    return most if std <= 0 else min(max(1 - math.floor(math.log10(std)), 0), most)


def fixed(value: float, digits: int) -> str:
    """The value with so many decimals; what rounds to zero has no sign."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def with_error(value: float, std: float | None, most: int = 4) -> str:
    """`value ± std` with at most `most` decimals: a smaller error is below the last of them. Without an error two decimals."""
    if std is None or not math.isfinite(std):
        return fixed(value, 2)
    digits = digits_of(std, most)
    shown = fixed(std, digits)
    return f"{fixed(value, digits)} ± {shown if float(shown) else f'<{10.0**-digits:.{digits}f}'}"
