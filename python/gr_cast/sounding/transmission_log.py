# SPDX-License-Identifier: GPL-3.0-or-later
"""What a transmitter tells of itself beside the air: when it began, and every underrun with its time."""

import math
from pathlib import Path

from ..core.documents import json_file
from ..core.files import write_json

KINDS = ("underrun", "late_packet", "lost_packet")
_KEYS = {
    "cast_transmission", "waveform", "sample_rate_hz", "center_frequency_hz", "time_axis", "start_s", "samples", "restarts",
    "events",
}  # fmt: skip


def write(path: str | Path, about: dict, *, start_s: float | None, samples: int, restarts: int, events: list[dict]) -> None:
    """`about` holds what is known before: waveform, rate and carrier in Hz, the `time_axis` of all times, `utc` or `device`."""
    told = {"start_s": start_s, "samples": samples, "restarts": restarts, "events": events}
    write_json(path, {"cast_transmission": 1, **about, **told})


def events(path: str | Path, since_s: float = -math.inf) -> list[dict]:
    """The events of a log from the second `since_s` of UTC on, all of them where its times are not of UTC. Raises CastError."""
    get = json_file(path)
    document = get.keys(get.document, "", _KEYS, ("time_axis", "events"))
    get.version("cast_transmission", 1)
    is_utc = get.choice(document.get("time_axis"), "time_axis", ("utc", "device")) == "utc"
    found = []
    for index, event in enumerate(get.sequence(document.get("events"), "events")):
        place = f"events[{index}]"
        event = get.keys(event, place, {"kind", "device_time_s"}, ("kind", "device_time_s"))
        get.choice(event.get("kind"), f"{place}.kind", KINDS)
        if event.get("device_time_s") is None:
            found.append(event)
            continue
        time_s = [get.number(t, f"{place}.device_time_s", "s") for t in get.sequence(event["device_time_s"], place)]
        if not is_utc or sum(time_s) >= since_s:
            found.append(event)
    get.faults.raise_if_any()
    return found
