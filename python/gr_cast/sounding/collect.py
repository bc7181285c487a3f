# SPDX-License-Identifier: GPL-3.0-or-later
"""Soundings of many links to one campaign of a place case: responses over frequency, and how well they are known."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.documents import Reader, json_file
from ..core.errors import CastError, Faults
from ..core.files import written_aside
from ..core.units import amplitude_from_db, power_from_db
from .cir import DB_PER_NEPER

FREQUENCIES = 64
_LEAST_NOISE = 1e-12  # of a response's power: single precision knows no entry better
_TAP = {"delay_s": "s", "gain_db": "dB", "phase_rad": "rad", "delay_std_s": "s", "gain_std_db": "dB", "phase_std_rad": "rad"}


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """One link at one time: taps (k,), each with its standard deviations, over `band_hz` round the carrier. Gains are complex,
    received over transmitted amplitude. No taps: no signal was heard, and none below `unheard_power` would have been."""

    transmitter: str
    receiver: str
    time_s: float
    band_hz: float
    delay_s: np.ndarray
    gain: np.ndarray
    delay_std_s: np.ndarray
    gain_std: np.ndarray  # of |gain| and of its phase together, over |gain|
    unheard_power: float


def read(path: str | Path) -> Snapshot:
    """A sounding's folder, or its result's file. Raises CastError for what is none, or does not say its link."""
    path = Path(path) / "result.json" if Path(path).is_dir() else Path(path)
    return _snapshot(json_file(path, missing=" (a sounding is a folder with a result.json)"))


def of_document(document: dict, where: str) -> Snapshot:
    """The same of the content of a result.json; `where` begins its messages."""
    return _snapshot(Reader(where, document))


def _snapshot(get: Reader) -> Snapshot:
    get.version("cast_sounding", 1)
    document = get.document
    ends = [_end(get, document.get(end), end) for end in ("transmitter", "receiver")]
    taps = [get.mapping(tap, f"taps[{k}]") for k, tap in enumerate(get.sequence(document.get("taps"), "taps"))]
    rows = [[get.number(tap.get(key), f"taps[{k}].{key}", unit) for key, unit in _TAP.items()] for k, tap in enumerate(taps)]
    delay_s, gain_db, phase_rad, delay_std_s, gain_std_db, phase_std_rad = np.array(rows, float).reshape(-1, len(_TAP)).T
    set_up_db = get.number(document.get("set_up_db"), "set_up_db", "dB", -400, 400)
    smallest_db = get.number(document.get("smallest_detectable_gain_db"), "smallest_detectable_gain_db", "dB", -400, 400)
    time_s = get.number(document.get("begins_s", 0.0), "begins_s", "s")
    band_hz = get.number(document.get("band_hz"), "band_hz", "Hz", 1.0, 1e10)
    get.faults.raise_if_any()
    return Snapshot(
        transmitter=ends[0], receiver=ends[1], time_s=time_s, band_hz=band_hz, delay_s=delay_s, delay_std_s=delay_std_s,
        gain=amplitude_from_db(gain_db - set_up_db) * np.exp(1j * phase_rad),
        gain_std=np.hypot(gain_std_db / DB_PER_NEPER, phase_std_rad),
        unheard_power=float(power_from_db(smallest_db - set_up_db)),
    )  # fmt: skip


def _end(get: Reader, value, place: str) -> str:
    if value is None:
        get.faults.add(
            place, "is not said: record with --node and --transmitter, or name the recording txA_rxB, and sound it again"
        )
        return ""
    return get.text(value, place)


def frequencies_hz(snapshots: Sequence[Snapshot], count: int = FREQUENCIES, band_hz: float | None = None) -> np.ndarray:
    """Offsets from the carrier (K,), in equal steps over the band that all were sounded in, or the middle `band_hz` of it."""
    widest_hz = min(snapshot.band_hz for snapshot in snapshots)
    if band_hz is not None and not 0 < band_hz <= widest_hz:
        raise CastError(f"band: got {band_hz:g} Hz, the soundings have {widest_hz:g} Hz")
    if not 2 <= count <= 65536:
        raise CastError(f"frequencies: got {count}, limit 2 to 65536")
    width_hz = band_hz or widest_hz
    return (np.arange(count) - (count - 1) / 2) * (width_hz / count)


def response(snapshot: Snapshot, frequency_hz: np.ndarray) -> tuple[np.ndarray, float]:
    """(K,) H(f) = Σ gain e^(-j2πf·delay), and the mean variance of an entry, from what the sounding states of its taps."""
    turns = np.exp(-2j * np.pi * np.outer(frequency_hz, snapshot.delay_s))
    power = np.abs(snapshot.gain) ** 2
    late = (2 * np.pi) ** 2 * np.mean(frequency_hz**2) * snapshot.delay_std_s**2
    variance = float((power * (snapshot.gain_std**2 + late)).sum())
    return turns @ snapshot.gain, max(variance, _LEAST_NOISE * float(power.sum()))


def campaign(snapshots: Sequence[Snapshot], frequency_hz: np.ndarray) -> dict[str, np.ndarray]:
    """The arrays of a file of responses: links in the order of their first snapshot, all times.

    Where a link was not heard this time, it is missing; one that was never heard is 0, within the power that would have been
    heard. Raises CastError for two snapshots of one link at one time.
    """
    links = list(dict.fromkeys((one.transmitter, one.receiver) for one in snapshots))
    time_s = np.unique([one.time_s for one in snapshots])
    out = np.full((len(links), len(time_s), len(frequency_hz)), np.nan + 0j, np.complex64)
    variances: list[list[float]] = [[] for _ in links]
    taken, faults = set(), Faults("collect")
    for one in snapshots:
        place = links.index((one.transmitter, one.receiver)), int(np.searchsorted(time_s, one.time_s))
        if place in taken:
            faults.add(f"{one.transmitter}>{one.receiver}", f"two soundings at {one.time_s:g} s: one file holds one of each time")
        taken.add(place)
        if one.gain.size:
            out[place], variance = response(one, frequency_hz)
            variances[place[0]].append(variance)
    faults.raise_if_any()
    for row, link in enumerate(links):
        if not variances[row]:
            silent = [one for one in snapshots if (one.transmitter, one.receiver) == link]
            out[row, np.searchsorted(time_s, [one.time_s for one in silent])] = 0
            variances[row] = [one.unheard_power for one in silent]
    return {
        "tx": np.array([tx for tx, _ in links]), "rx": np.array([rx for _, rx in links]), "time_s": time_s,
        "frequency_hz": frequency_hz, "response": out, "noise_power": np.array([np.mean(own) for own in variances]),
    }  # fmt: skip


def write(path: str | Path, arrays: dict[str, np.ndarray]) -> None:
    with written_aside(path) as aside, open(aside, "wb") as file:
        np.savez_compressed(file, **arrays)
