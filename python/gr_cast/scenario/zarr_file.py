# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenarios as Zarr folders: large ones, sparse and labelled, that xarray opens as well.

Zarr version 2 (https://zarr-specs.readthedocs.io), one group of arrays with `_ARRAY_DIMENSIONS`, zlib chunks, one chunk per
link. A link that does not change is stored once; so are two directions that are the same. Gains are complex64.
"""

import math
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..core.documents import Reader, json_file, read_bytes, short
from ..core.errors import CastError
from ..core.files import write_json, written_aside
from .model import INTERPOLATIONS, MAX_NODES, LinkTaps, Scenario

VERSION = 1
OUTLINES_FILE = "outlines.json"
MAX_ARRAY_BYTES = 1 << 31  # of one array, unpacked
MAX_CHUNKS = MAX_NODES**2  # of one array: one for each link
_DTYPES = ("<f8", "<f4", "<c8", "<c16", "<i2", "<i4", "<i8")
_DEFLATE = 1032  # bytes that one of zlib's can become at most
_FIELDS = ("name", "description", "center_frequency_hz", "bandwidth_hz", "base_loss_db", "interpolation")


def write_array(folder: Path, name: str, values: np.ndarray, dimensions: tuple[str, ...], chunk_rows: int = 0) -> None:
    """One array of a group; `chunk_rows` rows of the first axis per chunk, 0 for all in one."""
    path = folder / name
    path.mkdir()
    values = np.ascontiguousarray(values)
    rows = chunk_rows or max(1, len(values))
    chunks = [rows, *(max(1, side) for side in values.shape[1:])]
    write_json(
        path / ".zarray",
        {
            "zarr_format": 2, "shape": list(values.shape), "chunks": chunks, "dtype": values.dtype.str, "order": "C",
            "fill_value": None, "filters": None, "compressor": {"id": "zlib", "level": 1},
        },
    )  # fmt: skip
    write_json(path / ".zattrs", {"_ARRAY_DIMENSIONS": list(dimensions)})
    if values.size:
        for start in range(0, len(values), rows):
            chunk = np.zeros(chunks, values.dtype)  # Zarr stores the last chunk whole
            part = values[start : start + rows]
            chunk[: len(part)] = part
            key = ".".join([str(start // rows)] + ["0"] * (values.ndim - 1))
            (path / key).write_bytes(zlib.compress(chunk.tobytes(), 1))


def read_array(folder: Path, name: str, kinds: str = "ifc") -> np.ndarray:
    """An array written by `write_array`, of NumPy's `kinds`. Raises CastError for a missing or damaged one."""
    path = folder / name
    get = json_file(path / ".zarray")
    shape, chunks = (_sides(get, side) for side in ("shape", "chunks"))
    names = [one for one in _DTYPES if np.dtype(one).kind in kinds]
    kind = np.dtype(get.choice(get.document.get("dtype"), "dtype", names))
    if get.mapping(get.document.get("compressor"), "compressor").get("id") != "zlib":
        get.faults.add("compressor", "needs zlib")
    get.faults.raise_if_any()
    if len(shape) != len(chunks) or (shape[1:] != chunks[1:] and 0 not in shape):
        raise CastError(f"{path}: .zarray: shape {shape}, chunks {chunks}: needs one chunk per block of rows")
    size = math.prod(chunks) * kind.itemsize
    if math.prod(shape) * kind.itemsize > MAX_ARRAY_BYTES or size > MAX_ARRAY_BYTES:
        raise CastError(f"{path}: .zarray: shape {shape}: limit {MAX_ARRAY_BYTES} bytes")
    starts = range(0, shape[0] if math.prod(shape) else 0, chunks[0])
    if len(starts) > MAX_CHUNKS:
        raise CastError(f"{path}: .zarray: shape {shape}: got {len(starts)} chunks, limit {MAX_CHUNKS}")
    files = [path / ".".join([str(start // chunks[0]), *["0"] * (len(shape) - 1)]) for start in starts]
    stored = sum(file.stat().st_size for file in files if file.is_file())
    if stored * _DEFLATE < math.prod(shape) * kind.itemsize:
        raise CastError(f"{path}: truncated: {stored} bytes in {len(files)} chunks cannot be an array of shape {shape}")
    values = np.empty(shape, kind)
    for start, file in zip(starts, files, strict=True):
        try:
            data = zlib.decompressobj().decompress(read_bytes(file, limit=size + 1024), size)
        except zlib.error as error:
            raise CastError(f"{file}: damaged: {error}") from None
        if len(data) != size:
            raise CastError(f"{file}: truncated: {len(data)} bytes, unpacked, needs {size}")
        block = np.frombuffer(data, kind).reshape(chunks)
        values[start : start + chunks[0]] = block[: len(values) - start]
    return values


def _sides(get: Reader, name: str) -> tuple[int, ...]:
    sides = get.sequence(get.document.get(name), name)
    if not 1 <= len(sides) <= 4:
        get.faults.add(name, f"got {short(sides)}, needs one to four sides")
        return (1,)
    return tuple(get.whole(side, name, "rows", int(name == "chunks"), 1 << 31) for side in sides)


def write(path: str | Path, scenario: Scenario, *, outlines: Sequence[dict] = (), **attributes) -> None:
    """Write a scenario as a Zarr folder, whole or not at all; `attributes` go beside its own, the `outlines` of its place, which
    may be long and only a plan needs, in a file of theirs."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_aside(path) as aside:
        aside.mkdir()
        _write_group(aside, scenario, attributes)
        if outlines:
            write_json(aside / OUTLINES_FILE, list(outlines))


def _write_group(folder: Path, scenario: Scenario, attributes: dict) -> None:
    keys, both_ways = _once(scenario.links)
    number = {node: index for index, node in enumerate(scenario.nodes)}
    own = {name: getattr(scenario, name) for name in _FIELDS} | {"nodes": list(scenario.nodes)}
    own["link_base_loss_db"] = [[tx, rx, loss] for (tx, rx), loss in scenario.link_base_loss_db.items()]
    write_json(folder / ".zgroup", {"zarr_format": 2})
    write_json(folder / ".zattrs", {"cast_scenario": VERSION, **own, **attributes})
    write_array(folder, "time_s", scenario.time_s, ("time",))
    width = max((link.gain.shape[1] for link in scenario.links.values()), default=1)
    for kind in ("static", "moving"):
        chosen = [key for key in keys if scenario.links[key].is_static == (kind == "static")]
        taps = [scenario.links[key] for key in chosen]
        ends = np.array([(number[tx], number[rx], (tx, rx) in both_ways) for tx, rx in chosen], np.int16).reshape(-1, 3)
        axes = (f"{kind}_link",) if kind == "static" else (f"{kind}_link", "time")
        length = 1 if kind == "static" else scenario.time_s.size
        shape = (len(taps), width) if kind == "static" else (len(taps), length, width)
        delay_s, gain = np.zeros(shape), np.zeros(shape, np.complex64)
        for index, link in enumerate(taps):
            columns = slice(0, link.gain.shape[1])
            delay_s[index, ..., columns] = link.delay_s[0] if kind == "static" else link.delay_s
            gain[index, ..., columns] = link.gain[0] if kind == "static" else link.gain
        rows = 0 if kind == "static" else 1
        write_array(folder, f"{kind}_ends", ends, (f"{kind}_link", "tx_rx_both_ways"))
        write_array(folder, f"{kind}_delay_s", delay_s, (*axes, "tap"), rows)
        write_array(folder, f"{kind}_gain", gain, (*axes, "tap"), rows)
    for node, position_m in scenario.position_m.items():
        write_array(folder, f"position_m_{number[node]}", np.asarray(position_m), (f"instant_{len(position_m)}", "xyz"))


def _once(links: dict) -> tuple[list, set]:
    """The links to store, and those among them that stand for both directions."""
    both_ways = set()
    keys = []
    for key, taps in links.items():
        back = (key[1], key[0])
        if back in both_ways and back != key:
            continue
        if back != key and back in links and links[back] == taps:
            both_ways.add(key)
        keys.append(key)
    return keys, both_ways


def attributes(path: str | Path) -> dict:
    """The attributes of a Zarr scenario. Raises CastError where there are none."""
    get = json_file(Path(path) / ".zattrs", missing=": not a Zarr scenario")
    get.version("cast_scenario", VERSION)
    get.faults.raise_if_any()
    return get.document


def outlines(path: str | Path) -> list[dict]:
    """The objects of the place as `create` left them (`geometry.outlines`); none of a scenario that came otherwise."""
    file = Path(path) / OUTLINES_FILE
    if not file.is_file():
        return []
    get, found = json_file(file, kind=list), []
    for k, entry in enumerate(get.document):
        place = f"outlines[{k}]"
        entry = get.keys(entry, place, {"name", "faces", "floor"}, ("name", "faces", "floor"))
        faces = get.sequence(entry.get("faces", []), f"{place}.faces")
        for corner in (corner for face in faces for corner in get.sequence(face, f"{place}.faces")):
            pair = get.sequence(corner, f"{place}.faces")
            if len(pair) != 2:
                get.faults.add(f"{place}.faces", "needs x and y of every corner")
            for number in pair:
                get.number(number, f"{place}.faces", "m")
        found.append({"name": get.text(entry.get("name"), f"{place}.name"), "faces": faces, "floor": entry.get("floor") is True})
    get.faults.raise_if_any()
    return found


def read(path: str | Path) -> Scenario:
    """Read a Zarr scenario. Raises CastError for damage or values that the model refuses."""
    path = Path(path)
    get = Reader(f"{path}: .zattrs", attributes(path))
    nodes = tuple(get.name(node, "nodes") for node in get.sequence(get.document.get("nodes"), "nodes")[: MAX_NODES + 1])
    losses = {}
    for entry in get.sequence(get.document.get("link_base_loss_db"), "link_base_loss_db"):
        if not isinstance(entry, list) or len(entry) != 3 or not {*map(str, entry[:2])} <= {*nodes}:
            get.faults.add("link_base_loss_db", f"got {short(entry)}, needs tx, rx and dB")
            continue
        losses[str(entry[0]), str(entry[1])] = get.number(entry[2], "link_base_loss_db", "dB")
    hz = {place: get.document.get(place) for place in ("center_frequency_hz", "bandwidth_hz")}
    fields = {
        "name": get.text(get.document.get("name"), "name"),
        "description": str(get.document.get("description", "")),
        **{place: None if value is None else get.number(value, place, "Hz", 1.0, 1e12) for place, value in hz.items()},
        "base_loss_db": get.number(get.document.get("base_loss_db"), "base_loss_db", "dB"),
        "interpolation": get.choice(get.document.get("interpolation"), "interpolation", INTERPOLATIONS),
    }
    get.faults.raise_if_any()
    links = {}
    for kind in ("static", "moving"):
        ends, delay_s, gain = (
            read_array(path, f"{kind}_{name}", kinds) for name, kinds in (("ends", "i"), ("delay_s", "f"), ("gain", "c"))
        )
        if ends.ndim != 2 or ends.shape[1] != 3 or delay_s.shape != gain.shape or len(ends) != len(gain) or 0 in gain.shape[1:]:
            raise CastError(f"{path}: {kind}_ends: its shape does not fit {kind}_gain")
        if ends.size and (ends[:, :2].min() < 0 or ends[:, :2].max() >= len(nodes)):
            raise CastError(f"{path}: {kind}_ends: names a node that is not in nodes")
        for (tx, rx, both_ways), delays, gains in zip(ends, delay_s, gain, strict=True):
            used = (gains != 0).reshape(-1, gains.shape[-1]).any(axis=0)
            used[0] = True
            taps = LinkTaps(delay_s=delays[..., used], gain=gains[..., used])
            links[nodes[tx], nodes[rx]] = taps
            if both_ways:
                links[nodes[rx], nodes[tx]] = taps
    position_m = {node: f"position_m_{index}" for index, node in enumerate(nodes) if (path / f"position_m_{index}").is_dir()}
    try:
        return Scenario(
            nodes=nodes,
            links=links,
            time_s=read_array(path, "time_s", "f"),
            link_base_loss_db=losses,
            position_m={node: read_array(path, name, "f") for node, name in position_m.items()},
            **fields,
        )
    except CastError as error:
        raise CastError(*(f"{path}: {fault}" for fault in error.faults)) from None
