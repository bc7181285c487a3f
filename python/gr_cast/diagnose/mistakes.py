# SPDX-License-Identifier: GPL-3.0-or-later
"""What in a case looks like a slip of units. It may be meant so: it is said, and refused by nobody."""

import math

from ..signals import recording
from .policy import CARRIER_OFF


def of_carriers(case) -> list[str]:
    """A sentence for each recording that was made on another carrier than the twin has of it, if both say one."""
    told = [(one.name, one.center_frequency_hz, _recorded_hz(case.folder / one.name)) for one in case.observations]
    return [
        f"{name}: recorded at {recorded_hz:g} Hz (core:frequency), and the twin's center_frequency_hz of it is {carrier_hz:g} "
        "Hz: is it in MHz or GHz, or of another band?"
        for name, carrier_hz, recorded_hz in told
        if None not in (carrier_hz, recorded_hz) and not math.isclose(carrier_hz, recorded_hz, rel_tol=CARRIER_OFF)
    ]


def _recorded_hz(stem) -> float | None:
    """The carrier of the first capture that has one."""
    captures = recording.read_metadata(stem)["captures"]
    return next((one["core:frequency"] for one in captures if one.get("core:frequency") is not None), None)
