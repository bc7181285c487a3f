# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenarios as small YAML files: read strictly (unknown keys refused, all faults at once), written to be read by people."""

import math
from pathlib import Path

import numpy as np

from ..core.documents import MAX_VALUES, Reader, short, yaml_file, yaml_text
from ..core.errors import CastError
from ..core.files import write_text
from ..core.frequencies import LEAST_CARRIER_HZ, LEAST_RATE_HZ, written
from ..core.units import amplitude_from_db, db_from_amplitude
from .model import INTERPOLATIONS, MAX_NODES, MOST_GAIN_DB, LinkTaps, Scenario, reciprocal, taps_off_grid

VERSION = 1
KEYS = {
    "cast_scenario", "name", "description", "center_frequency_hz", "bandwidth_hz", "nodes", "time_s", "duration_s",
    "update_s", "interpolation", "reciprocal", "base_loss_db", "all_links", "links",
}  # fmt: skip
LINK_KEYS = {"tx", "rx", "base_loss_db", "taps"}
TAP_KEYS = {"delay_s", "gain_db", "phase_rad", "doppler_hz"}
FREQUENCIES = {"center_frequency_hz": (LEAST_CARRIER_HZ, "a carrier"), "bandwidth_hz": (LEAST_RATE_HZ, "a band")}
MAX_INSTANTS = 1_000_000
MAX_TAPS = 25_000_000  # of all links at all instants together: 0.6 GB
UPDATE_S = 1e-3  # the hardware's own


def read(path: str | Path) -> Scenario:
    """Read a scenario; CastError names file, place, value and limit of every fault at once."""
    get = yaml_file(path)
    scenario = _scenario(get, Path(path).stem)
    get.faults.raise_if_any()
    try:
        return scenario()
    except CastError as error:
        raise CastError(*(f"{path}: {fault}" for fault in error.faults)) from None


def _scenario(get: Reader, stem: str):
    """Check the whole document; the returned call builds the scenario once there are no faults."""
    document = get.document
    get.version("cast_scenario", VERSION)
    get.keys(document, "", KEYS)
    nodes, position_m = _nodes(document.get("nodes"), get)
    time_s = _clock(document, get)
    interpolation = get.choice(document.get("interpolation", "hold"), "interpolation", INTERPOLATIONS)
    both_ways = get.truth(document.get("reciprocal", True), "reciprocal")
    links, losses = {}, {}
    entries = get.sequence(document.get("links", []), "links")
    _limit_taps([document.get("all_links"), *entries], time_s.size, get)
    if "all_links" in document:
        taps = _taps(get.mapping(document["all_links"], "all_links"), "all_links", time_s, get, {"taps"})
        links = {(tx, rx): taps for tx in nodes for rx in nodes if tx != rx and taps}
    elif "links" not in document:
        get.faults.add("", "has neither all_links nor links")
    named: dict = {}
    for index, entry in enumerate(entries):
        place = f"links[{index}]"
        entry = get.mapping(entry, place)
        key = tuple(get.text(entry.get(end), f"{place}.{end}") for end in ("tx", "rx"))
        for end, node in zip(("tx", "rx"), key, strict=True):
            if node and node not in nodes:
                get.faults.add(f"{place}.{end}", f"got {node!r}, which is not one of nodes")
        if key in named:
            get.faults.add(place, f"the link {key[0]}>{key[1]} is given twice")
        named[key] = _taps(entry, place, time_s, get, LINK_KEYS)
        if "base_loss_db" in entry:
            losses[key] = get.number(entry["base_loss_db"], f"{place}.base_loss_db", "dB")
    if both_ways:
        named, losses = reciprocal(named), {(rx, tx): loss for (tx, rx), loss in losses.items()} | losses
    about = {
        place: get.hertz(document[place], place, *FREQUENCIES[place], 1e12) for place in FREQUENCIES if place in document
    } | dict(
        name=get.text(document.get("name", stem), "name"),
        description=get.text(document.get("description", " - "), "description").strip(" -\n"),
        base_loss_db=get.number(document.get("base_loss_db", 0.0), "base_loss_db", "dB"),
    )
    return lambda: Scenario(
        nodes=nodes, links=links | named, time_s=time_s, interpolation=interpolation,
        link_base_loss_db=losses, position_m=position_m, **about,
    )  # fmt: skip


def _nodes(value, get: Reader):
    """Node names and positions from a count (1 to N), a list of names, or a mapping to {position_m: [x, y, z]}."""
    if isinstance(value, int) and not isinstance(value, bool):
        if 1 <= value <= MAX_NODES:
            return tuple(str(index + 1) for index in range(value)), {}
        get.faults.add("nodes", f"got {short(value)}, needs 1 to {MAX_NODES}")
        return (), {}
    if not isinstance(value, (list, dict)):
        get.faults.add("nodes", f"got {short(value)}, needs a count, a list of names, or a mapping of names")
        return (), {}
    if len(value) > MAX_NODES:
        get.faults.add("nodes", f"got {len(value)}, limit {MAX_NODES}")
        return (), {}
    if isinstance(value, list):
        return tuple(get.name(node, f"nodes[{index}]") for index, node in enumerate(value)), {}
    nodes, position_m = [], {}
    for node, about in value.items():
        place = f"nodes.{node}"
        nodes.append(get.name(node, place))
        about = get.keys({} if about is None else about, place, {"position_m"})
        if "position_m" in about:
            numbers = get.sequence(about["position_m"], f"{place}.position_m")[:4]
            metres = [get.number(number, f"{place}.position_m", "m") for number in numbers]
            if len(metres) != 3:
                get.faults.add(f"{place}.position_m", "needs three numbers: x, y, z in m")
            position_m[nodes[-1]] = np.array([metres])
    return tuple(nodes), position_m


def _limit_taps(entries: list, instants: int, get: Reader) -> None:
    """Refuses at once, before any is built, more taps than fit into the memory: one that moves makes its link one per instant."""
    count = 0
    for entry in entries:
        taps = entry.get("taps") if isinstance(entry, dict) else None
        taps = [tap for tap in taps if isinstance(tap, dict)] if isinstance(taps, list) else []
        moves = any(tap.get("doppler_hz") or any(isinstance(value, list) for value in tap.values()) for tap in taps)
        count += len(taps) * (instants if moves else 1)
    if count > MAX_TAPS:
        get.faults.add("links", f"got {count} taps over all links and instants, limit {MAX_TAPS}")
        get.faults.raise_if_any()


def _clock(document: dict, get: Reader) -> np.ndarray:
    if "time_s" in document:
        if "duration_s" in document or "update_s" in document:
            get.faults.add("time_s", "is given besides duration_s or update_s, needs one or the other")
        times = get.sequence(document["time_s"], "time_s")
        clock = np.array([get.number(time, f"time_s[{index}]", "s", 0.0) for index, time in enumerate(times)])
        if clock.size == 0 or (np.isfinite(clock).all() and (clock[0] != 0 or (np.diff(clock) <= 0).any())):
            get.faults.add("time_s", "needs seconds that ascend from 0")
        return clock if clock.size else np.zeros(1)
    if "duration_s" not in document:
        return np.zeros(1)
    duration_s = get.number(document["duration_s"], "duration_s", "s", 0.0)
    update_s = get.number(document.get("update_s", UPDATE_S), "update_s", "s", 1e-6)
    steps = duration_s / update_s
    if steps < MAX_INSTANTS:
        return np.arange(round(steps) + 1) * update_s
    if steps >= MAX_INSTANTS:  # not NaN, which is a fault by now
        get.faults.add("duration_s", f"got {duration_s:g} s in steps of {update_s:g} s, limit {MAX_INSTANTS} steps")
    return np.zeros(1)


def _taps(entry: dict, place: str, time_s: np.ndarray, get: Reader, keys: set[str]) -> LinkTaps | None:
    """Taps of one entry: every value one number, or a list of one number for each instant of time_s."""
    get.keys(entry, place, keys)
    taps = get.sequence(entry.get("taps"), f"{place}.taps")
    if entry.get("taps") == []:
        get.faults.add(f"{place}.taps", "is empty: leave the link out instead")
    columns = []
    for index, tap in enumerate(taps):
        where = f"{place}.taps[{index}]"
        tap = get.mapping(tap, where)
        get.keys(tap, where, TAP_KEYS, ("delay_s", "gain_db"))
        series = {
            key: _series(tap.get(key, 0.0), f"{where}.{key}", unit, time_s, get)
            for key, unit in (("delay_s", "s"), ("gain_db", "dB"), ("phase_rad", "rad"), ("doppler_hz", "Hz"))
        }
        column = _tap(series, where, time_s, get)
        columns.append(column)
        if all(np.isfinite(value).all() for value in column):  # told where they stand, beside all else that is wrong
            for _, line in taps_off_grid(LinkTaps(delay_s=column[0][:, None], gain=column[1][:, None])):
                link = f"link {entry['tx']}>{entry['rx']}: tap {index + 1}: " if {"tx", "rx"} <= {*entry} else ""
                get.faults.add(where, link + line)
    instants = max((column[0].size for column in columns), default=1)
    if not columns or any(not np.isfinite(value).all() for column in columns for value in column):
        return None
    wide = [[np.broadcast_to(value, instants) for value in column] for column in columns]
    return LinkTaps(
        delay_s=np.stack([column[0] for column in wide], axis=1), gain=np.stack([column[1] for column in wide], axis=1)
    )


def _series(value, place: str, unit: str, time_s: np.ndarray, get: Reader) -> np.ndarray:
    if not isinstance(value, list):
        return np.array([_gain_or_number(value, place, unit, get)])
    if len(value) != time_s.size:
        get.faults.add(place, f"got {len(value)} values, time_s has {time_s.size}")
    return np.array([_gain_or_number(one, f"{place}[{index}]", unit, get) for index, one in enumerate(value)] or [math.nan])


def _gain_or_number(value, place: str, unit: str, get: Reader) -> float:
    # YAML's own -.inf: a tap that is absent at that instant.
    if unit == "dB" and value == -math.inf:
        return -math.inf
    return get.number(value, place, unit, -1e4, MOST_GAIN_DB) if unit == "dB" else get.number(value, place, unit)


def _tap(series: dict, place: str, time_s: np.ndarray, get: Reader) -> tuple[np.ndarray, np.ndarray]:
    doppler_hz = series["doppler_hz"]
    delay_s, gain_db, phase_rad = series["delay_s"], series["gain_db"], series["phase_rad"]
    if not all(value.size in (1, time_s.size) for value in series.values()) or doppler_hz.size != 1:
        if doppler_hz.size != 1:
            get.faults.add(f"{place}.doppler_hz", "needs one number: a Doppler that changes is a phase_rad over time")
        return np.array([math.nan]), np.array([math.nan])
    if doppler_hz[0]:
        if time_s.size == 1:
            get.faults.add(f"{place}.doppler_hz", "turns over time: the file needs duration_s or time_s")
        elif not abs(doppler_hz[0]) <= 0.5 / np.max(np.diff(time_s)):
            limit = 0.5 / np.max(np.diff(time_s))
            get.faults.add(f"{place}.doppler_hz", f"got {doppler_hz[0]:g} Hz, limit +-{limit:g} Hz at these updates")
        phase_rad = phase_rad + 2 * np.pi * doppler_hz * time_s
    with np.errstate(all="ignore"):
        gain = amplitude_from_db(gain_db) * np.exp(1j * phase_rad)
    delay_s, gain = np.broadcast_arrays(delay_s, gain)
    return delay_s, gain


def write(path: str | Path, scenario: Scenario) -> None:
    """Write a scenario so that `read` gives the same one back; whole or not at all. CastError where it is too large for that."""
    values = sum(3 * taps.gain.size for taps in scenario.links.values()) + scenario.time_s.size
    if values > MAX_VALUES // 2:  # names and keys come on top
        raise CastError(f"{path}: got {values} numbers, limit {MAX_VALUES // 2} in YAML: write it as .zarr")
    write_text(path, to_text(scenario))


def to_text(scenario: Scenario) -> str:
    head: dict = {"cast_scenario": VERSION, "name": scenario.name}
    if scenario.description:
        head["description"] = scenario.description
    for place, (least_hz, _) in FREQUENCIES.items():
        if (value_hz := getattr(scenario, place)) is not None:
            head[place] = written(value_hz, least_hz)
    if scenario.time_s.size > 1:
        head["time_s"] = scenario.time_s.tolist()
    head |= {"interpolation": scenario.interpolation, "reciprocal": False, "base_loss_db": scenario.base_loss_db}
    head["nodes"] = {
        node: {"position_m": scenario.position_m[node][0].tolist()} if node in scenario.position_m else {}
        for node in scenario.nodes
    }
    head["links"] = [_link_entry(scenario, key) for key in sorted(scenario.links)]
    return yaml_text(head, width=110)


def _link_entry(scenario: Scenario, key: tuple[str, str]) -> dict:
    entry: dict = {"tx": key[0], "rx": key[1]}
    if key in scenario.link_base_loss_db:
        entry["base_loss_db"] = scenario.link_base_loss_db[key]
    taps = scenario.links[key]
    entry["taps"] = [
        {
            "delay_s": _plain(taps.delay_s[:, index]),
            "gain_db": _plain(db_from_amplitude(taps.gain[:, index])),
            "phase_rad": _plain(np.angle(taps.gain[:, index])),
        }
        for index in range(taps.gain.shape[1])
    ]
    return entry


def _plain(values: np.ndarray):
    """One number where nothing changes, else a list."""
    return float(values[0]) if (values == values[0]).all() else values.tolist()
