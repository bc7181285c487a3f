# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects of a place: how a world may differ from the twin of it, whose that is, and its numbers. Read strictly."""

from dataclasses import dataclass, field

from ...core.documents import Reader, listed, short
from ..model import link_name
from .nodes import ANTENNAS

KEYS = ("family", "owner", "where", "parameters", "evidence", "confidence", "sentence", "model")
LEVELS = ("place", "object", "material", "node", "link")


@dataclass(frozen=True, kw_only=True)
class Number:
    """A parameter: its unit, least and most, and how many numbers it is."""

    unit: str = ""
    low: float = -1e6
    high: float = 1e6
    many: int = 1
    whole: bool = False


@dataclass(frozen=True, kw_only=True)
class Family:
    """Whose an effect may be, and its parameters: numbers, or one of some words."""

    levels: tuple[str, ...]
    parameters: dict[str, Number | tuple[str, ...]] = field(default_factory=dict)


_DB = Number(unit="dB", low=-400, high=400)
_POINT = Number(unit="m", low=-1e5, high=1e5, many=3)
_NORMAL = Number(low=-1, high=1, many=3)
_ANGLE = Number(unit="rad", low=-10, high=10)
_PERMITTIVITY = Number(low=1, high=1e3)
_HEIGHT = Number(unit="m", low=0, high=1)
_ORDER = Number(unit="reflections", low=0, high=10, whole=True)
_LEVEL = Number(unit="m", low=-1e5, high=1e5)
_THINGS = ("object", "material")
FAMILIES = {
    "missing_object": Family(levels=("place",), parameters={"point_m": _POINT, "normal": _NORMAL, "reflection_db": _DB}),
    "extra_object": Family(levels=("object",)),
    "object_moved": Family(levels=("object",), parameters={"offset_m": Number(unit="m"), "normal": _NORMAL}),
    "material": Family(
        levels=_THINGS,
        parameters={
            "reflection_error_db": _DB,
            "permittivity": _PERMITTIVITY,
            "conductivity": Number(unit="S/m", low=0, high=1e9),
            "nearest": (),
        },
    ),
    "roughness": Family(levels=_THINGS, parameters={"height_rms_m": _HEIGHT}),
    "missing_reflections": Family(levels=("place",), parameters={"order": _ORDER}),
    "missing_transmission": Family(levels=("object", "place"), parameters={"loss_db": _DB}),
    "missing_diffraction": Family(levels=("place", "object"), parameters={"gain_db": _DB}),
    "missing_scattering": Family(
        levels=("material", "object", "place"), parameters={"scattering_coefficient": Number(low=0, high=1)}
    ),
    "moving_scatterer": Family(
        levels=("place",), parameters={"position_m": _POINT, "velocity_m_per_s": Number(unit="m/s", low=-1e4, high=1e4, many=3)}
    ),
    "node_position": Family(levels=("node",), parameters={"offset_m": _POINT}),
    "track_timing": Family(
        levels=("node",), parameters={"speed_factor": Number(low=1e-3, high=1e3), "time_offset_s": Number(unit="s")}
    ),
    "antenna_orientation": Family(levels=("node",), parameters={"yaw_rad": _ANGLE, "pitch_rad": _ANGLE}),
    "antenna_pattern": Family(levels=("node",), parameters={"pattern": ANTENNAS}),
    "node_gain": Family(levels=("node", "link"), parameters={"error_db": _DB}),
    "node_delay": Family(levels=("node", "link"), parameters={"error_s": Number(unit="s", low=-1e-3, high=1e-3)}),
    "carrier": Family(levels=("place",), parameters={"carrier_hz": Number(unit="Hz", low=1e8, high=1e11)}),
    "ground": Family(levels=("place",), parameters={"height_m": _LEVEL, "permittivity": _PERMITTIVITY}),
    "small_scale": Family(levels=("link",), parameters={"k_factor_db": _DB, "coherence_m": Number(unit="m", low=0, high=1e5)}),
    "meter_limits": Family(levels=("node",), parameters={"level_db": _DB, "step_db": Number(unit="dB", low=0, high=400)}),
    "excess_loss": Family(
        levels=("place", "node", "link"),
        parameters={
            "loss_db": _DB,
            "db_per_m": Number(unit="dB/m", low=-100, high=100),
            "exponent": Number(low=0, high=20),
            "distance": ("link", "path"),
            "azimuth_rad": _ANGLE,
            "width_rad": _ANGLE,
        },
    ),
}  # fmt: skip


def read(get: Reader, entries, nodes: list[str]) -> tuple[dict, ...]:
    """The entries of `effects`: mappings of a family, its owner, and its parameters as plain values; without a fault."""
    found = []
    for index, entry in enumerate(get.sequence(entries, "effects")):
        place, before = f"effects[{index}]", len(get.faults)
        entry = get.keys(entry, place, KEYS, ("family", "owner", "parameters"))
        name = get.choice(entry["family"], f"{place}.family", FAMILIES) if "family" in entry else None
        if name is None or name != entry["family"] or not {"owner", "parameters"} <= {*entry}:
            continue
        owner = _owner(get, entry["owner"], f"{place}.owner", FAMILIES[name], nodes)
        parameters = _parameters(get, entry["parameters"], f"{place}.parameters", FAMILIES[name])
        if len(get.faults) == before:
            found.append({"family": name, "owner": owner, "parameters": parameters})
    return tuple(found)


def _owner(get: Reader, owner, place: str, family: Family, nodes: list[str]) -> dict:
    owner = get.keys(owner, place, ("level", "name", "alternatives"), ("level", "name"))
    level = get.choice(owner["level"], f"{place}.level", family.levels) if "level" in owner else ""
    name = get.text(owner["name"], f"{place}.name") if "name" in owner else ""
    links = [link_name((a, b)) for a in nodes for b in nodes if a != b] if level == "link" else []
    known = {"place": ["place"], "node": nodes, "link": links}.get(level)
    if level and level == owner["level"] and name and known is not None and name not in known:
        get.faults.add(f"{place}.name", f"got {short(name)}, needs one of {listed(known)}")
    return {"level": level, "name": name}


def _parameters(get: Reader, entries, place: str, family: Family) -> dict:
    """Plain values; one may be given as {value, std}."""
    found = {}
    for name, entry in get.keys(entries, place, family.parameters).items():
        if name not in family.parameters:
            continue
        where = f"{place}.{name}"
        if isinstance(entry, dict):
            entry = get.keys(entry, where, ("value", "std"), ("value",)).get("value")
            where += ".value"
        found[name] = _value(get, entry, where, family.parameters[name])
    return found


def _value(get: Reader, entry, place: str, kind: Number | tuple[str, ...]):
    if isinstance(kind, tuple):
        return get.choice(entry, place, kind) if kind else get.text(entry, place)
    limits = (kind.unit, kind.low, kind.high)
    if kind.whole:
        return get.whole(entry, place, *limits)
    if kind.many == 1:
        return get.number(entry, place, *limits)
    numbers = [get.number(one, place, *limits) for one in get.sequence(entry, place)]
    if len(numbers) != kind.many:
        get.faults.add(place, f"got {len(numbers)} numbers, needs {kind.many}")
    return tuple(numbers)
