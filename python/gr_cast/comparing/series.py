# SPDX-License-Identifier: GPL-3.0-or-later
"""Series over time (throughput, SINR, path gain): CSV, JSON or Parquet files with `time_s` and one column or more."""

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.errors import CastError
from ..core.files import write_text

STEP_TOLERANCE = 0.01  # share of the mean step by which a time may be off its place in a uniform series


@dataclass(frozen=True, kw_only=True)
class Series:
    """`value` (n,) at `time_s` (n,), strictly ascending; NaN is a value that was not measured.

    Raises CastError for shapes that differ, fewer than two instants, times that do not ascend, or infinite values.
    """

    name: str
    time_s: np.ndarray
    value: np.ndarray

    def __post_init__(self):
        time_s, value = np.array(self.time_s, float), np.array(self.value, float)
        if time_s.ndim != 1 or time_s.shape != value.shape:
            raise CastError(f"{self.name}: got {time_s.shape} times and {value.shape} values, needs one value per time")
        if time_s.size < 2:
            raise CastError(f"{self.name}: got {time_s.size} samples, needs 2 or more")
        if not np.isfinite(time_s).all():
            raise CastError(f"{self.name}: time_s: sample {int(np.argmin(np.isfinite(time_s)))} is not a finite number of s")
        if (np.diff(time_s) <= 0).any():
            at = int(np.argmax(np.diff(time_s) <= 0))
            raise CastError(f"{self.name}: time_s: got {time_s[at + 1]:g} s after {time_s[at]:g} s, needs to ascend")
        if np.isinf(value).any():
            raise CastError(f"{self.name}: value at {time_s[np.argmax(np.isinf(value))]:g} s is infinite")
        object.__setattr__(self, "time_s", time_s)
        object.__setattr__(self, "value", value)

    @property
    def step_s(self) -> float:
        """Seconds between samples, on the average."""
        return float((self.time_s[-1] - self.time_s[0]) / (self.time_s.size - 1))

    @property
    def is_uniform(self) -> bool:
        place = self.time_s[0] + self.step_s * np.arange(self.time_s.size)
        return bool(np.max(np.abs(self.time_s - place)) <= STEP_TOLERANCE * self.step_s)


def resampled(series: Series, step_s: float) -> Series:
    """The mean of what was measured in each step of `step_s`, from the first time on; empty steps are interpolated linearly."""
    if not 0 < step_s < np.inf:
        raise CastError(f"{series.name}: step: got {step_s} s, needs a finite number above 0")
    known = ~np.isnan(series.value)
    if not known.any():
        raise CastError(f"{series.name}: holds no measured value")
    place = np.floor((series.time_s - series.time_s[0]) / step_s + 1e-9).astype(int)
    count = np.bincount(place[known], minlength=place[-1] + 1)
    total = np.bincount(place[known], series.value[known], minlength=place[-1] + 1)
    full, steps = np.flatnonzero(count), np.arange(place[-1] + 1)
    value = np.interp(steps, full, total[full] / count[full])
    return Series(name=series.name, time_s=series.time_s[0] + step_s * steps, value=value)


def read(path: str | Path, column: str = "value") -> Series:
    """The `column` of a file by its suffix: .csv, .json (lists by name, or a list of objects) or .parquet (needs pyarrow)."""
    path = Path(path)
    readers = {".csv": _csv_columns, ".json": _json_columns, ".parquet": _parquet_columns}
    if path.suffix not in readers:
        raise CastError(f"{path}: got suffix {path.suffix!r}, needs one of {', '.join(readers)}")
    columns = readers[path.suffix](path)
    missing = [name for name in ("time_s", column) if name not in columns]
    if missing:
        raise CastError(f"{path}: no column {' and '.join(missing)}; has {', '.join(columns) or 'none'}")
    numbers = {name: _numbers(path, name, columns[name]) for name in ("time_s", column)}
    return Series(name=str(path), time_s=numbers["time_s"], value=numbers[column])


def write_csv(path: str | Path, columns: dict) -> None:
    """Columns (n,) each, `time_s` among them, as CSV, whole or not at all; NaN is left empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow(["" if value != value else f"{value:.9g}" if isinstance(value, float) else value for value in row])
    write_text(path, text.getvalue())


def _numbers(path: Path, name: str, values) -> np.ndarray:
    """Floats of a column; an empty cell or null is NaN."""
    out = np.empty(len(values))
    for row, value in enumerate(values):
        try:
            out[row] = np.nan if value is None or value == "" else float(value)
        except (TypeError, ValueError):
            raise CastError(f"{path}: row {row + 1}: {name}: got {value!r}, needs a number") from None
    return out


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise CastError(f"{path}: no such file") from None
    except UnicodeDecodeError as error:
        raise CastError(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from None


def _csv_columns(path: Path) -> dict[str, list]:
    try:
        rows = [row for row in csv.reader(io.StringIO(_text(path)), skipinitialspace=True) if row]
    except csv.Error as error:
        raise CastError(f"{path}: not CSV: {error}") from None
    if not rows:
        raise CastError(f"{path}: is empty, needs a header with time_s")
    head = [name.strip() for name in rows[0]]
    for number, row in enumerate(rows[1:], 1):
        if len(row) != len(head):
            raise CastError(f"{path}: row {number}: got {len(row)} cells, the header has {len(head)}")
    return {name: [row[k].strip() for row in rows[1:]] for k, name in enumerate(head)}


def _json_columns(path: Path) -> dict[str, list]:
    try:
        document = json.loads(_text(path))
    except (json.JSONDecodeError, RecursionError) as error:
        raise CastError(f"{path}: not JSON: {error}") from None
    if isinstance(document, list) and document and all(isinstance(row, dict) for row in document):
        return {name: [row.get(name) for row in document] for name in document[0]}
    if isinstance(document, dict):
        return {name: value for name, value in document.items() if isinstance(value, list)}
    raise CastError(f'{path}: needs {{"time_s": […], "value": […]}} or a list of such objects')


def _parquet_columns(path: Path) -> dict[str, list]:
    try:
        from pyarrow import ArrowException, parquet
    except ImportError as error:
        raise CastError(f"{path}: Parquet needs pyarrow, beside NumPy 1 'pyarrow<19' ({error}); or convert to CSV") from None
    try:
        return parquet.read_table(path).to_pydict()
    except FileNotFoundError:
        raise CastError(f"{path}: no such file") from None
    except ArrowException as error:
        raise CastError(f"{path}: not Parquet: {error}") from None
