# SPDX-License-Identifier: GPL-3.0-or-later
"""A reader of MATLAB level 5 files (save -v6, -v7) that survives damaged ones; SciPy's own can crash the process on them.

Source: MathWorks, "MAT-File Format". It reads what scenarios are made of: numbers, cells and structs; the rest is None.
"""

import zlib
from pathlib import Path

import numpy as np

from ..core.documents import read_bytes
from ..core.errors import CastError

_HEADER_BYTES = 128
_MAX_BYTES = 320 << 20  # of all variables, unpacked: a million cells, which take another 700 MB as Python's
_MAX_NUMBERS = 8_000_000  # of one array
_MAX_NAMES = 1 << 16  # characters of a struct's names
_MAX_DEPTH = 8
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _NUMBERS = 1, 2, range(6, 16)
_COMPLEX_FLAG = 0x800
_TYPES = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip


class _Damaged(ValueError):
    pass


def read(path: str | Path) -> dict:
    """Variables by name: numbers as arrays, cells as object arrays, a 1 x 1 struct as a dict; other classes are None.

    Raises CastError for a missing file, another format, or damage.
    """
    path = Path(path)
    data = read_bytes(path, limit=_MAX_BYTES)
    if data.startswith((b"\x89HDF\r\n\x1a\n", b"MATLAB 7")):
        raise CastError(f"{path}: is a MATLAB 7.3 (HDF5) file, needs level 5: save with -v7")
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise CastError(f"{path}: not a MATLAB level 5 file (save -v7), or truncated")
    try:
        return dict(_variables(data[_HEADER_BYTES:], order))
    except (_Damaged, zlib.error) as error:
        raise CastError(f"{path}: truncated or damaged: {error}") from None


def _variables(data: bytes, order: str):
    room = _MAX_BYTES
    for kind, content in _elements(memoryview(data), order):
        if kind == _COMPRESSED:
            unpacker = zlib.decompressobj()
            content = unpacker.decompress(content, room)
            room -= len(content)
            if not unpacker.eof:
                raise _Damaged("a compressed variable ends early" if room else f"more than {_MAX_BYTES} bytes, unpacked")
            kind, content = next(_elements(memoryview(content), order), (None, b""))
        if kind != _MATRIX:
            raise _Damaged(f"got element type {kind}, needs a variable")
        name, value = _matrix(content, order, 0)
        yield name, value


def _elements(data: memoryview, order: str):
    """(type, content) of each element in turn; content lies at 8-byte steps, four bytes or less inside the tag."""
    at = 0
    while at < len(data):
        if len(data) - at < 8:
            raise _Damaged(f"{len(data) - at} bytes are left over")
        first, size = (int(word) for word in np.frombuffer(data, f"{order}u4", 2, at))
        if first >> 16:  # small element: size and type share the first word
            kind, size, start, step = first & 0xFFFF, first >> 16, at + 4, 8
            if size > 4:
                raise _Damaged(f"a small element claims {size} bytes")
        else:
            kind, start = first, at + 8
            step = 8 + (size if kind == _COMPRESSED else -(-size // 8) * 8)
        if start + size > len(data):
            raise _Damaged(f"an element claims {size} bytes, {len(data) - start} are left")
        yield kind, data[start : start + size]
        at += step


def _matrix(data: memoryview, order: str, depth: int):
    """(name, value) of one array element."""
    if not data:
        return "", np.zeros((0, 0))
    if depth > _MAX_DEPTH:
        raise _Damaged(f"nested deeper than {_MAX_DEPTH}")
    parts = _elements(data, order)
    flags, shape = _integers(parts, order, 8), _integers(parts, order, 8)
    name = _text(parts, order)
    if flags.size < 1 or shape.size < 2 or (shape < 0).any():
        raise _Damaged("an array has no class or shape")
    kind, count = int(flags[0]) & 0xFF, int(np.prod(shape.astype(object)))
    shape = tuple(int(side) for side in shape)
    if kind in _NUMBERS:
        value = _numbers(parts, order)
        if flags[0] & _COMPLEX_FLAG:
            imaginary = _numbers(parts, order)
            if imaginary.size != value.size:
                raise _Damaged("an array's imaginary part has another size")
            value = value + 1j * imaginary
        if value.size != count:
            raise _Damaged(f"an array of shape {shape} holds {value.size} numbers")
        return name, value.reshape(shape, order="F")
    if kind == _CELL:
        items = [_matrix(_content(part), order, depth + 1)[1] for part in parts]
        if len(items) != count:
            raise _Damaged(f"a cell array of shape {shape} holds {len(items)} cells")
        value = np.empty(count, object)
        for index, item in enumerate(items):  # one by one: NumPy would merge cells of equal shape
            value[index] = item
        return name, value.reshape(shape, order="F")
    if kind == _STRUCT and count == 1:
        width, names = _integers(parts, order, 8), _text(parts, order)
        if width.size != 1 or width[0] < 1:
            raise _Damaged("a struct has no length of names")
        fields = [names[at : at + width[0]].split("\0")[0] for at in range(0, len(names), width[0])]
        items = [_matrix(_content(part), order, depth + 1)[1] for part in parts]
        if len(items) != len(fields):
            raise _Damaged(f"a struct of {len(fields)} fields holds {len(items)}")
        return name, dict(zip(fields, items, strict=True))
    return name, None


def _content(part: tuple[int, memoryview]) -> memoryview:
    if part[0] != _MATRIX:
        raise _Damaged(f"got element type {part[0]}, needs an array")
    return part[1]


def _integers(parts, order: str, most: int) -> np.ndarray:
    numbers = _numbers(parts, order)
    if numbers.size > most:
        raise _Damaged(f"got {numbers.size} numbers where {most} are the most")
    if numbers.dtype.kind == "f":
        raise _Damaged("got fractions where whole numbers belong")
    return numbers.astype(np.int64)


def _text(parts, order: str) -> str:
    return (_integers(parts, order, _MAX_NAMES) & 0xFF).astype(np.uint8).tobytes().decode("latin-1")


def _numbers(parts, order: str) -> np.ndarray:
    kind, content = next(parts, (None, b""))
    if kind not in _TYPES:
        raise _Damaged(f"got element type {kind}, needs numbers")
    item = np.dtype(order + _TYPES[kind])
    if len(content) % item.itemsize:
        raise _Damaged(f"{len(content)} bytes are not whole numbers of {item.itemsize} bytes")
    if len(content) // item.itemsize > _MAX_NUMBERS:
        raise _Damaged(f"got {len(content) // item.itemsize} numbers, limit {_MAX_NUMBERS}")
    return np.frombuffer(bytes(content), item)
