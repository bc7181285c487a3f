# SPDX-License-Identifier: GPL-3.0-or-later
"""The SPEC of a scenario to create: one YAML file, read strictly."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...core.documents import Reader, yaml_file
from ...core.errors import CastError
from ...core.files import is_file
from ..model import MAX_NODES
from . import families, materials, osm
from .media import Medium
from .nodes import Node

LONGEST_ID = 64  # characters
VERSION = 1
SWITCHES = ("refraction", "diffraction", "scattering")  # mechanisms beyond reflection, off unless asked for
METHODS = ("least_squares", "kmeans")
_KEYS = {
    "cast_create", "id", "name", "description", "environment", "model", "materials", "nodes", "node_grids", "sampling",
    "approximation", "effects",
}  # fmt: skip
_PLACES = ("position_m", "waypoints_m", "position_deg", "waypoints_deg")
_NODE_KEYS = {*_PLACES, "speed_m_per_s", "antenna", "orientation_rad", "power_dbm", "noise_figure_db"}
_GRID_KEYS = {"prefix", "origin_m", "count", "spacing_m", "antenna", "orientation_rad", "power_dbm", "noise_figure_db"}
_MODEL_KEYS = {"mesh", "osm", "default_height_m", "level_height_m"}


@dataclass(frozen=True, kw_only=True)
class Spec:
    """What to create. Paths are absolute; `sections` holds each step's own part of the file, for its fingerprint."""

    id: str
    name: str
    description: str
    carrier_hz: float
    bandwidth_hz: float
    model_path: Path
    materials: dict[str, Medium]
    nodes: tuple[Node, ...]
    place: str = ""
    area_m: tuple[float, float, float, float] | None = None
    default_height_m: float = 9.0
    level_height_m: float = 3.0
    duration_s: float = 1.0
    step_s: float = 0.03
    max_depth: int = 3
    rays: int = 50_000
    refraction: bool = False
    diffraction: bool = False
    scattering: bool = False
    check_instants: int = 6
    method: str = "least_squares"
    update_s: float = 1e-3
    hold_s: float = 1.0
    dynamic_range_db: float = 43.0
    effects: tuple[dict, ...] = ()
    sections: dict = field(default_factory=dict)


def read(path: str | Path) -> Spec:
    """Read a SPEC; CastError names file, place, value and limit of every fault at once."""
    path = Path(path)
    get = yaml_file(path)
    document, faults = get.document, get.faults
    get.keys(document, "", _KEYS)
    get.version("cast_create", VERSION)
    name = get.text(document.get("id", path.stem), "id")
    if name and not re.fullmatch(rf"[A-Za-z0-9_-]{{1,{LONGEST_ID}}}", name):
        faults.add("id", f"got {name!r}, needs letters, digits, _ and - (at most {LONGEST_ID})")
    values = _environment(document, get) | _model(document, get, path) | _sampling(document, get) | _approximation(document, get)
    rules = materials.read_rules(get, document.get("materials"))
    nodes = _nodes(document, get, values["model_path"])
    if len({node.name for node in nodes}) != len(nodes):
        faults.add("nodes", "the same node is named twice")
    if len(nodes) < 2 and not faults:
        faults.add("nodes", f"got {len(nodes)}, needs at least 2")
    found = families.read(get, document.get("effects", []), [node.name for node in nodes])
    title = get.text(document.get("name", name), "name")
    description = str(document.get("description", "")).strip()
    faults.raise_if_any()
    sections = {key: document.get(key) for key in _KEYS}
    return Spec(
        id=name, name=title, description=description, materials=rules, nodes=tuple(nodes), effects=found,
        sections=sections, **values
    )  # fmt: skip


def _section(document: dict, get: Reader, name: str, keys: set[str]) -> dict:
    return get.keys(document.get(name, {}), name, keys)


def _environment(document: dict, get: Reader) -> dict:
    section = _section(document, get, "environment", {"place", "carrier_hz", "bandwidth_hz", "area_m"})
    out = {
        "place": str(section.get("place", "")),
        "carrier_hz": get.number(section.get("carrier_hz"), "environment.carrier_hz", "Hz", 1e8, 1e11),
        "bandwidth_hz": get.number(section.get("bandwidth_hz"), "environment.bandwidth_hz", "Hz", 1e4, 1e9),
    }
    if "area_m" in section:
        area = _numbers(section["area_m"], "environment.area_m", 4, get)
        if not (area[0] < area[2] and area[1] < area[3]):
            get.faults.add("environment.area_m", "is empty: needs west < east and south < north")
        out["area_m"] = tuple(area)
    return out


def _model(document: dict, get: Reader, path: Path) -> dict:
    section = _section(document, get, "model", _MODEL_KEYS)
    files = [key for key in ("mesh", "osm") if key in section]
    if len(files) != 1:
        get.faults.add("model", f"got {' and '.join(files) or 'neither mesh nor osm'}, needs one of them")
        return {"model_path": path}
    file = path.parent / get.text(section[files[0]], f"model.{files[0]}")
    if not is_file(file):
        get.faults.add(f"model.{files[0]}", f"{file}: no such file")
    if (file.suffix.lower() == ".osm") != (files[0] == "osm"):
        get.faults.add(f"model.{files[0]}", f"{file.name}: an OpenStreetMap extract is an .osm file and goes under osm")
    out = {"model_path": file.resolve()}
    for key in ("default_height_m", "level_height_m"):
        if key in section:
            out[key] = get.number(section[key], f"model.{key}", "m", 0.1, 1000)
    return out


def _sampling(document: dict, get: Reader) -> dict:
    keys = {"duration_s", "step_s", "max_depth", "rays", *SWITCHES, "check_instants"}
    section, where = _section(document, get, "sampling", keys), "sampling."
    out = {}
    for key, unit, low, high in (("duration_s", "s", 1e-3, 3600), ("step_s", "s", 1e-3, 60)):
        if key in section:
            out[key] = get.number(section[key], where + key, unit, low, high)
    for key, low, high in (("max_depth", 0, 10), ("rays", 1000, 10**8), ("check_instants", 0, 1000)):
        if key in section:
            out[key] = get.whole(section[key], where + key, "steps", low, high)
    for key in SWITCHES:
        if key in section:
            out[key] = get.truth(section[key], where + key)
    return out


def _approximation(document: dict, get: Reader) -> dict:
    section = _section(document, get, "approximation", {"method", "update_s", "hold_s", "dynamic_range_db"})
    out = {}
    if "method" in section:
        out["method"] = get.choice(section["method"], "approximation.method", METHODS)
    for key, unit, low, high in (
        ("update_s", "s", 1e-3, 1.0),
        ("hold_s", "s", 1e-3, 3600),
        ("dynamic_range_db", "dB", 1, 200),
    ):
        if key in section:
            out[key] = get.number(section[key], f"approximation.{key}", unit, low, high)
    return out


def _numbers(value, place: str, count: int, get: Reader, unit: str = "m") -> list[float]:
    numbers = [get.number(number, place, unit) for number in get.sequence(value, place)]
    if len(numbers) != count:
        get.faults.add(place, f"got {len(numbers)} numbers, needs {count}")
        return [float("nan")] * count
    return numbers


def _in_metres(points: list, place: str, model_path: Path, get: Reader) -> list:
    """[latitude, longitude, height in m] of each point as metres on the axes of the OpenStreetMap extract."""
    if model_path.suffix.lower() != ".osm":
        get.faults.add(place, "degrees go with model.osm, a mesh does not say where on Earth it is")
        return points
    if not (np.abs(np.array(points)[:, :2]) <= [90, 180]).all():
        get.faults.add(place, f"got {points}, needs [latitude, longitude, height]: degrees within 90 and 180, and m")
        return points
    try:
        latitude_deg, longitude_deg, height_m = np.array(points).T
        return np.column_stack([osm.place_m(model_path, latitude_deg, longitude_deg), height_m]).tolist()
    except CastError as error:
        for fault in error.faults:
            get.faults.add(place, fault)
        return points


def _equipment(entry: dict, place: str, get: Reader) -> dict:
    out = {}
    for key, unit, low, high in (("power_dbm", "dBm", -200, 200), ("noise_figure_db", "dB", 0, 100)):
        if key in entry:
            out[key] = get.number(entry[key], f"{place}.{key}", unit, low, high)
    if "antenna" in entry:
        out["antenna"] = entry["antenna"]
    if "orientation_rad" in entry:
        out["orientation_rad"] = tuple(_numbers(entry["orientation_rad"], f"{place}.orientation_rad", 3, get, "rad"))
    return out


def _nodes(document: dict, get: Reader, model_path: Path) -> list[Node]:
    nodes = []
    for index, grid in enumerate(get.sequence(document.get("node_grids", []), "node_grids")):
        place = f"node_grids[{index}]"
        grid = get.keys(grid, place, _GRID_KEYS)
        origin = _numbers(grid.get("origin_m"), f"{place}.origin_m", 3, get)
        spacing = _numbers(grid.get("spacing_m"), f"{place}.spacing_m", 2, get)
        counts = [int(c) if c == c and 1 <= c <= 256 else 0 for c in _numbers(grid.get("count"), f"{place}.count", 2, get)]
        if len(nodes) + counts[0] * counts[1] > MAX_NODES:
            get.faults.add(f"{place}.count", f"got more than {MAX_NODES} nodes in all, limit {MAX_NODES}")
            continue
        prefix = get.name(grid.get("prefix", "n"), f"{place}.prefix")
        for number in range(counts[0] * counts[1]):
            row, column = divmod(number, max(counts[0], 1))
            at = np.array(origin) + [column * spacing[0], row * spacing[1], 0]
            _add(nodes, get, f"{prefix}{number + 1}", dict(waypoints_m=[at]), _equipment(grid, place, get))
    for name, entry in get.mapping(document.get("nodes", {}), "nodes").items():
        place = f"nodes.{name}"
        entry = get.keys(entry, place, _NODE_KEYS)
        named = [key for key in _PLACES if key in entry]
        if len(named) != 1:
            get.faults.add(place, "needs position_m, or waypoints_m with speed_m_per_s; or either in degrees, position_deg")
            continue
        (key,) = named
        points = [entry[key]] if key.startswith("position") else get.sequence(entry[key], f"{place}.{key}")
        points = [_numbers(point, f"{place}.{key}", 3, get) for point in points] or [[0.0, 0.0, 0.0]]
        track = dict(waypoints_m=_in_metres(points, f"{place}.{key}", model_path, get) if key.endswith("_deg") else points)
        if "speed_m_per_s" in entry:
            track["speed_m_per_s"] = get.number(entry["speed_m_per_s"], f"{place}.speed_m_per_s", "m/s", 0, 1e4)
        _add(nodes, get, get.name(name, place), track, _equipment(entry, place, get))
    return nodes


def _add(nodes: list[Node], get: Reader, name: str, track: dict, equipment: dict) -> None:
    if not np.isfinite(track["waypoints_m"]).all() or not np.isfinite(track.get("speed_m_per_s", 0.0)):
        return  # a fault by now
    try:
        nodes.append(Node(name=name, **track, **equipment))
    except CastError as error:
        for fault in error.faults:
            get.faults.add("", fault)
