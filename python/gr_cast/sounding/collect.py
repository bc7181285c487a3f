# SPDX-License-Identifier: GPL-3.0-or-later
"""Soundings of many links to one campaign of a place case: responses over frequency, and how well they are known."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.documents import Reader, json_file
from ..core.errors import CastError, Faults
from ..core.files import written_aside
from ..core.units import amplitude_from_db
from .cir import DB_PER_NEPER

FREQUENCIES = 64
_LEAST_NOISE = 1e-12  # of a response's power: single precision knows no entry better
_TAP = {"delay_s": "s", "gain_db": "dB", "phase_rad": "rad", "delay_std_s": "s", "gain_std_db": "dB", "phase_std_rad": "rad"}


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """One link at one time: taps (k,), each with its standard deviations, over `band_hz` round the carrier. Gains are complex,
    received over transmitted amplitude. No taps: no signal was heard."""

    transmitter: str
    receiver: str
    time_s: float
    band_hz: float
    delay_s: np.ndarray
    gain: np.ndarray
    delay_std_s: np.ndarray
    gain_std: np.ndarray  # of |gain| and of its phase together, over |gain|


def read(path: str | Path) -> Snapshot:
    """A sounding's folder, or its result's file. Raises CastError for what is none, or does not say its link."""
    path = Path(path) / "result.json" if Path(path).is_dir() else Path(path)
    get = json_file(path, missing=" (a sounding is a folder with a result.json)")
    get.version("cast_sounding", 1)
    document = get.document
    ends = [_end(get, document.get(end), end) for end in ("transmitter", "receiver")]
    taps = [get.mapping(tap, f"taps[{k}]") for k, tap in enumerate(get.sequence(document.get("taps"), "taps"))]
    rows = [[get.number(tap.get(key), f"taps[{k}].{key}", unit) for key, unit in _TAP.items()] for k, tap in enumerate(taps)]
    delay_s, gain_db, phase_rad, delay_std_s, gain_std_db, phase_std_rad = np.array(rows, float).reshape(-1, len(_TAP)).T
    set_up_db = 0.0  # between path gain as received, and what was transmitted
    if rows:
        set_up_db = -sum(get.number(document.get(key), key, "dB", -400, 400) for key in ("path_gain_db", "path_loss_db"))
    time_s = get.number(document.get("begins_s", 0.0), "begins_s", "s")
    band_hz = get.number(document.get("band_hz"), "band_hz", "Hz", 1.0, 1e10)
    get.faults.raise_if_any()
    return Snapshot(
        transmitter=ends[0], receiver=ends[1], time_s=time_s, band_hz=band_hz, delay_s=delay_s, delay_std_s=delay_std_s,
        gain=amplitude_from_db(gain_db + set_up_db) * np.exp(1j * phase_rad),
        gain_std=np.hypot(gain_std_db / DB_PER_NEPER, phase_std_rad),
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
    """The arrays of a file of responses: links in the order of their first snapshot, all times; NaN where nothing was heard.

    Raises CastError for two snapshots of one link at one time, and for a link that was never heard.
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
    for link, own in zip(links, variances, strict=True):
        if not own:
            faults.add(f"{link[0]}>{link[1]}", "no signal was heard on it: leave its results out")
    faults.raise_if_any()
    return {
        "tx": np.array([tx for tx, _ in links]), "rx": np.array([rx for _, rx in links]), "time_s": time_s,
        "frequency_hz": frequency_hz, "response": out, "noise_power": np.array([np.mean(own) for own in variances]),
    }  # fmt: skip


def write(path: str | Path, arrays: dict[str, np.ndarray]) -> None:
    with written_aside(path) as aside, open(aside, "wb") as file:
        np.savez_compressed(file, **arrays)
