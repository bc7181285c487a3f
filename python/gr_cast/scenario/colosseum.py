# SPDX-License-Identifier: GPL-3.0-or-later
"""Colosseum's scenario files: `.mat` with chMatrix, time, coordinates and origin; radio maps and node maps.

Source: Colosseum user documentation, "New Scenario File Format Requirements". Nodes are numbered from 1; chMatrix has
the transmitter in its row. Two forms: a cell array N x N x T of structs with delay[4] (s) and iq[4], `time` in ms; or,
without mobility, an N x N matrix of path gains in dB, which the hardware plays as one tap at 1 ns.
"""

import re
from pathlib import Path

import numpy as np

from ..core.documents import Reader, json_file, short
from ..core.errors import CastError, Faults
from ..core.files import write_json, written_aside
from ..core.units import amplitude_from_db, db_from_amplitude
from . import mat_file
from .model import GRID_STEP_S, MAX_DELAY_S, MAX_NODES, LinkTaps, Scenario, link_name, taps_at

MAX_TAPS = 4
MIN_GAIN_DB, MAX_GAIN_DB = -43.0, 0.0
DEFAULT_DELAY_S = 1e-9  # of a tap that a file leaves alone, and of the static form
UPDATE_MS = 1
MAX_SRN = 128
MAX_CELLS = 1_000_000  # half a minute to write, some hundred megabytes
_ROOM_DB, _ROOM_S = 1e-6, 5e-13  # for decimal limits that binary numbers cannot hold


def read(path: str | Path) -> Scenario:
    """Read a scenario from a `.mat` file, either form; taps are held between instants, as the hardware does.

    A tap with iq 0 is unused. A tap of exactly 1 ns and 1+0j after the first is the format's filler and unused too.
    Raises CastError with every fault: file, link, tap, value and limit.
    """
    path = Path(path)
    content = mat_file.read(path)
    if "chMatrix" not in content:
        raise CastError(f"{path}: chMatrix: missing, the file holds {', '.join(content) or 'no variables'}")
    matrix, faults = content["chMatrix"], Faults(str(path))
    if not isinstance(matrix, np.ndarray) or matrix.ndim not in (2, 3) or matrix.shape[0] != matrix.shape[1] or not matrix.size:
        raise CastError(f"{path}: chMatrix: got shape {np.shape(matrix)}, needs N x N x T cells or N x N path gains in dB")
    if matrix.shape[0] > MAX_NODES:
        raise CastError(f"{path}: chMatrix: got {matrix.shape[0]} nodes, limit {MAX_NODES}")
    if matrix.dtype == object:
        delay_s, iq = _cells(matrix.reshape(*matrix.shape[:2], -1), faults)
    else:
        delay_s, iq = _path_gains(matrix, faults)
    instants = delay_s.shape[2]
    time_s = _clock(content.get("time"), instants, faults)
    place = _coordinates(content.get("coordinates"), delay_s.shape[0], instants, faults)
    if not faults:
        _check_limits(delay_s, iq, lambda index: f"at {1e3 * time_s[index]:g} ms" if instants > 1 else "", faults)
    faults.raise_if_any()
    nodes = tuple(str(index + 1) for index in range(delay_s.shape[0]))
    if instants > 1 and time_s.size == instants + 1:  # the last values stay until the whole second
        delay_s, iq = (np.concatenate([value, value[:, :, -1:]], axis=2) for value in (delay_s, iq))
        place = np.concatenate([place, place[-1:]]) if place is not None and len(place) > 1 else place
    links = {}
    for (row, tx), (column, rx) in ((a, b) for a in enumerate(nodes) for b in enumerate(nodes)):
        if (iq[row, column] != 0).any():
            links[tx, rx] = _link(delay_s[row, column], iq[row, column])
    return Scenario(
        name=path.stem,
        description=_origin_text(content.get("origin")),
        nodes=nodes,
        links=links,
        time_s=time_s if instants > 1 else np.zeros(1),
        position_m={} if place is None else {node: place[:, index] for index, node in enumerate(nodes)},
    )


def _cells(matrix: np.ndarray, faults: Faults) -> tuple[np.ndarray, np.ndarray]:
    """Delays and iq (N, N, T, 4) from an array of cells; unused taps have iq 0."""
    delay_s = np.zeros((*matrix.shape, MAX_TAPS))
    iq = np.zeros((*matrix.shape, MAX_TAPS), np.complex128)
    for place in np.ndindex(matrix.shape):
        taps, where = _struct(matrix[place]), f"chMatrix{{{place[0] + 1},{place[1] + 1},{place[2] + 1}}}"
        if taps is None:
            faults.add(where, "needs a struct with delay and iq; for no link, iq is 0")
            continue
        numbers = [np.asarray(value).ravel() for value in taps]
        if any(value.dtype.kind not in "iufc" for value in numbers) or np.iscomplexobj(numbers[0]):
            faults.add(where, "needs numbers: delay real, in s, and iq")
        elif not 1 <= numbers[0].size <= MAX_TAPS or numbers[0].size != numbers[1].size:
            faults.add(
                where,
                f"got {numbers[0].size} delays and {numbers[1].size} iq, needs as many of each, limit {MAX_TAPS} taps",
            )
        else:
            delay_s[place][: numbers[0].size] = numbers[0]
            iq[place][: numbers[1].size] = numbers[1]
    filler = (delay_s == DEFAULT_DELAY_S) & (iq == 1)
    filler[..., 0] = False
    iq[filler] = 0
    return delay_s, iq


def _struct(cell) -> tuple | None:
    """(delay, iq) of a cell that holds a struct, or a struct with the field `tap` that holds it."""
    if isinstance(cell, dict) and "tap" in cell:
        cell = cell["tap"]
    return (cell["delay"], cell["iq"]) if isinstance(cell, dict) and {"delay", "iq"} <= cell.keys() else None


def _path_gains(matrix: np.ndarray, faults: Faults) -> tuple[np.ndarray, np.ndarray]:
    """The static form as taps (N, N, 1, 1): one tap at 1 ns; -Inf dB is no link."""
    if matrix.ndim != 2 or matrix.dtype.kind not in "iuf":
        faults.add("chMatrix", f"got {matrix.ndim} dimensions of {matrix.dtype}, needs N x N real path gains in dB")
        return np.zeros((1, 1, 1, 1)), np.zeros((1, 1, 1, 1), np.complex128)
    with np.errstate(over="ignore"):
        gain = amplitude_from_db(matrix.astype(np.float64))[..., None, None]
    return np.full(gain.shape, DEFAULT_DELAY_S), gain.astype(np.complex128)


def _clock(time, instants: int, faults: Faults) -> np.ndarray:
    """Seconds of every instant, up to the whole second that the format wants at the end."""
    if instants == 1:
        return np.zeros(1)
    time = np.array([0.0, 1000.0]) if time is None else np.asarray(time).ravel()
    if time.dtype.kind not in "iuf" or time.size != instants:
        faults.add("time", f"got {time.size} values of {time.dtype}, chMatrix has {instants} instants in ms")
        return np.zeros(instants)
    time = time.astype(np.float64)
    if not np.isfinite(time).all() or time[0] != 0 or (np.diff(time) < UPDATE_MS).any() or (time != np.rint(time)).any():
        faults.add("time", f"needs whole ms that ascend from 0, smallest step {UPDATE_MS} ms")
        return np.zeros(instants)
    end = 1000.0 * np.ceil(time[-1] / 1000.0)
    return (time if time[-1] == end else np.append(time, end)) / 1e3


def _coordinates(coordinates, nodes: int, instants: int, faults: Faults) -> np.ndarray | None:
    """(T, N, 3) metres from N x 3 x T, or None."""
    if coordinates is None:
        return None
    place = np.asarray(coordinates)
    place = place[..., None] if place.ndim == 2 else place
    if place.dtype.kind not in "iuf" or place.ndim != 3 or place.shape[:2] != (nodes, 3) or place.shape[2] not in (1, instants):
        faults.add("coordinates", f"got shape {place.shape}, needs {nodes} x 3 x {instants} metres")
        return None
    if not np.isfinite(place).all():
        faults.add("coordinates", "holds NaN or infinite metres")
    return np.moveaxis(place.astype(np.float64), 2, 0)


def _origin_text(origin) -> str:
    values = [origin.get(name) for name in ("long", "lat")] if isinstance(origin, dict) else []
    if not values or any(
        not isinstance(value, np.ndarray) or value.size != 1 or value.dtype.kind not in "iuf" for value in values
    ):
        return ""
    return f"origin.long {values[0].item():g}, origin.lat {values[1].item():g}"


def weak_taps(scenario: Scenario) -> list[str]:
    """A line for every link with taps below the documented −43 dB, which the files of some of Colosseum's own scenarios hold."""
    lines = []
    for key, taps in scenario.links.items():
        weakest_db = db_from_amplitude(taps.gain[taps.gain != 0]).min(initial=0.0)
        if weakest_db < MIN_GAIN_DB - _ROOM_DB:
            lines.append(
                f"link {link_name(key)}: got a tap of {weakest_db:.2f} dB, documented are {MIN_GAIN_DB:g} to {MAX_GAIN_DB:g} dB"
            )
    return lines


def _check_limits(delay_s: np.ndarray, iq: np.ndarray, when, faults: Faults) -> None:
    """A fault for every tap (N, N, T, P) past Colosseum's limits, named once with its first instant."""
    used = iq != 0
    gain_db = db_from_amplitude(iq)
    bad = {
        "delay": used & ~((delay_s >= -_ROOM_S) & (delay_s <= MAX_DELAY_S + _ROOM_S)),
        "iq": used & ~(gain_db <= MAX_GAIN_DB + _ROOM_DB),
    }
    for what, wrong in bad.items():
        for row, column, tap in np.argwhere(wrong.any(axis=2)):
            instants = np.flatnonzero(wrong[row, column, :, tap])
            place = (row, column, instants[0], tap)
            more = f" (and {instants.size - 1} more instants)" if instants.size > 1 else ""
            if what == "delay":
                index = float(delay_s[place]) / GRID_STEP_S  # a float of Python overflows to infinity without a word
                got = f"delay: got {delay_s[place]:.4g} s (tap index {index:.0f} on the 10 ns grid)"
                limit = f"0 to {MAX_DELAY_S * 1e6:.2f} us"
            else:
                got = f"iq: got {iq[place]:.4g}, {gain_db[place]:.2f} dB"
                limit = f"{MAX_GAIN_DB:g} dB"
            faults.add(
                f"link {row + 1}>{column + 1}: tap {tap + 1}",
                f"{got} {when(instants[0])}{more}, limit {limit}".replace("  ", " "),
            )


def _link(delay_s: np.ndarray, iq: np.ndarray) -> LinkTaps:
    """Taps (T, 4) without columns that are never used, and as one instant where nothing changes."""
    used = (iq != 0).any(axis=0)
    delay_s, iq = delay_s[:, used], iq[:, used]
    same = (iq == iq[:1]).all() and (delay_s == delay_s[:1]).all()
    return LinkTaps(delay_s=delay_s[:1] if same else delay_s, gain=iq[:1] if same else iq)


def write(path: str | Path, scenario: Scenario, *, form: str = "taps") -> None:
    """Write a scenario as Colosseum's `.mat`, whole or not at all; base losses belong to the set-up and stay out.

    `form` is "taps" (cells over time) or "static" (N x N path gains in dB; every link must be one constant tap of
    phase 0 within the first 10 ns). Linear interpolation is written out at 1 ms. Raises CastError with every fault.
    """
    from scipy.io import savemat  # here: programs that write none begin a twelfth of a second earlier

    path, faults = Path(path), Faults(str(path))
    content = _static_content(scenario, faults) if form == "static" else _taps_content(scenario, faults)
    faults.raise_if_any()
    with written_aside(path) as aside:
        with open(aside, "wb") as file:  # SciPy hides why a name cannot be written to
            savemat(file, content, do_compression=True)


def _static_content(scenario: Scenario, faults: Faults) -> dict:
    index = {node: place for place, node in enumerate(scenario.nodes)}
    gain = np.zeros((len(index),) * 2, np.complex128)
    for key, taps in scenario.links.items():
        used = (taps.gain != 0).any(axis=0)
        if used.sum() > 1 or (taps.gain != taps.gain[:1]).any() or (taps.delay_s > 0.5 * GRID_STEP_S)[taps.gain != 0].any():
            faults.add(f"link {link_name(key)}", "the static form holds one constant tap at 1 ns and nothing else")
        elif used.any():
            gain[index[key[0]], index[key[1]]] = taps.gain[0, used][0]
            if abs(np.angle(taps.gain[0, used][0])) > 1e-9:
                faults.add(f"link {link_name(key)}", "the static form holds gains without a phase")
    _check_limits(np.zeros((*gain.shape, 1, 1)), gain[..., None, None], lambda _: "", faults)
    return {"chMatrix": np.minimum(db_from_amplitude(gain), MAX_GAIN_DB)}


def _taps_content(scenario: Scenario, faults: Faults) -> dict:
    time_ms, samples = _instants(scenario, faults)
    nodes = len(scenario.nodes)
    if nodes**2 * time_ms.size > MAX_CELLS:
        faults.add("chMatrix", f"got {nodes**2 * time_ms.size} cells, limit {MAX_CELLS}: write it in coarser steps")
        return {}
    index = {node: place for place, node in enumerate(scenario.nodes)}
    delay_s = np.zeros((nodes, nodes, time_ms.size, MAX_TAPS))
    iq = np.zeros(delay_s.shape, np.complex128)
    for key in scenario.links:
        delay, gain = taps_at(scenario, key, samples)
        most = int((gain != 0).sum(axis=1).max())
        if most > MAX_TAPS:
            faults.add(f"link {link_name(key)}", f"got {most} taps, limit {MAX_TAPS}")
            continue
        order = np.argsort(gain == 0, axis=1, kind="stable")[:, :MAX_TAPS]  # used taps first
        kept = np.take_along_axis(gain, order, axis=1)
        place = (index[key[0]], index[key[1]], slice(None), slice(0, kept.shape[1]))
        iq[place] = kept
        delay_s[place] = np.where(kept != 0, np.take_along_axis(delay, order, axis=1), 0.0)
    _check_limits(delay_s, iq, lambda at: f"at {time_ms[at]:g} ms", faults)
    if faults:
        return {}
    cells = np.empty(iq.shape[:3], object)
    for place in np.ndindex(cells.shape):
        cells[place] = {"delay": delay_s[place][None], "iq": iq[place][None]}
    content = {"chMatrix": cells, "time": time_ms[None]}
    if set(scenario.position_m) == set(scenario.nodes):
        rows = np.clip(np.searchsorted(scenario.time_s, samples + 1e-9, side="right") - 1, 0, None)
        tracks = [np.asarray(scenario.position_m[node]) for node in scenario.nodes]
        content["coordinates"] = np.stack([track[np.minimum(rows, len(track) - 1)].T for track in tracks])
    return content


def _instants(scenario: Scenario, faults: Faults) -> tuple[np.ndarray, np.ndarray]:
    """Instants to write, in ms, and the time in s at which the scenario is sampled for each."""
    if scenario.is_static:
        return np.array([0.0, 1000.0]), np.zeros(2)
    time_ms = 1e3 * scenario.time_s
    if np.abs(time_ms - np.rint(time_ms)).max() > 1e-6:
        faults.add("time", f"the format holds whole ms, the scenario's smallest step is {np.diff(time_ms).min():g} ms")
    time_ms = np.rint(time_ms)
    if scenario.interpolation == "linear":
        time_ms = np.arange(time_ms[-1] + 1)
    end = 1000.0 * np.ceil(time_ms[-1] / 1000.0)
    full = time_ms if time_ms[-1] == end else np.append(time_ms, end)
    return full, np.minimum(
        full / 1e3, scenario.time_s[-1]
    ) + 1e-9  # a hair later, so that rounding never holds the instant before


def _map_of_nodes(path: str | Path) -> Reader:
    get = json_file(path)
    if not get.document:
        get.faults.add("", "needs a JSON object with at least one node")
    return get


def _is_number_to(value, high: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= high


def read_radio_map(path: str | Path) -> dict[str, dict[str, int] | None]:
    """A radio map: node ("1") to {"SRN", "RadioA", "RadioB"}, or None for a node without a radio.

    The file: {"Node 1": {"SRN": 1, "RadioA": 1, "RadioB": 2}, "Node 5": "None"}. CastError with every fault.
    """
    get = _map_of_nodes(path)
    faults, radios, taken = get.faults, {}, {}
    for name, entry in get.document.items():
        match = re.fullmatch(r"Node ([1-9][0-9]{0,3})", name)
        if not match:
            faults.add(name, 'needs the form "Node 1"')
        elif entry == "None":
            radios[match[1]] = None
        elif not isinstance(entry, dict) or set(entry) != {"SRN", "RadioA", "RadioB"}:
            faults.add(name, f'got {short(entry)}, needs SRN, RadioA and RadioB, or "None"')
        elif not (
            _is_number_to(entry["SRN"], MAX_SRN) and all(_is_number_to(entry[end], 2 * MAX_SRN) for end in ("RadioA", "RadioB"))
        ):
            faults.add(name, f"got {short(entry)}, needs whole numbers: SRN 1 to {MAX_SRN}, radios 1 to {2 * MAX_SRN}")
        elif entry["SRN"] in taken:
            faults.add(name, f"SRN {entry['SRN']} serves {taken[entry['SRN']]} already")
        else:
            radios[match[1]], taken[entry["SRN"]] = entry, name
    faults.raise_if_any()
    return radios


def write_radio_map(path: str | Path, radios: dict[str, dict[str, int] | None]) -> None:
    document = {f"Node {node}": "None" if entry is None else entry for node, entry in radios.items()}
    write_json(path, document)


def read_node_map(path: str | Path) -> dict[str, int]:
    """A node map, {"1": 1, "2": 45}: scenario node to SRN, each SRN once. CastError with every fault."""
    get = _map_of_nodes(path)
    faults, document, taken = get.faults, get.document, {}
    for node, srn in document.items():
        if not re.fullmatch(r"[1-9][0-9]{0,3}", node):
            faults.add(node, "needs a node number from 1")
        if not _is_number_to(srn, MAX_SRN):
            faults.add(node, f"got {short(srn)}, needs an SRN from 1 to {MAX_SRN}")
        elif srn in taken:
            faults.add(node, f"SRN {srn} serves node {taken[srn]} already")
        else:
            taken[srn] = node
    faults.raise_if_any()
    return document


def write_node_map(path: str | Path, srn_of: dict[str, int]) -> None:
    write_json(path, srn_of)
