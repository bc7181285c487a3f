# SPDX-License-Identifier: GPL-3.0-or-later
"""Time of flight: delays since the second of UTC at which both ends began, less what cables and filters of the set-up add."""

from ..signals.recording import Recording

_BELOW_ZERO = 1 / 8  # of a period: a set-up's delay has an error, too, and a path of no length may come out a little early


def is_disciplined(file: Recording) -> bool:
    """Whether the recording began at a second of UTC, so that its delays are not only differences."""
    return file.metadata.get("cast:time_axis") == "utc"


def told(document: dict, file: Recording, repeats: bool, base_delay_s: float | None) -> dict:
    """The content of result.json with `time_axis`, `base_delay_s` and every tap's `time_of_flight_s`, null where delays are only
    differences. A waveform that repeats tells it modulo its period."""
    period_s = document["period_samples"] / document["sample_rate_hz"] if repeats else None
    known = is_disciplined(file)
    taps = [
        tap | {"time_of_flight_s": _within(tap["delay_s"] - (base_delay_s or 0.0), period_s) if known else None}
        for tap in document["taps"]
    ]
    axis = file.metadata.get("cast:time_axis")
    return document | {"time_axis": axis, "base_delay_s": base_delay_s if known else None, "taps": taps}


def _within(flight_s: float, period_s: float | None) -> float:
    if period_s is None:
        return flight_s
    below_s = _BELOW_ZERO * period_s
    return (flight_s + below_s) % period_s - below_s


def base_delay_s(documents: list[dict]) -> float | None:
    """What a set-up adds to delays, measured where its path has no length: mean flight of the strongest taps; None where a
    sounding has none, or no common axis of time."""
    strongest = [max(one["taps"], key=lambda tap: tap["gain_db"], default=None) for one in documents]
    flights_s = [tap["time_of_flight_s"] if tap else None for tap in strongest]
    heard_s = [flight_s for flight_s in flights_s if flight_s is not None]
    return sum(heard_s) / len(heard_s) if heard_s and len(heard_s) == len(documents) else None
