# SPDX-License-Identifier: GPL-3.0-or-later
"""A sounding as people and programs read it: result.json, frames.csv and a table of text."""

import csv
import io
from pathlib import Path

import numpy as np

from .. import __version__
from ..core.documents import is_number, json_file
from ..core.errors import CastError
from ..core.figures import with_error
from ..core.files import write_json, write_text
from ..core.units import db_from_amplitude, db_from_power
from ..signals.recording import Recording
from .path_loss import link_of
from .sound import Sounding, SoundingOptions


def about_recording(file: Recording, name: str, waveform: dict, options: SoundingOptions) -> dict:
    """What result.json says of a recording beside what was measured: its link if known, when it begins, the band sounded, and
    what powers, gains and cables of the set-up add to a gain."""
    try:
        ends = link_of(file, name)
    except CastError:
        ends = (None, None)
    known = dict(zip(("transmitter", "receiver"), ends, strict=True))
    begins_s = file.metadata.get("cast:scenario_at_s", file.metadata.get("cast:start_at_s", 0.0))
    chips_hz = (file.sample_rate_hz or 0.0) / waveform.get("samples_per_chip", 1)
    return known | {
        "begins_s": begins_s if is_number(begins_s) else 0.0,
        "band_hz": options.band * chips_hz,
        "set_up_db": options.budget.path_loss_db(0.0),
    }


def as_document(sounding: Sounding, about: dict) -> dict:
    """The content of result.json: plain numbers with their units in their names; null where nothing was measured."""
    rate = sounding.sample_rate_hz
    taps = sounding.taps
    gains_db = db_from_power(taps.power)
    entries = [
        {
            "delay_s": float(taps.delay_samples[k] / rate),
            "gain_db": float(gains_db[k]),
            "phase_rad": float(np.angle(taps.gain[k, 0])),
            "delay_std_s": float(taps.delay_std_samples[k] / rate),
            "gain_std_db": float(taps.gain_std_db[k]),
            "phase_std_rad": float(taps.phase_std_rad[k]),
            **_doppler_hz(sounding, k),
        }
        for k in range(len(taps.delay_samples))
    ]
    found = sounding.offset.found
    return {
        "cast_sounding": 1,
        "software": f"gr-cast {__version__}",
        **about,
        "sample_rate_hz": rate,
        "period_samples": sounding.period_samples,
        "periods_per_frame": sounding.periods_per_frame,
        "moving": sounding.is_moving,
        "blocks": sounding.blocks,
        "frames": sounding.frames,
        "frame_std_db": _frame_std_db(sounding),
        "frames_missing": int(np.sum(~sounding.frame_detected)),
        "taps": entries,
        "path_gain_db": sounding.path_gain_db,
        "path_gain_std_db": sounding.path_gain_std_db,
        "tap_sum_db": sounding.tap_sum_db,
        "path_loss_db": sounding.path_loss_db,
        "smallest_detectable_gain_db": sounding.smallest_path_gain_db,
        "noise_floor_db": float(db_from_power(max(sounding.noise_power, 1e-30))),
        "carrier_offset_hz": sounding.offset.cycles_per_sample * rate if found else None,
        "carrier_offset_std_hz": sounding.offset.std_cycles_per_sample * rate if found else None,
        "carrier_offset_known": sounding.offset.known,
        "residual_db": sounding.residual_db,
        "gaps": [{"time_s": time_s, "lost_samples": lost} for time_s, lost in sounding.gaps],
        "code_jumps": [{"time_s": time_s, "later_samples": shift} for time_s, shift in sounding.jumps],
        "warnings": list(sounding.warnings),
    }


def _doppler_hz(sounding: Sounding, tap: int) -> dict[str, float | None]:
    """Doppler of one tap for result.json; null where the noise does not let it be told."""
    found = sounding.doppler[tap]
    names = {"doppler_hz": "mean", "doppler_std_hz": "std", "doppler_spread_hz": "spread"}
    return {name: getattr(found, own) * sounding.sample_rate_hz if found else None for name, own in names.items()}


def _frame_std_db(sounding: Sounding) -> dict[str, float] | None:
    """Standard deviation over the frames of the strongest and the weakest tap's gain, dB; None for fewer than three frames."""
    heard = sounding.frame_gain[sounding.frame_detected]
    if heard.shape[0] < 3 or not heard.shape[1]:
        return None
    order = np.argsort(sounding.taps.power)
    return {
        name: float(np.std(db_from_amplitude(heard[:, tap]), ddof=1))
        for name, tap in (("strongest", order[-1]), ("weakest", order[0]))
    }


def frame_gain_db(sounding: Sounding) -> np.ndarray:
    """Path gain of each frame, dB, (frames,): in the waveform's band, noise bias removed; NaN where the frame is missing."""
    return db_from_power(np.where(sounding.frame_detected & (sounding.frame_power > 0), sounding.frame_power, np.nan))


def frames_csv(sounding: Sounding) -> str:
    """One line per frame: time_s, detected, path_gain_db and every tap's gain and phase; empty where missing."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    taps = sounding.frame_gain.shape[1]
    names = [f"tap{k}_{quantity}" for k in range(taps) for quantity in ("gain_db", "phase_rad")]
    writer.writerow(["time_s", "detected", "path_gain_db", *names])
    path_gain = frame_gain_db(sounding)
    gain, phase = db_from_amplitude(sounding.frame_gain), np.angle(sounding.frame_gain)
    for row in range(sounding.frames):
        cells = [f"{sounding.frame_time_s[row]:.9f}", int(sounding.frame_detected[row])]
        if sounding.frame_detected[row]:
            values = np.stack([gain[row], phase[row]], axis=1).reshape(-1)
            cells += [f"{value:.4f}" for value in (path_gain[row], *values)]
        else:
            cells += [""] * (1 + 2 * taps)
        writer.writerow(cells)
    return text.getvalue()


def as_table(document: dict) -> str:
    """The result for the screen; every number has as many digits as its error."""
    moving = document["moving"]
    flies = any(tap.get("time_of_flight_s") is not None for tap in document["taps"])
    which, late = ("time_of_flight_s", "time of flight (µs)") if flies else ("delay_s", "delay (µs)")
    lines = [f"{late:>24}{'gain (dB)':>22}{'phase (rad)':>20}" + (f"{'Doppler (Hz)':>22}" if moving else "")]
    for tap in document["taps"]:
        cells = [
            f"{with_error(1e6 * tap[which], 1e6 * tap['delay_std_s'], 6):>24}",
            f"{with_error(tap['gain_db'], tap['gain_std_db']):>22}",
            f"{with_error(tap['phase_rad'], tap['phase_std_rad']):>20}",
        ]
        if moving and tap["doppler_hz"] is not None:
            cells.append(f"{with_error(tap['doppler_hz'], tap['doppler_std_hz']):>22}")
            cells.append(f", spread {tap['doppler_spread_hz']:.2g}" if tap["doppler_spread_hz"] else "")
        lines.append("".join(cells))
    if not document["taps"]:
        lines.append("   (none)")

    def show(label, value, unit, std=None):
        return f"{label:<22}{'–' if value is None else f'{with_error(value, std)} {unit}'}"

    carrier = "Hz"
    if document["carrier_offset_known"]:
        carrier += ", as told"
    elif moving and document["carrier_offset_hz"] is not None:
        carrier += ", Doppler of the strongest path included (--carrier-offset 0 where both radios share a clock)"
    std_hz = None if document["carrier_offset_known"] else document["carrier_offset_std_hz"]
    lines += [
        "",
        show("path gain", document["path_gain_db"], "dB", document["path_gain_std_db"]),
        *([show("sum of |tap|²", document["tap_sum_db"], "dB")] if _differ(document) else []),
        show("path loss", document["path_loss_db"], "dB"),
        show("noise floor", document["noise_floor_db"], "dB of full scale per sample"),
        show("smallest gain seen", document["smallest_detectable_gain_db"], "dB"),
        show("carrier offset", document["carrier_offset_hz"], carrier, std_hz),
        f"{'frames':<22}{document['frames']}, of which {document['frames_missing']} missing",
        *([f"{'channel':<22}moves: sounded in {document['blocks']} blocks, every tap with its Doppler"] if moving else []),
    ]
    return "\n".join(lines + [f"warning: {warning}" for warning in document["warnings"]])


def _differ(document: dict) -> bool:
    """Whether the sum of |tap|² is not the power in the band, as far as it is printed."""
    path_gain_db, sum_db = document["path_gain_db"], document["tap_sum_db"]
    return path_gain_db is not None and f"{path_gain_db:.2f}" != f"{sum_db:.2f}"


def read_taps(path: str | Path) -> tuple[list[dict], float]:
    """(taps of a sounding, each `delay_s` from the first one on, `gain_db` and `phase_rad`; its noise floor in dB), of its
    folder or result.json. Raises CastError where it is none, or found no tap."""
    path = Path(path) / "result.json" if Path(path).is_dir() else Path(path)
    get = json_file(path, missing=" (a sounding is a folder with a result.json)")
    get.version("cast_sounding", 1)
    units = {"delay_s": "s", "gain_db": "dB", "phase_rad": "rad"}
    taps = [get.mapping(tap, f"taps[{k}]") for k, tap in enumerate(get.sequence(get.document.get("taps"), "taps"))]
    taps = [
        {key: get.number(tap.get(key), f"taps[{k}].{key}", unit) for key, unit in units.items()} for k, tap in enumerate(taps)
    ]
    floor_db = get.number(get.document.get("noise_floor_db"), "noise_floor_db", "dB")
    if not taps:
        get.faults.add("taps", "got none: the sounding heard no signal")
    get.faults.raise_if_any()
    first_s = min(tap["delay_s"] for tap in taps)
    return [tap | {"delay_s": tap["delay_s"] - first_s} for tap in taps], floor_db


def output_folder(path: str | Path) -> Path:
    """Make the folder that results go to; refuses a path that is a file."""
    folder = Path(path)
    if folder.exists() and not folder.is_dir():
        raise CastError(f"{folder}: output: is a file, needs a folder")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_sounding(folder: Path, sounding: Sounding, document: dict) -> None:
    """frames.csv first, result.json last: who sees result.json has everything."""
    write_text(folder / "frames.csv", frames_csv(sounding))
    write_json(folder / "result.json", document)
