# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh files: Wavefront OBJ, PLY, STL and COLLADA as named objects. Faces with more corners are fanned into triangles.

Files are taken in metres with z up; COLLADA states its own unit and axis, which are applied.
"""

import re
import struct
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from ...core.errors import CastError
from .geometry import Solid


def read(path: str | Path) -> list[Solid]:
    """Objects of a mesh file, with their names. Raises CastError for a missing, damaged or empty file."""
    path = Path(path)
    reader = {".obj": _read_obj, ".ply": _read_ply, ".stl": _read_stl, ".dae": _read_dae}.get(path.suffix.lower())
    if reader is None:
        raise CastError(f"{path}: suffix: got {path.suffix!r}, needs .obj, .ply, .stl or .dae")
    try:
        solids = reader(path)
    except FileNotFoundError:
        raise CastError(f"{path}: no such file") from None
    except CastError as error:
        raise CastError(*(f"{path}: {fault}" for fault in error.faults)) from None
    except (ValueError, LookupError, TypeError, AttributeError, OverflowError, struct.error, ElementTree.ParseError) as error:
        raise CastError(f"{path}: damaged: {error}") from None
    if not solids:
        raise CastError(f"{path}: holds no faces")
    return _with_own_names(solids)


def _with_own_names(solids: list[Solid]) -> list[Solid]:
    """Objects that share a name get a number, so that every one can be told apart."""
    count: dict[str, int] = {}
    named = []
    for solid in solids:
        count[solid.name] = count.get(solid.name, 0) + 1
        name = solid.name if count[solid.name] == 1 else f"{solid.name}.{count[solid.name]}"
        named.append(Solid(name=name, vertices_m=solid.vertices_m, faces=solid.faces, surface=solid.surface))
    return named


def _fan(corners: list[int]) -> list[list[int]]:
    return [[corners[0], corners[index], corners[index + 1]] for index in range(1, len(corners) - 1)]


def _solid(name: str, vertices_m, faces, surface: str = "") -> Solid:
    """An object that keeps only the vertices its faces use."""
    used, faces = np.unique(np.array(faces, np.int64), return_inverse=True)
    if used[0] < 0 or used[-1] >= len(vertices_m):
        raise CastError(f"object {name}: a face names a vertex that is not there")
    return Solid(name=name, vertices_m=np.asarray(vertices_m)[used], faces=faces.reshape(-1, 3), surface=surface)


def _read_obj(path: Path) -> list[Solid]:
    vertices, parts, name, surface = [], {}, path.stem, ""
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        if words[0] == "v":
            vertices.append(_vertex(words[1:4], number))
        elif words[0] in ("o", "g") and len(words) > 1:
            name = " ".join(words[1:])
        elif words[0] == "usemtl":
            surface = " ".join(words[1:])
        elif words[0] == "f":
            corners = [int(word.split("/")[0]) for word in words[1:]]
            corners = [corner - 1 if corner > 0 else len(vertices) + corner for corner in corners]
            if len(corners) < 3 or not all(0 <= corner < len(vertices) for corner in corners):
                raise CastError(f"line {number}: a face names a vertex that is not there, or fewer than 3")
            parts.setdefault((name, surface), []).extend(_fan(corners))
    return [_solid(name, vertices, faces, surface) for (name, surface), faces in parts.items()]


def _vertex(words: list[str], number: int) -> list[float]:
    try:
        x, y, z = map(float, words)
    except ValueError:
        raise CastError(f"line {number}: got {' '.join(words)!r}, a vertex needs x, y and z") from None
    return [x, y, z]


_PLY_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip


def _read_ply(path: Path) -> list[Solid]:
    data = path.read_bytes()
    end = re.search(rb"end_header\r?\n", data)
    if not data.startswith(b"ply") or not end:
        raise CastError("not a PLY file: needs ply ... end_header")
    head, body = data[: end.start()], data[end.end() :]
    kind, elements = "", []
    for words in (line.split() for line in head.decode("ascii", "replace").splitlines()):
        if words[:1] == ["format"]:
            kind = words[1]
        elif words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][2].append(words[1:])
    if kind not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise CastError(f"format: got {kind!r}")
    take = _ascii_taker(body) if kind == "ascii" else _binary_taker(body, "<" if "little" in kind else ">")
    vertices, faces = [], []
    for element, count, properties in elements:
        if count > len(body):
            raise CastError(f"truncated: {count} of {element} in {len(body)} bytes")
        for _ in range(count):
            row = {words[-1]: take(words) for words in properties}
            if element == "vertex":
                vertices.append([float(row[axis]) for axis in "xyz"])
            elif element == "face":
                corners = row.get("vertex_indices", row.get("vertex_index"))
                faces += _fan([int(corner) for corner in corners])
    return [_solid(path.stem, vertices, faces)] if faces else []


def _ascii_taker(body: bytes):
    words = iter(body.split())

    def take(kind):
        try:
            if kind[0] == "list":
                return [float(next(words)) for _ in range(int(next(words)))]
            return float(next(words))
        except StopIteration:
            raise CastError("truncated") from None

    return take


def _binary_taker(body: bytes, order: str):
    at = 0

    def number(kind: str):
        nonlocal at
        item = np.dtype(order + _PLY_TYPES[kind])
        value = np.frombuffer(body, item, 1, at)[0]
        at += item.itemsize
        return value

    def take(kind):
        return [number(kind[2]) for _ in range(int(number(kind[1])))] if kind[0] == "list" else number(kind[0])

    return take


def _read_stl(path: Path) -> list[Solid]:
    data = path.read_bytes()
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else -1
    if len(data) == 84 + 50 * count:
        rows = np.frombuffer(data, np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")]), count, 84)
        return [_soup(path.stem, rows["v"].astype(np.float64))] if count else []
    if not data.lstrip().startswith(b"solid"):
        raise CastError("not an STL file, or truncated")
    solids, name, corners = [], path.stem, []
    for words in (line.split() for line in data.decode("ascii", "replace").splitlines()):
        if words[:1] == ["solid"]:
            name, corners = " ".join(words[1:]) or path.stem, []
        elif words[:1] == ["vertex"]:
            corners.append([float(word) for word in words[1:4]])
        elif words[:1] == ["endsolid"] and corners:
            solids.append(_soup(name, np.array(corners).reshape(-1, 3, 3)))
            corners = []
    if corners:
        raise CastError("truncated: a solid has no endsolid")
    return solids


def _soup(name: str, triangles_m: np.ndarray) -> Solid:
    """An object from triangles (n, 3, 3) that do not share vertices."""
    vertices_m, index = np.unique(triangles_m.reshape(-1, 3), axis=0, return_inverse=True)
    return Solid(name=name, vertices_m=vertices_m, faces=index.reshape(-1, 3))


_MAX_DEPTH, _MAX_NODES = 64, 20_000


def _read_dae(path: Path) -> list[Solid]:
    root = ElementTree.parse(path).getroot()
    for element in root.iter():  # names without the namespace
        element.tag = element.tag.rpartition("}")[2]
    unit = root.find("asset/unit")
    metre = float(unit.get("meter", "1")) if unit is not None else 1.0
    if not 0 < metre < np.inf:
        raise CastError(f"asset/unit: got {metre:g} m, needs more than 0")
    turn = {
        "Z_UP": np.eye(3),
        "Y_UP": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
        "X_UP": np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    }[root.findtext("asset/up_axis", "Y_UP").strip()]
    geometries = {geometry.get("id"): geometry for geometry in root.iter("geometry")}
    nodes = {node.get("id"): node for node in root.iter("node")}
    solids: list[Solid] = []
    visits = 0

    def visit(node, matrix: np.ndarray, depth: int) -> None:
        nonlocal visits
        visits += 1
        if depth > _MAX_DEPTH or visits > _MAX_NODES:  # a few nodes that name each other make any number
            raise CastError(f"nodes are nested deeper than {_MAX_DEPTH}, or are more than {_MAX_NODES}")
        for child in node:
            if child.tag in ("matrix", "translate", "scale", "rotate"):
                matrix = matrix @ _dae_transform(child)
        name = node.get("name") or node.get("id") or path.stem
        for instance in node.findall("instance_geometry"):
            geometry = geometries[instance.get("url", "").lstrip("#")]
            for vertices, faces, surface in _dae_parts(geometry):
                placed = vertices @ matrix[:3, :3].T + matrix[:3, 3]
                solids.append(_solid(name, metre * placed @ turn.T, faces, surface))
        for child in node.findall("node"):
            visit(child, matrix, depth + 1)
        for instance in node.findall("instance_node"):
            visit(nodes[instance.get("url", "").lstrip("#")], matrix, depth + 1)

    for scene in root.iter("visual_scene"):
        for node in scene.findall("node"):
            visit(node, np.eye(4), 0)
    return solids


def _dae_transform(element) -> np.ndarray:
    numbers = np.array([float(word) for word in (element.text or "").split()])
    matrix = np.eye(4)
    if element.tag == "matrix":
        return numbers.reshape(4, 4)
    if element.tag == "translate":
        matrix[:3, 3] = numbers
    elif element.tag == "scale":
        matrix[:3, :3] = np.diag(numbers)
    else:  # rotate: axis and degrees, Rodrigues' formula
        length = np.linalg.norm(numbers[:3])
        if not 0 < length < np.inf:
            raise CastError("rotate: an axis without a direction")
        x, y, z = numbers[:3] / length
        k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        angle = np.deg2rad(numbers[3])
        matrix[:3, :3] = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    return matrix


def _dae_parts(geometry):
    """(vertices, triangles, material) of each primitive group of a COLLADA geometry."""
    mesh = geometry.find("mesh")
    arrays = {}
    for source in mesh.findall("source"):
        floats = source.find("float_array")
        if floats is not None:
            arrays[source.get("id")] = np.array([float(word) for word in (floats.text or "").split()])
    positions = {}
    for vertices in mesh.findall("vertices"):
        for entry in vertices.findall("input"):
            if entry.get("semantic") == "POSITION":
                positions[vertices.get("id")] = arrays[entry.get("source").lstrip("#")].reshape(-1, 3)
    for group in [*mesh.findall("triangles"), *mesh.findall("polylist"), *mesh.findall("polygons")]:
        inputs = group.findall("input")
        width = 1 + max(int(entry.get("offset")) for entry in inputs)
        vertex = next((entry for entry in inputs if entry.get("semantic") == "VERTEX"), None)
        if vertex is None:
            raise CastError("a group of faces has no VERTEX input")
        offset = int(vertex.get("offset"))
        lists = [[int(word) for word in (p.text or "").split()][offset::width] for p in group.findall("p")]
        if group.tag == "polygons":
            faces = [face for corners in lists for face in _fan(corners)]
        else:
            corners = [corner for part in lists for corner in part]
            counts = [int(word) for word in (group.findtext("vcount") or "").split()] or [3] * (len(corners) // 3)
            if sum(counts) != len(corners):
                raise CastError(f"truncated: faces of {sum(counts)} corners in all, {len(corners)} are there")
            faces, at = [], 0
            for count in counts:
                faces += _fan(corners[at : at + count])
                at += count
        if faces:
            yield positions[vertex.get("source").lstrip("#")], faces, group.get("material", "")
