# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings: SigMF files and raw samples, read with all faults at once and written whole or not at all.

Samples are complex64 with full scale 1.0. SigMF: https://sigmf.org, version 1.0.0.
"""

import hashlib
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .. import __version__
from ..core.documents import is_number, json_file, short
from ..core.errors import CastError, Faults
from ..core.files import write_json, written_aside

# SigMF datatype → (NumPy type of one I or Q, value of zero, full scale).
DATATYPES = {
    "cf32_le": ("<f4", 0.0, 1.0),
    "ci16_le": ("<i2", 0.0, 32768.0),
    "ci8": ("i1", 0.0, 128.0),
    "cu8": ("u1", 127.5, 128.0),
}
RAW_FORMATS = {"cf32": "cf32_le", "ci16": "ci16_le", "ci8": "ci8", "cu8": "cu8"}
_DOUBTED = 1e-3  # share of samples that are no numbers, beyond which they may be of another datatype
MAX_RATE_HZ = 1e15  # of samples: beyond any, and still a number with all that is worked out of it
EXTENSION = {"name": "cast", "version": __version__, "optional": True}  # the cast: fields explain, a reader may skip them


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Samples (n,) complex64 with what is known of how they were taken. Captures and annotations are SigMF objects."""

    samples: np.ndarray
    sample_rate_hz: float | None
    center_frequency_hz: float | None = None
    datatype: str = "cf32_le"
    captures: tuple[dict, ...] = ()
    annotations: tuple[dict, ...] = ()
    metadata: dict = field(default_factory=dict)  # the SigMF global object

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """(sample index, samples lost just before it) of every capture that follows a gap."""
        return [(c["core:sample_start"], c["cast:lost_samples"]) for c in self.captures if c.get("cast:lost_samples")]


def stem_of(path: str | Path) -> Path:
    """The path without .sigmf-meta or .sigmf-data, whichever of the three forms a user gives."""
    path = Path(path)
    return path.with_suffix("") if path.suffix in (".sigmf-meta", ".sigmf-data") else path


def meta_path(path: str | Path) -> Path:
    stem = stem_of(path)
    return stem.with_name(stem.name + ".sigmf-meta")


def data_path(path: str | Path) -> Path:
    stem = stem_of(path)
    return stem.with_name(stem.name + ".sigmf-data")


def _is_count(value) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def read_metadata(path: str | Path) -> dict:
    """The SigMF metadata of a recording, checked: `global`, `captures` and `annotations` are there and of their types."""
    meta = meta_path(path)
    get = json_file(meta, missing=" (a SigMF recording is a pair .sigmf-meta and .sigmf-data)")
    document, faults = get.document, get.faults
    if "global" not in document:
        faults.add("global", "missing, needs a JSON object")
    _check_global(get.mapping(document.get("global", {}), "global"), faults)
    for section in ("captures", "annotations"):
        entries = document.setdefault(section, [])
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            faults.add(section, f"got {type(entries).__name__}, needs a list of objects")
            continue
        starts = [entry.get("core:sample_start") for entry in entries]
        if not all(_is_count(start) for start in starts):
            faults.add(section, "core:sample_start: needs a whole number of samples, 0 or more, in every entry")
        elif starts != sorted(starts):
            faults.add(section, "core:sample_start: needs to be in ascending order")
    if not faults:
        for index, capture in enumerate(document["captures"]):
            frequency = capture.get("core:frequency")
            if frequency is not None:
                get.number(frequency, f"captures[{index}]: core:frequency", "Hz")
            if not _is_count(capture.get("core:header_bytes", 0)) or capture.get("core:header_bytes", 0):
                faults.add(f"captures[{index}]", "core:header_bytes: files with headers inside are not supported")
            if not _is_count(capture.get("cast:lost_samples", 0)):
                faults.add(f"captures[{index}]", "cast:lost_samples: needs a whole number of samples, 0 or more")
    faults.raise_if_any()
    return document


def _check_global(fields: dict, faults: Faults) -> None:
    datatype = fields.get("core:datatype")
    if not isinstance(datatype, str) or datatype not in DATATYPES:
        faults.add("core:datatype", f"got {short(datatype)}, needs one of {', '.join(DATATYPES)}")
    rate = fields.get("core:sample_rate")
    if rate is not None and not (is_number(rate) and 0 < rate < MAX_RATE_HZ):
        faults.add("core:sample_rate", f"got {short(rate)}, needs a finite number of Hz above 0")
    if fields.get("core:num_channels", 1) != 1:
        faults.add("core:num_channels", f"got {short(fields['core:num_channels'])}, needs 1: one channel per file")
    if fields.get("core:metadata_only"):
        faults.add("core:metadata_only", "the recording holds no samples")


def to_complex(raw: np.ndarray, datatype: str) -> np.ndarray:
    """Interleaved I and Q of `datatype`, shape (2n,), as complex64 of full scale 1.0, shape (n,)."""
    _, zero, full_scale = DATATYPES[datatype]
    if datatype == "cf32_le":
        return np.array(raw, np.float32).view(np.complex64)
    return ((raw.astype(np.float32) - np.float32(zero)) / np.float32(full_scale)).view(np.complex64)


@dataclass(frozen=True, kw_only=True)
class Stored:
    """The samples of a file too long for the memory: a slice of it is read, as complex64 of full scale 1.0."""

    path: Path
    datatype: str
    count: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, span: slice) -> np.ndarray:
        start, stop, _ = span.indices(self.count)
        item = np.dtype(DATATYPES[self.datatype][0])
        raw = np.fromfile(self.path, item, 2 * max(0, stop - start), offset=2 * item.itemsize * start)
        return to_complex(raw, self.datatype)

    def __array__(self, dtype=None) -> np.ndarray:
        return np.asarray(self[:], dtype)


def pieces(samples, size: int = 1 << 20):
    """The samples in order, `size` of them at a time."""
    for start in range(0, len(samples), size):
        yield samples[start : start + size]


def _count_samples(path: Path, datatype: str) -> int:
    try:
        size = path.stat().st_size
    except FileNotFoundError:
        raise CastError(f"{path}: no such file") from None
    if not path.is_file():
        raise CastError(f"{path}: not a file")
    item = np.dtype(DATATYPES[datatype][0])
    total, rest = divmod(size, 2 * item.itemsize)
    if rest:
        raise CastError(
            f"{path}: truncated: {size} bytes is not a whole number of {datatype} samples ({2 * item.itemsize} bytes)"
        )
    if total == 0:
        raise CastError(f"{path}: holds no samples")
    return total


def _read_samples(path: Path, datatype: str, start: int, count: int | None, allow_nan: bool, longest=None):
    total = _count_samples(path, datatype)
    if start >= total:
        raise CastError(f"{path}: start: got sample {start}, the file holds {total} samples")
    stop = total if count is None else min(total, start + count)
    samples = Stored(path=path, datatype=datatype, count=total)
    if longest is None or stop - start <= longest:
        samples = samples[start:stop]
    if datatype == "cf32_le":
        bad, first, at = 0, None, start
        for piece in pieces(samples):
            wrong = np.isinf(piece) if allow_nan else ~np.isfinite(piece)
            if first is None and wrong.any():
                first = at + int(np.argmax(wrong))
            bad, at = bad + int(wrong.sum()), at + len(piece)
        if bad:
            doubt = ": is core:datatype right?" if bad > _DOUBTED * (stop - start) else ""
            raise CastError(f"{path}: {bad} of {stop - start} samples are NaN or infinite, the first at index {first}{doubt}")
    return samples


def sha512_of(path: Path) -> str:
    """Hexadecimal SHA-512 of a file, read in pieces."""
    digest = hashlib.sha512()
    with open(path, "rb") as file:
        while chunk := file.read(1 << 22):
            digest.update(chunk)
    return digest.hexdigest()


def _check_whole(path: Path, fields: dict) -> None:
    """Refuse a file whose content is not the one that the metadata vouches for (cut, or changed)."""
    expected = fields.get("core:sha512")
    if expected is None:
        return
    count = _count_samples(path, fields["core:datatype"])
    if sha512_of(path) != str(expected).lower():
        raise CastError(
            f"{path}: truncated or changed: holds {count} samples ({path.stat().st_size} bytes), and its SHA-512 is not the "
            "core:sha512 of the metadata"
        )


def read(
    path: str | Path, *, start: int = 0, count: int | None = None, allow_nan: bool = False, longest: int | None = None
) -> Recording:
    """Read a SigMF recording by its stem, .sigmf-meta or .sigmf-data path.

    `start` and `count` (samples) read a part; `allow_nan` lets NaN stand for unknown samples of a waveform. The samples
    of a whole file with more than `longest` are checked and stay on disk (`Stored`).
    Raises CastError with every fault of the metadata, or for missing, truncated, empty or non-finite data.
    """
    document = read_metadata(path)
    fields = document["global"]
    data = data_path(path)
    _check_whole(data, fields)
    samples = _read_samples(data, fields["core:datatype"], start, count, allow_nan, longest)
    captures = document["captures"]
    beyond = [c["core:sample_start"] for c in captures if c["core:sample_start"] >= start + len(samples) and count is None]
    if beyond:
        raise CastError(f"{data}: truncated: holds {start + len(samples)} samples, a capture starts at {beyond[0]}")
    frequency = next((c["core:frequency"] for c in captures if c.get("core:frequency") is not None), None)
    return Recording(
        samples=samples,
        sample_rate_hz=fields.get("core:sample_rate"),
        center_frequency_hz=frequency,
        datatype=fields["core:datatype"],
        captures=tuple(captures),
        annotations=tuple(document["annotations"]),
        metadata=fields,
    )


def read_raw(path: str | Path, *, raw_format: str, sample_rate_hz: float) -> Recording:
    """Read a file of bare interleaved samples, `raw_format` one of cf32, ci16, ci8, cu8 (little endian)."""
    if raw_format not in RAW_FORMATS:
        raise CastError(f"{path}: format: got {raw_format!r}, needs one of {', '.join(RAW_FORMATS)}")
    if not (math.isfinite(sample_rate_hz) and sample_rate_hz > 0):
        raise CastError(f"{path}: rate: got {sample_rate_hz} Hz, needs a finite number above 0")
    datatype = RAW_FORMATS[raw_format]
    samples = _read_samples(Path(path), datatype, 0, None, allow_nan=False)
    return Recording(samples=samples, sample_rate_hz=float(sample_rate_hz), datatype=datatype)


def metadata(
    *,
    sample_rate_hz: float,
    center_frequency_hz: float | None = None,
    datatype: str = "cf32_le",
    captures=(),
    annotations=(),
    fields: dict | None = None,
) -> dict:
    """A SigMF metadata document; `fields` go into its global object (core:…, cast:…)."""
    first = {"core:sample_start": 0}
    if center_frequency_hz is not None:
        first["core:frequency"] = center_frequency_hz
    head = {
        "core:datatype": datatype,
        "core:sample_rate": sample_rate_hz,
        "core:version": "1.0.0",
        "core:recorder": f"gr-cast {__version__}",
        "core:extensions": [EXTENSION],
    }
    return {
        "global": head | (fields or {}),
        "captures": list(captures) or [first],
        "annotations": list(annotations),
    }


def write_metadata(path: str | Path, document: dict) -> None:
    """Write the .sigmf-meta of a recording, whole or not at all."""
    write_json(meta_path(path), document)


def to_raw(samples: np.ndarray, datatype: str) -> np.ndarray:
    """complex64 of full scale 1.0 as interleaved I and Q of `datatype`; integers are rounded and saturate."""
    kind, zero, full_scale = DATATYPES[datatype]
    interleaved = np.ascontiguousarray(samples, np.complex64).view(np.float32)
    if datatype == "cf32_le":
        return interleaved.astype(kind)
    limits = np.iinfo(np.dtype(kind))
    return np.clip(np.rint(interleaved * full_scale + zero), limits.min, limits.max).astype(kind)


def write_stream(path: str | Path, chunks, *, sample_rate_hz: float, **about) -> Path:
    """`write` of chunks of samples, (n,) complex each, that need not fit in memory together."""
    digest = hashlib.sha512()
    document = metadata(sample_rate_hz=sample_rate_hz, **about)
    with written_aside(data_path(path)) as aside:
        with open(aside, "wb") as file:
            for chunk in chunks:
                raw = to_raw(chunk, "cf32_le").tobytes()
                digest.update(raw)
                file.write(raw)
    document["global"]["core:sha512"] = digest.hexdigest()
    write_metadata(path, document)
    return stem_of(path)


def write(path: str | Path, samples: np.ndarray, *, sample_rate_hz: float, datatype: str = "cf32_le", **about) -> Path:
    """Write samples (n,) complex as a SigMF pair with its SHA-512, whole or not at all; returns the stem.

    `about` holds `center_frequency_hz`, `captures`, `annotations` and `fields` of `metadata`.
    """
    if datatype not in DATATYPES:
        raise CastError(f"{path}: datatype: got {datatype!r}, needs one of {', '.join(DATATYPES)}")
    raw = to_raw(samples, datatype).tobytes()
    document = metadata(sample_rate_hz=sample_rate_hz, datatype=datatype, **about)
    document["global"]["core:sha512"] = hashlib.sha512(raw).hexdigest()
    with written_aside(data_path(path)) as aside:
        aside.write_bytes(raw)
    write_metadata(path, document)
    return stem_of(path)


def write_recording(path: str | Path, recorded: Recording) -> Path:
    """`write` of a Recording with all that it knows, so that `read` gives it back; returns the stem."""
    if recorded.sample_rate_hz is None:
        raise CastError(f"{path}: sample rate: got none, needs one to be written")
    own = ("core:datatype", "core:sample_rate", "core:version", "core:recorder", "core:extensions", "core:sha512")
    return write(
        path, recorded.samples, sample_rate_hz=recorded.sample_rate_hz, datatype=recorded.datatype,
        center_frequency_hz=recorded.center_frequency_hz, captures=recorded.captures, annotations=recorded.annotations,
        fields={key: value for key, value in recorded.metadata.items() if key not in own},
    )  # fmt: skip
