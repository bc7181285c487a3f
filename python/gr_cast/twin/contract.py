# SPDX-License-Identifier: GPL-3.0-or-later
"""What an entry of a twin's `effects` must be, as the contract and its family have it. All faults go to the reader's."""

import math
from dataclasses import dataclass

from ..core.documents import Reader, listed, short
from .effects import FAMILIES, NAMED, Value

KEYS = {"family", "owner", "where", "parameters", "evidence", "confidence", "sentence", "model"}
MEASURED = ("gain_db", "noise_power_db")  # of the model of every family: what a diagnosis measured, by recording
LONGEST_DELAY = 1 << 25  # samples by which a signal may be late: two paths so far apart take half a gigabyte
MOST_DB = 400.0  # up or down: beyond all receivers, and still a number once it is squared
LONGEST_LIST = 1 << 16  # numbers of a model


@dataclass(frozen=True, kw_only=True)
class Known:
    """What entries may name, and the sample rate that limits their numbers."""

    nodes: tuple[str, ...]
    links: tuple[tuple[str, str], ...]
    waveforms: tuple[str, ...]
    rate_hz: float


def check_effects(get: Reader, entries: list, known: Known) -> tuple[dict, ...]:
    """The entries of `effects`."""
    checked = []
    for index, entry in enumerate(entries):
        place = f"effects[{index}]"
        entry = get.keys(entry, place, KEYS, ("family", "owner", "parameters"))
        name = get.choice(entry["family"], f"{place}.family", NAMED) if "family" in entry else None
        if name is None or name != entry["family"] or not {"owner", "parameters"} <= {*entry}:
            continue
        family = FAMILIES[name]
        _owner(get, entry["owner"], f"{place}.owner", family, known)
        before = len(get.faults)
        parameters = _parameters(get, entry["parameters"], f"{place}.parameters", family, known)
        model = _model(get, entry.get("model"), f"{place}.model", family, known)
        if len(get.faults) == before and (wrong := family.contradiction(parameters, model)):
            get.faults.add(place, wrong)
        checked.append(entry)
    return tuple(checked)


def _owner(get: Reader, owner, place: str, family, known: Known) -> None:
    owner = get.keys(owner, place, {"level", "name", "alternatives"}, ("level", "name"))
    level = get.choice(owner.get("level"), f"{place}.level", family.owners) if "level" in owner else None
    names = {"link": [f"{tx}>{rx}" for tx, rx in known.links], "environment": ["environment"]}.get(level, [*known.nodes])
    if level == owner.get("level") and "name" in owner and (not isinstance(owner["name"], str) or owner["name"] not in names):
        get.faults.add(f"{place}.name", f"got {short(owner['name'])}, needs one of {listed(names)}")


def _parameters(get: Reader, entries, place: str, family, known: Known) -> dict:
    """The values that a family's parameters have, one each; one that differs by recording has that of the first."""
    entries = get.keys(entries, place, {*family.parameters})
    if family.parameters and not entries:
        get.faults.add(place, f"is empty, needs some of {', '.join(family.parameters)}")
    found = {}
    for name, value in family.parameters.items():
        where = f"{place}.{name}"
        if name in entries:
            values = _values(get, entries[name], where)
            found[name] = [_one(get, one, at, name, value, known) for at, one in values][0] if values else math.nan
        elif value.needed:
            get.faults.add(where, "is missing")
    return found


def _values(get: Reader, entry, place: str) -> list[tuple[str, object]]:
    """(place, value) of a parameter: a plain value, {value, std}, or {per_recording: {NAME: {value, std}}}."""
    if not isinstance(entry, dict):
        return [(place, entry)]
    if "per_recording" in entry:
        entry = get.keys(entry, place, {"per_recording"})
        every = get.mapping(entry["per_recording"], f"{place}.per_recording")
        if not every:
            get.faults.add(f"{place}.per_recording", "is empty, needs {value, std} of each recording")
        return [pair for name, one in every.items() for pair in _with_std(get, one, f"{place}.per_recording.{name}")]
    return _with_std(get, entry, place)


def _with_std(get: Reader, entry, place: str) -> list[tuple[str, object]]:
    entry = get.keys(entry, place, {"value", "std"}, ("value",))
    if entry.get("std") is not None:  # null: nobody knows
        get.number(entry["std"], f"{place}.std", low=0.0)
    return [(f"{place}.value", entry["value"])] if "value" in entry else []


def _model(get: Reader, model, place: str, family, known: Known) -> dict:
    model = get.keys({} if model is None else model, place, {*family.remembered, *MEASURED})
    for key in MEASURED:
        for name, value in get.mapping(model.get(key, {}), f"{place}.{key}").items():
            get.number(value, f"{place}.{key}.{name}", *limits(key, Value(), known))
    found = {}
    for name, value in family.remembered.items():
        where = f"{place}.{name}"
        if name not in model:
            if value.needed:
                get.faults.add(where, "is missing")
        elif value.many:
            entries = get.sequence(model[name], where)
            if len(entries) > LONGEST_LIST:
                get.faults.add(where, f"got {len(entries)} numbers, limit {LONGEST_LIST}")
            found[name] = [_one(get, one, f"{where}[{k}]", name, value, known) for k, one in enumerate(entries[:LONGEST_LIST])]
        else:
            found[name] = _one(get, model[name], where, name, value, known)
    return found


def _one(get: Reader, entry, place: str, name: str, value: Value, known: Known):
    if value.words:
        return get.choice(entry, place, value.words)
    if value.kind is bool:
        return get.truth(entry, place)
    if value.kind is str:
        return get.choice(entry, place, known.waveforms) if known.waveforms else get.text(entry, place)
    unit, low, high = limits(name, value, known)
    return get.whole(entry, place, unit, int(low), int(high)) if value.whole else get.number(entry, place, unit, low, high)


def limits(name: str, value: Value, known: Known) -> tuple[str, float, float]:
    """(unit, smallest, largest) of a number: what its own value says, within what its unit can mean at this sample rate."""
    late_s = LONGEST_DELAY / known.rate_hz
    unit, most = next(
        (
            (unit, most)
            for ends, unit, most in (
                (("delay_s", "error_s"), "s", late_s),
                (("_db", "_dbc"), "dB", MOST_DB),
                (("_hz_per_s",), "Hz/s", 1e12),
                (("_hz",), "Hz", 2 * known.rate_hz),
                (("_s",), "s", 1e9),
                (("_rad",), "rad", 1e6),
                (("_ppm",), "ppm", 1e5),
            )
            if name.endswith(ends)
        ),
        ("", 1e12),
    )
    return unit, max(value.low, -most), min(value.high, most)
