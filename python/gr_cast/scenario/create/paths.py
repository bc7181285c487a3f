# SPDX-License-Identifier: GPL-3.0-or-later
"""Parsing: traced tables to one time-variant channel per pair, h(t, tau) = sum_i c_i(t) delta(tau - tau_i(t)), on one clock."""

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.errors import CastError
from ...core.files import written_aside
from ..band import in_band_power
from .trace import Traced


@dataclass(frozen=True, kw_only=True)
class LinkPaths:
    """Paths of one link at the traced instants `time_s` (S,): delays, rates and gains (S, P), gain 0 where a path is absent.

    `gain` is without the phase of the delay. One instant: nothing moves.
    """

    time_s: np.ndarray
    delay_s: np.ndarray
    rate_before: np.ndarray
    rate_after: np.ndarray
    gain: np.ndarray


def batches(tables: list[Traced], pairs: int) -> list[list[Traced]]:
    """The tables in batches of so many `pairs`, for tasks of their own: in each all tables, with the rows of its pairs alone.
    Rows of a pair stay in order."""
    numbers = [table.tx.astype(np.int64) << 32 | table.rx for table in tables]
    starts = np.unique(np.concatenate([np.zeros(0, np.int64), *numbers]))[pairs::pairs]
    parts = []
    for table, number in zip(tables, numbers, strict=True):
        order = np.argsort(number, kind="stable")
        rows = np.split(order, np.searchsorted(number[order], starts))
        parts.append([Traced(**{name: values[part] for name, values in vars(table).items()}) for part in rows])
    return [list(batch) for batch in zip(*parts, strict=True)]


def by_link(tables: list[Traced], time_s: np.ndarray) -> dict[tuple[int, int], LinkPaths]:
    """Sort the tables of all instants by pair; a path is the same one as long as it meets the same surfaces in order."""
    rows: dict[tuple[int, int], dict] = {}
    for step, table in enumerate(tables):
        names = [tuple(row) for row in table.surfaces.tolist()]
        for index, (tx, rx) in enumerate(zip(table.tx.tolist(), table.rx.tolist(), strict=True)):
            rows.setdefault((tx, rx), {}).setdefault(names[index], []).append((step, index))
    links = {}
    for pair, paths in rows.items():
        values = {name: np.zeros((len(tables), len(paths))) for name in ("delay_s", "rate_before", "rate_after")}
        values["gain"] = np.zeros((len(tables), len(paths)), np.complex128)
        for column, name in enumerate(sorted(paths)):
            for step, index in paths[name]:
                for key, array in values.items():
                    # Two rays may meet the same planes (at the edge of two triangles): one path, the later row.
                    array[step, column] = getattr(tables[step], key)[index]
        links[pair] = LinkPaths(time_s=time_s, **values)
    return links


def at(link: LinkPaths, time_s: np.ndarray, carrier_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Delays and complex baseband coefficients (T, P) at any instants within the traced time.

    Between two traced instants a delay follows the cubic of both delays and both rates (Hermite). A path that is only at
    one of them is extrapolated by its rate and fades out, or in, on a straight line.
    """
    if len(link.time_s) == 1:
        shape = (len(time_s), link.gain.shape[1])
        delay_s = np.broadcast_to(link.delay_s, shape)
        return delay_s, np.broadcast_to(link.gain * np.exp(-2j * np.pi * carrier_hz * link.delay_s), shape)
    before = np.clip(np.searchsorted(link.time_s, time_s, side="right") - 1, 0, len(link.time_s) - 2)
    span_s = (link.time_s[before + 1] - link.time_s[before])[:, None]
    s = (time_s - link.time_s[before])[:, None] / span_s
    d0, d1 = link.delay_s[before], link.delay_s[before + 1]
    r0, r1 = link.rate_after[before] * span_s, link.rate_before[before + 1] * span_s
    g0, g1 = link.gain[before], link.gain[before + 1]
    cubic = d0 * (1 + 2 * s) * (1 - s) ** 2 + r0 * s * (1 - s) ** 2 + d1 * s**2 * (3 - 2 * s) + r1 * s**2 * (s - 1)
    delay_s = np.where(g0 == 0, d1 + r1 * (s - 1), np.where(g1 == 0, d0 + r0 * s, cubic))
    gain = (1 - s) * g0 + s * g1
    return delay_s, gain * np.exp(-2j * np.pi * carrier_hz * delay_s)


_COLUMNS = ("delay_s", "rate_before", "rate_after", "gain")


def write(path: str | Path, links: dict[tuple[int, int], LinkPaths]) -> None:
    """Paths of all links in one NumPy file: columns side by side, those of static links apart."""
    content: dict = {}
    for kind in ("static", "moving"):
        chosen = {pair: link for pair, link in links.items() if (len(link.time_s) == 1) == (kind == "static")}
        some = list(chosen.values())
        content[f"{kind}_pairs"] = np.array(list(chosen), np.int32).reshape(-1, 2)
        content[f"{kind}_ends"] = np.cumsum([link.gain.shape[1] for link in some], dtype=np.int64)
        content[f"{kind}_time_s"] = some[0].time_s if some else np.zeros(1)
        for name in _COLUMNS:
            parts = [getattr(link, name) for link in some]
            content[f"{kind}_{name}"] = np.concatenate(parts, axis=1) if parts else np.zeros((1, 0))
    with written_aside(path) as aside, open(aside, "wb") as file:
        np.savez_compressed(file, **content)


def read(path: str | Path) -> dict[tuple[int, int], LinkPaths]:
    """What `write` wrote. Raises CastError for a missing or damaged file."""
    links = {}
    try:
        with np.load(path, allow_pickle=False) as content:
            for kind in ("static", "moving"):
                columns = {name: content[f"{kind}_{name}"] for name in _COLUMNS}
                starts = np.concatenate([[0], content[f"{kind}_ends"]])
                for index, (tx, rx) in enumerate(content[f"{kind}_pairs"].tolist()):
                    part = slice(starts[index], starts[index + 1])
                    own = {name: values[:, part] for name, values in columns.items()}
                    links[tx, rx] = LinkPaths(time_s=content[f"{kind}_time_s"], **own)
    except FileNotFoundError:
        raise CastError(f"{path}: no such file") from None
    except (ValueError, KeyError, IndexError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise CastError(f"{path}: damaged: {error}") from None
    return links


def births_and_deaths(link: LinkPaths) -> int:
    """How many paths appear or vanish between traced instants."""
    present = link.gain != 0
    return int((present[1:] != present[:-1]).sum())


def difference_db(a: tuple, b: tuple, bandwidth_hz: float) -> np.ndarray:
    """Energy of the difference of two channels (delays and coefficients, (T, P)) over that of the first, in the band, dB."""
    delay_s, gain = np.concatenate([a[0], b[0]], axis=1), np.concatenate([a[1], -b[1]], axis=1)
    floor = np.finfo(float).tiny
    error = in_band_power(delay_s, gain, bandwidth_hz) / np.maximum(in_band_power(*a, bandwidth_hz), floor)
    return 10 * np.log10(np.maximum(error, floor))


def interpolation_error_db(
    links: dict[tuple[int, int], LinkPaths], checks: list[Traced], checks_s: np.ndarray, carrier_hz: float, bandwidth_hz: float
) -> list[float]:
    """Error of the links at instants that were traced for it alone, dB in the band: one per check and link in both."""
    errors_db = []
    for time_s, table in zip(checks_s, checks, strict=True):
        for pair, traced in by_link([table], np.zeros(1)).items():
            if pair in links:
                truth, guess = at(traced, np.zeros(1), carrier_hz), at(links[pair], np.array([time_s]), carrier_hz)
                errors_db += difference_db(truth, guess, bandwidth_hz).tolist()
    return errors_db
