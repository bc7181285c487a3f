# SPDX-License-Identifier: GPL-3.0-or-later
"""NumPy's archives (.npz) read strictly: sizes are known and limited before anything is unpacked, objects never are; and plain
values of what holds NumPy's numbers."""

import io
import math
import zipfile
import zlib
from pathlib import Path

import numpy as np

from .documents import short
from .errors import CastError, Faults
from .files import is_file

MAX_BYTES = 512 << 20  # of all arrays of a file
MAX_ARRAYS = 4096
_HEADER_BYTES = 1 << 16  # of one array; NumPy itself writes 128
_KINDS = "biufcU"  # truth values, numbers and text
_DAMAGED = (ValueError, OSError, EOFError, TypeError, SyntaxError, LookupError, ArithmeticError, MemoryError, RecursionError)
_DAMAGED += (zipfile.BadZipFile, zlib.error, RuntimeError)  # RuntimeError: locked by a password, or packed as nobody knows


def read(path: str | Path, limit: int = MAX_BYTES) -> dict[str, np.ndarray]:
    """The arrays of an .npz file, at most `limit` bytes in all. CastError says all that is wrong with it."""
    if not is_file(Path(path)):
        raise CastError(f"{path}: no such file")
    faults = Faults(str(path))
    try:
        with zipfile.ZipFile(path) as archive:
            members = _members(archive, faults, limit)
            faults.raise_if_any()
            arrays = {name: _array(archive, member, name, faults) for name, member in members.items()}
    except _DAMAGED as error:
        raise CastError(f"{path}: not a NumPy archive, or damaged: {' '.join(str(error).split())}") from None
    faults.raise_if_any()
    return arrays


def _members(archive: zipfile.ZipFile, faults: Faults, limit: int) -> dict[str, zipfile.ZipInfo]:
    entries = archive.infolist()
    if len(entries) > MAX_ARRAYS:
        faults.add("", f"got {len(entries)} arrays, limit {MAX_ARRAYS}")
        return {}
    size = sum(entry.file_size for entry in entries)
    if size > limit:
        faults.add("", f"got {size} bytes once unpacked, limit {limit} bytes")
    found: dict[str, zipfile.ZipInfo] = {}
    for entry in entries:
        name = entry.filename.removesuffix(".npy")
        if name == entry.filename or name in found:
            faults.add("", f"{short(entry.filename)}: {'stands twice' if name in found else 'not an array (.npy)'}")
        found[name] = entry
    return found


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, name: str, faults: Faults) -> np.ndarray | None:
    place = short(name)[1:-1]
    with archive.open(member) as file:
        head = io.BytesIO(file.read(min(member.file_size, _HEADER_BYTES)))
        try:
            version = np.lib.format.read_magic(head)
            read_header = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}[version[0]]
            shape, by_columns, kind = read_header(head)
        except _DAMAGED as error:
            faults.add(place, f"not an array: {' '.join(str(error).split())}")
            return None
        if kind.hasobject or kind.kind not in _KINDS:
            faults.add(place, f"got {'Python objects' if kind.hasobject else short(str(kind))}, needs numbers or text")
            return None
        size = math.prod(shape) * kind.itemsize
        rest = member.file_size - head.tell()
        if size != rest or min(shape, default=0) < 0:
            faults.add(place, f"got {rest} bytes, its shape {short(shape)} needs {size}")
            return None
        data = head.read() + file.read()
        if len(data) != size:  # an archive may promise more than it holds
            faults.add(place, f"got {len(data)} bytes, its shape {short(shape)} needs {size}")
            return None
    if size == 0:
        return np.zeros(shape, kind.newbyteorder("="))
    return np.frombuffer(data, kind).reshape(shape, order="F" if by_columns else "C").astype(kind.newbyteorder("="))


def plain_values(value):
    """Plain Python of what may hold NumPy's numbers and arrays, keys as text; null where a number is not finite."""
    if isinstance(value, dict):
        return {str(key): plain_values(one) for key, one in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain_values(one) for one in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return value
