# SPDX-License-Identifier: GPL-3.0-or-later
"""Series over time (throughput, SINR, path gain): CSV, JSON or Parquet files with `time_s` and one column or more."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.documents import is_number, json_file, listed, read_text, short
from ..core.errors import CastError, Faults
from ..core.files import write_text

MAX_STEPS = 10_000_000  # of a series cut into steps
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
    if (series.time_s[-1] - series.time_s[0]) / step_s > MAX_STEPS:
        raise CastError(f"{series.name}: step: got {step_s} s, limit {MAX_STEPS} steps over the series")
    place = np.floor((series.time_s - series.time_s[0]) / step_s + 1e-9).astype(int)
    count = np.bincount(place[known])
    total = np.bincount(place[known], series.value[known])
    full, steps = np.flatnonzero(count), np.arange(place[-1] + 1)
    value = np.interp(steps, full, total[full] / count[full])
    return Series(name=series.name, time_s=series.time_s[0] + step_s * steps, value=value)


def read(path: str | Path, column: str = "value") -> Series:
    """The `column` of a file by its suffix: .csv, .json (lists by name, or a list of objects) or .parquet (needs pyarrow)."""
    path = Path(path)
    readers = {".csv": _csv_columns, ".json": _json_columns, ".parquet": _parquet_columns}
    if path.suffix not in readers:
        raise CastError(f"{path}: got suffix {path.suffix!r}, needs one of {', '.join(readers)}")
    has, columns = readers[path.suffix](path, ("time_s", column))
    missing = [name for name in ("time_s", column) if name not in columns]
    if missing:
        raise CastError(f"{path}: no column {' and '.join(missing)}; has {listed(has)}")
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
    faults, out = Faults(str(path)), np.full(len(values), np.nan)
    for row, value in enumerate(values):
        if value is None or is_number(value):
            out[row] = np.nan if value is None else value
        else:
            faults.add(f"row {row + 1}: {name}", f"got {short(value)}, needs a number")
    faults.raise_if_any()
    return out


def _cell(text: str):
    """What a cell of a CSV file says: a number, nothing, or its text."""
    text = text.strip()
    try:
        return float(text) if text else None
    except ValueError:
        return text


def _csv_columns(path: Path, wanted: tuple[str, ...]) -> tuple[list, dict[str, list]]:
    """The names of all columns, and those `wanted`."""
    try:
        rows = [row for row in csv.reader(io.StringIO(read_text(path)), skipinitialspace=True) if row]
    except csv.Error as error:
        raise CastError(f"{path}: not CSV: {error}") from None
    if not rows:
        raise CastError(f"{path}: is empty, needs a header with time_s")
    head = [name.strip() for name in rows[0]]
    for number, row in enumerate(rows[1:], 1):
        if len(row) != len(head):
            raise CastError(f"{path}: row {number}: got {len(row)} cells, the header has {len(head)}")
    for name in wanted:
        if head.count(name) > 1:
            raise CastError(f"{path}: two columns are named {name}")
    return head, {name: [_cell(row[head.index(name)]) for row in rows[1:]] for name in wanted if name in head}


def _json_columns(path: Path, wanted: tuple[str, ...]) -> tuple[list, dict[str, list]]:
    get = json_file(path, kind=(dict, list))
    get.faults.raise_if_any()
    document = get.document
    if isinstance(document, list) and document and all(isinstance(row, dict) for row in document):
        return list(document[0]), {name: [row.get(name) for row in document] for name in wanted if name in document[0]}
    if isinstance(document, dict):
        has = [name for name, value in document.items() if isinstance(value, list)]
        return has, {name: document[name] for name in wanted if name in has}
    raise CastError(f'{path}: needs {{"time_s": […], "value": […]}} or a list of such objects')


def _parquet_columns(path: Path, wanted: tuple[str, ...]) -> tuple[list, dict[str, list]]:
    try:
        from pyarrow import ArrowException, parquet
    except ImportError as error:
        raise CastError(f"{path}: Parquet needs pyarrow, beside NumPy 1 'pyarrow<19' ({error}); or convert to CSV") from None
    try:
        has = parquet.read_schema(path).names
        return has, parquet.read_table(path, columns=[name for name in wanted if name in has]).to_pydict()
    except FileNotFoundError:
        raise CastError(f"{path}: no such file") from None
    except ArrowException as error:
        raise CastError(f"{path}: not Parquet: {error}") from None
