# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenarios as small YAML files: read strictly (unknown keys refused, all faults at once), written to be read by people."""

import math
from pathlib import Path

import numpy as np
import yaml

from ..core.errors import CastError, Faults
from ..core.files import write_text
from ..core.units import amplitude_from_db, db_from_amplitude
from .model import INTERPOLATIONS, MAX_NODES, LinkTaps, Scenario, reciprocal

VERSION = 1
KEYS = {
    "cast_scenario", "name", "description", "center_frequency_hz", "nodes", "time_s", "duration_s", "update_s",
    "interpolation", "reciprocal", "base_loss_db", "all_links", "links",
}  # fmt: skip
LINK_KEYS = {"tx", "rx", "base_loss_db", "taps"}
TAP_KEYS = {"delay_s", "gain_db", "phase_rad", "doppler_hz"}
MAX_INSTANTS = 1_000_000
UPDATE_S = 1e-3  # the hardware's own


class _StrictLoader(yaml.SafeLoader):
    """Refuses a mapping that names a key twice, which YAML would settle in silence."""

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, (list, dict)) or key in seen:
                problem = f"the key {key!r} is given twice" if isinstance(key, (str, int)) else "a key must be plain text"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


def parse_text(path: str | Path) -> dict:
    """The mapping of a YAML file; CastError for a missing file, bad text or YAML, a doubled key, or no mapping."""
    path = Path(path)
    try:
        document = yaml.load(path.read_text(encoding="utf-8"), _StrictLoader)
    except FileNotFoundError:
        raise CastError(f"{path}: no such file") from None
    except UnicodeDecodeError as error:
        raise CastError(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from None
    except yaml.YAMLError as error:
        raise CastError(f"{path}: not YAML: {' '.join(str(error).split())}") from None
    except (ValueError, RecursionError, TypeError, OverflowError, AttributeError) as error:
        raise CastError(f"{path}: not YAML that can be read: {error}") from None
    if not isinstance(document, dict):
        raise CastError(f"{path}: got {type(document).__name__}, needs a mapping")
    return document


class Reader:
    """Takes values out of a parsed mapping, noting every fault with its place."""

    def __init__(self, faults: Faults):
        self.faults = faults

    def known(self, mapping: dict, keys: set[str], place: str) -> None:
        for key in mapping:
            if key not in keys:
                self.faults.add(place, f"unknown key {key!r}, knows {', '.join(sorted(keys))}")

    def number(self, value, place: str, unit: str, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number in [low, high]; "1e9", which YAML 1.1 takes for text, is a number too."""
        try:
            number = float(value) if isinstance(value, (int, float, str)) and not isinstance(value, bool) else math.nan
        except (ValueError, OverflowError):
            number = math.nan
        if math.isfinite(number) and low <= number <= high:
            return number
        limit = "" if (low, high) == (-math.inf, math.inf) else f" in {low:g} to {high:g}"
        self.faults.add(place, f"got {_short(value)}, needs a finite number of {unit}{limit}")
        return math.nan

    def text(self, value, place: str) -> str:
        if isinstance(value, (str, int)) and not isinstance(value, bool) and str(value).strip():
            return str(value)
        self.faults.add(place, f"got {_short(value)}, needs text")
        return ""

    def sequence(self, value, place: str) -> list:
        if isinstance(value, list):
            return value
        self.faults.add(place, f"got {_short(value)}, needs a list")
        return []

    def mapping(self, value, place: str) -> dict:
        if isinstance(value, dict):
            return value
        self.faults.add(place, f"got {_short(value)}, needs a mapping")
        return {}


def _short(value) -> str:
    text = repr(value)
    return text if len(text) < 60 else text[:57] + "..."


def read(path: str | Path) -> Scenario:
    """Read a scenario; CastError names file, place, value and limit of every fault at once."""
    document = parse_text(path)
    faults = Faults(str(path))
    scenario = _scenario(document, Path(path).stem, Reader(faults), faults)
    faults.raise_if_any()
    try:
        return scenario()
    except CastError as error:
        raise CastError(*(f"{path}: {fault}" for fault in error.faults)) from None


def _scenario(document: dict, stem: str, get: Reader, faults: Faults):
    """Check the whole document; the returned call builds the scenario once there are no faults."""
    if document.get("cast_scenario") != VERSION or isinstance(document.get("cast_scenario"), bool):
        faults.add("cast_scenario", f"got {_short(document.get('cast_scenario'))}, needs {VERSION}: the version of this format")
    get.known(document, KEYS, "")
    nodes, position_m = _nodes(document.get("nodes"), get, faults)
    time_s = _clock(document, get, faults)
    interpolation = document.get("interpolation", "hold")
    if interpolation not in INTERPOLATIONS:
        faults.add("interpolation", f"got {_short(interpolation)}, needs one of {', '.join(INTERPOLATIONS)}")
    both_ways = document.get("reciprocal", True)
    if not isinstance(both_ways, bool):
        faults.add("reciprocal", f"got {_short(both_ways)}, needs true or false")
    links, losses = {}, {}
    if "all_links" in document:
        taps = _taps(get.mapping(document["all_links"], "all_links"), "all_links", time_s, get, faults, {"taps"})
        links = {(tx, rx): taps for tx in nodes for rx in nodes if tx != rx and taps}
    elif "links" not in document:
        faults.add("", "has neither all_links nor links")
    named: dict = {}
    for index, entry in enumerate(get.sequence(document.get("links", []), "links")):
        place = f"links[{index}]"
        entry = get.mapping(entry, place)
        key = tuple(get.text(entry.get(end), f"{place}.{end}") for end in ("tx", "rx"))
        for end, node in zip(("tx", "rx"), key, strict=True):
            if node and node not in nodes:
                faults.add(f"{place}.{end}", f"got {node!r}, which is not one of nodes")
        if key in named:
            faults.add(place, f"the link {key[0]}>{key[1]} is given twice")
        named[key] = _taps(entry, place, time_s, get, faults, LINK_KEYS)
        if "base_loss_db" in entry:
            losses[key] = get.number(entry["base_loss_db"], f"{place}.base_loss_db", "dB")
    if both_ways is True:
        named, losses = reciprocal(named), {(rx, tx): loss for (tx, rx), loss in losses.items()} | losses
    frequency = document.get("center_frequency_hz")
    if frequency is not None:
        frequency = get.number(frequency, "center_frequency_hz", "Hz", 1.0, 1e12)
    about = dict(
        name=get.text(document.get("name", stem), "name"),
        description=get.text(document.get("description", " - "), "description").strip(" -\n"),
        base_loss_db=get.number(document.get("base_loss_db", 0.0), "base_loss_db", "dB"),
    )
    return lambda: Scenario(
        nodes=nodes, links=links | named, time_s=time_s, center_frequency_hz=frequency, interpolation=interpolation,
        link_base_loss_db=losses, position_m=position_m, **about,
    )  # fmt: skip


def _nodes(value, get: Reader, faults: Faults):
    """Node names and positions from a count (1 to N), a list of names, or a mapping to {position_m: [x, y, z]}."""
    if isinstance(value, int) and not isinstance(value, bool):
        if 1 <= value <= MAX_NODES:
            return tuple(str(index + 1) for index in range(value)), {}
        faults.add("nodes", f"got {_short(value)}, needs 1 to {MAX_NODES}")
        return (), {}
    if isinstance(value, list):
        return tuple(get.text(node, f"nodes[{index}]") for index, node in enumerate(value)), {}
    if not isinstance(value, dict):
        faults.add("nodes", f"got {_short(value)}, needs a count, a list of names, or a mapping of names")
        return (), {}
    nodes, position_m = [], {}
    for node, about in value.items():
        place = f"nodes.{node}"
        nodes.append(get.text(node, place))
        about = get.mapping(about or {}, place)
        get.known(about, {"position_m"}, place)
        if "position_m" in about:
            numbers = get.sequence(about["position_m"], f"{place}.position_m")
            metres = [get.number(number, f"{place}.position_m", "m") for number in numbers]
            if len(metres) != 3:
                faults.add(f"{place}.position_m", f"got {len(metres)} numbers, needs x, y, z in m")
            position_m[nodes[-1]] = np.array([metres])
    return tuple(nodes), position_m


def _clock(document: dict, get: Reader, faults: Faults) -> np.ndarray:
    if "time_s" in document:
        if "duration_s" in document or "update_s" in document:
            faults.add("time_s", "is given besides duration_s or update_s, needs one or the other")
        times = get.sequence(document["time_s"], "time_s")
        clock = np.array([get.number(time, f"time_s[{index}]", "s", 0.0) for index, time in enumerate(times)])
        if clock.size == 0 or (np.isfinite(clock).all() and (clock[0] != 0 or (np.diff(clock) <= 0).any())):
            faults.add("time_s", "needs seconds that ascend from 0")
        return clock if clock.size else np.zeros(1)
    if "duration_s" not in document:
        return np.zeros(1)
    duration_s = get.number(document["duration_s"], "duration_s", "s", 0.0)
    update_s = get.number(document.get("update_s", UPDATE_S), "update_s", "s", 1e-6)
    if not duration_s / update_s < MAX_INSTANTS:
        faults.add("duration_s", f"got {duration_s:g} s in steps of {update_s:g} s, limit {MAX_INSTANTS} steps")
        return np.zeros(1)
    return np.arange(round(duration_s / update_s) + 1) * update_s


def _taps(entry: dict, place: str, time_s: np.ndarray, get: Reader, faults: Faults, keys: set[str]) -> LinkTaps | None:
    """Taps of one entry: every value one number, or a list of one number for each instant of time_s."""
    get.known(entry, keys, place)
    taps = get.sequence(entry.get("taps"), f"{place}.taps")
    if entry.get("taps") == []:
        faults.add(f"{place}.taps", "is empty: leave the link out instead")
    columns = []
    for index, tap in enumerate(taps):
        where = f"{place}.taps[{index}]"
        tap = get.mapping(tap, where)
        get.known(tap, TAP_KEYS, where)
        for key in ("delay_s", "gain_db"):
            if key not in tap:
                faults.add(where, f"{key} is missing")
        series = {
            key: _series(tap.get(key, 0.0), f"{where}.{key}", unit, time_s, get, faults)
            for key, unit in (("delay_s", "s"), ("gain_db", "dB"), ("phase_rad", "rad"), ("doppler_hz", "Hz"))
        }
        columns.append(_tap(series, where, time_s, faults))
    instants = max((column[0].size for column in columns), default=1)
    if not columns or any(not np.isfinite(value).all() for column in columns for value in column):
        return None
    wide = [[np.broadcast_to(value, instants) for value in column] for column in columns]
    return LinkTaps(
        delay_s=np.stack([column[0] for column in wide], axis=1), gain=np.stack([column[1] for column in wide], axis=1)
    )


def _series(value, place: str, unit: str, time_s: np.ndarray, get: Reader, faults: Faults) -> np.ndarray:
    if not isinstance(value, list):
        return np.array([_gain_or_number(value, place, unit, get)])
    if len(value) != time_s.size:
        faults.add(place, f"got {len(value)} values, time_s has {time_s.size}")
    return np.array([_gain_or_number(one, f"{place}[{index}]", unit, get) for index, one in enumerate(value)] or [math.nan])


def _gain_or_number(value, place: str, unit: str, get: Reader) -> float:
    # YAML's own -.inf: a tap that is absent at that instant.
    if unit == "dB" and value == -math.inf:
        return -math.inf
    return get.number(value, place, unit, -1e4, 1e4) if unit == "dB" else get.number(value, place, unit)


def _tap(series: dict, place: str, time_s: np.ndarray, faults: Faults) -> tuple[np.ndarray, np.ndarray]:
    doppler_hz = series["doppler_hz"]
    delay_s, gain_db, phase_rad = series["delay_s"], series["gain_db"], series["phase_rad"]
    if not all(value.size in (1, time_s.size) for value in series.values()) or doppler_hz.size != 1:
        if doppler_hz.size != 1:
            faults.add(f"{place}.doppler_hz", "needs one number: a Doppler that changes is a phase_rad over time")
        return np.array([math.nan]), np.array([math.nan])
    if doppler_hz[0]:
        if time_s.size == 1:
            faults.add(f"{place}.doppler_hz", "turns over time: the file needs duration_s or time_s")
        elif not abs(doppler_hz[0]) <= 0.5 / np.max(np.diff(time_s)):
            limit = 0.5 / np.max(np.diff(time_s))
            faults.add(f"{place}.doppler_hz", f"got {doppler_hz[0]:g} Hz, limit +-{limit:g} Hz at these updates")
        phase_rad = phase_rad + 2 * np.pi * doppler_hz * time_s
    with np.errstate(all="ignore"):
        gain = amplitude_from_db(gain_db) * np.exp(1j * phase_rad)
    delay_s, gain = np.broadcast_arrays(delay_s, gain)
    return delay_s, gain


def write(path: str | Path, scenario: Scenario) -> None:
    """Write a scenario so that `read` gives the same one back; whole or not at all."""
    write_text(path, to_text(scenario))


def to_text(scenario: Scenario) -> str:
    head: dict = {"cast_scenario": VERSION, "name": scenario.name}
    if scenario.description:
        head["description"] = scenario.description
    if scenario.center_frequency_hz is not None:
        head["center_frequency_hz"] = scenario.center_frequency_hz
    if scenario.time_s.size > 1:
        head["time_s"] = scenario.time_s.tolist()
    head |= {"interpolation": scenario.interpolation, "reciprocal": False, "base_loss_db": scenario.base_loss_db}
    head["nodes"] = {
        node: {"position_m": scenario.position_m[node][0].tolist()} if node in scenario.position_m else {}
        for node in scenario.nodes
    }
    head["links"] = [_link_entry(scenario, key) for key in sorted(scenario.links)]
    return yaml.dump(head, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110)


class _Dumper(yaml.SafeDumper):
    """Writes every entry in full: anchors are hard to read and easy to edit wrongly."""

    def ignore_aliases(self, data):
        return True


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
