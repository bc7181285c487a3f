# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenStreetMap extracts (XML files) as prisms over building outlines, with heights, levels, parts and courtyards.

Tags as in the OpenStreetMap wiki, "Simple 3D Buildings": where a building has parts, the parts stand for it.
"""

import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...core.errors import CastError, Faults
from .geometry import Solid, prism, signed_area_m2

LEVEL_HEIGHT_M = 3.0
DEFAULT_HEIGHT_M = 9.0
MAX_HEIGHT_M = 1000.0
GROUND_MARGIN_M = 50.0
_UNITS_M = {"": 1.0, "m": 1.0, "ft": 0.3048, "'": 0.3048, "km": 1000.0}


def read(path: str | Path, *, default_height_m: float = DEFAULT_HEIGHT_M, level_height_m: float = LEVEL_HEIGHT_M, area_m=None):
    """Buildings and a flat ground of an extract: (objects, Counter of what was found, assumed and left out).

    x is east and y north, in metres from the middle of the extract's bounds (or of its nodes). With `area_m` (west, south,
    east, north) buildings wholly outside are left out. Raises CastError with every faulty building by its id.
    """
    path = Path(path)
    root = _root(path)
    faults, count = Faults(str(path)), Counter()
    points = _project(root, faults)
    faults.raise_if_any()
    ways = {way.get("id"): way for way in root.iter("way")}
    footprints = list(_footprints(root, ways, points, faults))
    solids = []
    with_parts = {f["id"] for f in footprints if not f["part"] and any(g["part"] and _holds(f, g) for g in footprints)}
    for footprint in footprints:
        place, outline, tags = footprint["place"], footprint["outline"], footprint["tags"]
        if footprint["id"] in with_parts:
            count["buildings shown by their parts"] += 1
        elif area_m is not None and not _touches(outline, area_m):
            count["outside the area"] += 1
        else:
            heights = _heights(tags, default_height_m, level_height_m, place, faults, count)
            if heights is not None:
                try:
                    surface = tags.get("building:material", "building")
                    solids.append(prism(place, outline, footprint["holes"], *heights, surface))
                    count["courtyards"] += len(footprint["holes"])
                except CastError as error:
                    faults.add(place, error.faults[0])
    faults.raise_if_any()
    if not solids:
        raise CastError(f"{path}: holds no building" + (" inside the area" if area_m is not None else ""))
    count["buildings and parts"] = len(solids)
    return [*solids, _ground(solids, area_m)], count


def _root(path: Path):
    try:
        root = ElementTree.parse(path).getroot()
    except FileNotFoundError:
        raise CastError(f"{path}: no such file") from None
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # unknown or broken encodings too
        raise CastError(f"{path}: not XML, or truncated: {error}") from None
    if root.tag != "osm":
        raise CastError(f"{path}: got <{root.tag}>, needs an OpenStreetMap file <osm>")
    return root


def place_m(path: str | Path, latitude_deg, longitude_deg) -> np.ndarray:
    """Metres east and north, (…, 2), of places (…,) on the axes of an extract, as `read` has them. Raises CastError."""
    faults = Faults(str(path))
    _, middle, scale = _frame(_root(Path(path)), faults)
    faults.raise_if_any()
    return (np.stack([longitude_deg, latitude_deg], axis=-1) - middle) * scale


def _project(root, faults: Faults) -> dict[str, np.ndarray]:
    """Metres east and north of each node on the plane that touches the WGS 84 ellipsoid in the middle."""
    nodes, middle, scale = _frame(root, faults)
    return {key: (value - middle) * scale for key, value in nodes.items()}


def _frame(root, faults: Faults) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """(longitude and latitude of each node, those of the middle, metres per degree there); no node where that cannot be told."""
    nodes = {}
    for node in root.iter("node"):
        try:
            place = np.array([float(node.get("lon")), float(node.get("lat"))])
        except (TypeError, ValueError):
            place = np.full(2, np.nan)
        if (np.abs(place) <= [180, 90]).all():
            nodes[node.get("id")] = place
        else:
            faults.add(f"node {node.get('id')}", "needs lon and lat in degrees")
    if not nodes:
        faults.add("", "holds no nodes")
        return {}, np.zeros(2), np.zeros(2)
    bounds = root.find("bounds")
    if bounds is not None:
        corners = np.array([[_degrees(bounds.get(f"{end}{axis}")) for axis in ("lon", "lat")] for end in ("min", "max")])
    else:
        corners = np.array([np.min(list(nodes.values()), axis=0), np.max(list(nodes.values()), axis=0)])
    middle = corners.mean(axis=0)
    if not (np.isfinite(middle).all() and abs(middle[1]) < 85):
        faults.add("bounds", "needs minlon, minlat, maxlon and maxlat in degrees, latitude within 85")
        return {}, np.zeros(2), np.zeros(2)
    sine, e2, a = np.sin(np.deg2rad(middle[1])), 0.00669437999014, 6378137.0
    prime_vertical_m = a / np.sqrt(1 - e2 * sine**2)
    meridian_m = a * (1 - e2) / (1 - e2 * sine**2) ** 1.5
    scale = np.deg2rad(1) * np.array([prime_vertical_m * np.sqrt(1 - sine**2), meridian_m])
    return nodes, middle, scale


def _degrees(text: str | None) -> float:
    try:
        value = float(text or "nan")
    except ValueError:
        return np.nan
    return value if abs(value) <= 180 else np.nan


def _tags(element) -> dict[str, str]:
    return {tag.get("k"): tag.get("v", "") for tag in element.findall("tag")}


def _footprints(root, ways: dict, points: dict, faults: Faults):
    """Every building or part: outline (n, 2), holes, tags."""
    members = set()
    for relation in root.iter("relation"):
        tags = _tags(relation)
        if tags.get("type") != "multipolygon" or not _is_building(tags):
            continue
        place = f"relation {relation.get('id')}"
        rings = {"outer": [], "inner": []}
        for member in relation.findall("member"):
            if member.get("type") == "way" and member.get("role") in rings and member.get("ref") in ways:
                members.add(member.get("ref"))
                rings[member.get("role")].append([nd.get("ref") for nd in ways[member.get("ref")].findall("nd")])
        outers, inners = (_closed(part) for part in (rings["outer"], rings["inner"]))
        if not outers or None in outers + inners:
            faults.add(place, "its outer or inner ways do not close, or are missing from the file")
            continue
        outlines = [_outline(ring, points, place, faults) for ring in outers]
        holes = [_outline(ring, points, place, faults) for ring in inners]
        for index, outline in enumerate(outlines):
            if outline is not None:
                own = [hole for hole in holes if hole is not None and _inside(outline, hole[0])]
                yield _footprint(place if len(outlines) == 1 else f"{place}.{index + 1}", outline, own, tags)
    for key, way in ways.items():
        tags = _tags(way)
        if _is_building(tags) and key not in members:
            place, refs = f"way {key}", [nd.get("ref") for nd in way.findall("nd")]
            if len(refs) < 4 or refs[0] != refs[-1]:
                faults.add(place, "a building whose outline does not close")
                continue
            outline = _outline(refs, points, place, faults)
            if outline is not None:
                yield _footprint(place, outline, [], tags)


def _footprint(place: str, outline, holes, tags) -> dict:
    part = tags.get("building:part", "no") != "no"
    return {"id": place, "place": f"building {place}", "outline": outline, "holes": holes, "tags": tags, "part": part}


def _is_building(tags: dict) -> bool:
    return tags.get("building", "no") != "no" or tags.get("building:part", "no") != "no"


def _closed(parts: list[list[str]]) -> list[list[str] | None]:
    """Ways joined end to end into rings; None for one that stays open."""
    rings, parts = [], [list(part) for part in parts if len(part) > 1]
    while parts:
        ring = parts.pop()
        while ring[0] != ring[-1]:
            following = next((p for p in parts if ring[-1] in (p[0], p[-1])), None)
            if following is None:
                break
            parts.remove(following)
            ring += (following if following[0] == ring[-1] else following[::-1])[1:]
        rings.append(ring if ring[0] == ring[-1] and len(ring) > 3 else None)
    return rings


def _outline(refs: list[str], points: dict, place: str, faults: Faults) -> np.ndarray | None:
    missing = [ref for ref in refs if ref not in points]
    if missing:
        faults.add(f"building {place}", f"its node {missing[0]} is not in the file")
        return None
    outline = np.array([points[ref] for ref in refs[:-1]])
    outline = outline[(outline != np.roll(outline, 1, axis=0)).any(axis=1)]
    if len(outline) < 3 or abs(signed_area_m2(outline)) < 0.01:
        faults.add(f"building {place}", "its outline has no area")
        return None
    return outline


def _inside(outline: np.ndarray, point: np.ndarray) -> bool:
    """Whether a point lies in a polygon: an odd number of edges cross a ray to the east."""
    a, b = outline, np.roll(outline, -1, axis=0)
    spans = (a[:, 1] > point[1]) != (b[:, 1] > point[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        x = a[:, 0] + (point[1] - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return bool((spans & (x > point[0])).sum() % 2)


def _holds(building: dict, part: dict) -> bool:
    return _inside(building["outline"], part["outline"].mean(axis=0))


def _touches(outline: np.ndarray, area_m) -> bool:
    west, south, east, north = area_m
    low, high = outline.min(axis=0), outline.max(axis=0)
    return low[0] <= east and high[0] >= west and low[1] <= north and high[1] >= south


def length_m(text: str) -> float:
    """Metres of a tag such as 12, 12 m, 40 ft, 40' or 40'6". Raises ValueError for anything else."""
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(m|ft|'|km)?\s*", text)
    if match:
        return float(match[1]) * _UNITS_M[match[2] or ""]
    match = re.fullmatch(r"\s*([0-9]+)'\s*([0-9]*\.?[0-9]+)\"\s*", text)
    if match and float(match[2]) < 12:
        return (int(match[1]) + float(match[2]) / 12) * _UNITS_M["ft"]
    raise ValueError(f"got {text!r}, needs metres, or a number with m, ft or ', or feet and inches as in 40'6\"")


def _levels(text: str) -> float:
    if not re.fullmatch(r"\s*[0-9]*\.?[0-9]+\s*", text):
        raise ValueError(f"got {text!r}, needs a number of storeys")
    return float(text)


def _tagged(tags: dict, key: str, meaning: Callable[[str], float]) -> float:
    """The number that a tag means, 0 without it. Raises ValueError with the tag's name."""
    try:
        return meaning(tags.get(key, "0"))
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from None


def _heights(tags, default_m, level_m, place, faults: Faults, count: Counter) -> tuple[float, float] | None:
    """Bottom and top of a building, from its height, else its levels, else the default."""
    try:
        if "min_height" in tags:
            low_m = _tagged(tags, "min_height", length_m)
        else:
            low_m = level_m * _tagged(tags, "building:min_level", _levels)
        if "height" in tags:
            high_m, source = _tagged(tags, "height", length_m), "heights given"
        elif "building:levels" in tags:
            high_m, source = level_m * _tagged(tags, "building:levels", _levels), f"heights from levels of {level_m:g} m"
        else:
            high_m, source = max(default_m, low_m + level_m), f"heights assumed, {default_m:g} m"
    except ValueError as error:
        faults.add(place, str(error))
        return None
    if not 0 <= low_m < high_m <= MAX_HEIGHT_M:
        faults.add(place, f"height: got {low_m:g} to {high_m:g} m, needs 0 <= bottom < top <= {MAX_HEIGHT_M:g} m")
        return None
    count[source] += 1
    return low_m, high_m


def _ground(solids: list[Solid], area_m) -> Solid:
    corners = np.concatenate([solid.vertices_m[:, :2] for solid in solids])
    low, high = corners.min(axis=0), corners.max(axis=0)
    if area_m is not None:
        low, high = np.minimum(low, area_m[:2]), np.maximum(high, area_m[2:])
    (w, s), (e, n) = low - GROUND_MARGIN_M, high + GROUND_MARGIN_M
    corners = [[w, s, 0], [e, s, 0], [e, n, 0], [w, n, 0]]
    return Solid(name="ground", vertices_m=corners, faces=[[0, 1, 2], [0, 2, 3]], surface="ground")
