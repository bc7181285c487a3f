# SPDX-License-Identifier: GPL-3.0-or-later
"""Rates and carriers as people write them: `20e6`, `20M`, `30.72MS/s`. A number that is far too small was meant in MHz: it is
questioned wherever it is read, unless its unit stands behind it (`2400Hz`)."""

import re

LEAST_RATE_HZ = 1e3  # of samples or of a band
LEAST_CARRIER_HZ = 1e6
_UNITS = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}
FREQUENCY = re.compile(r"([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)([kMG]?)(Hz|S/s)?")


def hertz(value: str | float, least_hz: float, what: str) -> float:
    """Hz of a number, or of a text as above. Raises ValueError, which says what is wrong, also where MHz were meant."""
    match = FREQUENCY.fullmatch(value) if isinstance(value, str) else None
    try:
        number = float(match[1]) * _UNITS[match[2]] if match else float(value if not isinstance(value, str) else "none")
    except ValueError:
        raise ValueError(f"got {value!r}, needs a number of Hz, such as 20e6, 20M or 30.72M") from None
    if question := questioned(number, least_hz, what, str(value)) if not (match and match[3]) else "":
        raise ValueError(question)
    return number


def questioned(number_hz: float, least_hz: float, what: str, shown: str = "") -> str:
    """The question whether MHz were meant; "" of a number that needs none. 0 is a carrier, of samples that have none."""
    shown = shown or f"{number_hz:g}"
    if not 0 < number_hz < least_hz:
        return ""
    meant = f"is {shown}M meant? " if shown[-1].isdigit() else ""
    return f"got {shown}, {number_hz:g} Hz: {meant}{what} below {least_hz:g} Hz needs its unit: {number_hz:g}Hz"


def written(number_hz: float, least_hz: float) -> float | str:
    """A frequency as `hertz` reads it again without a question."""
    return f"{number_hz!r}Hz" if 0 < number_hz < least_hz else number_hz
