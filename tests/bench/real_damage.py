# SPDX-License-Identifier: GPL-3.0-or-later
"""Real recordings damaged in known ways: the damage must be named, with its size, beside what was there before.

Every damage is a plain formula on the recorded samples; nothing of the package's forward models takes part.
"""

import copy
import shutil
import sys
from pathlib import Path

import numpy as np
import yaml
from scipy.interpolate import CubicSpline
from scipy.signal import resample

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "build" / "python"), str(ROOT / "python")]

from gr_cast.signals import recording

DROPPED, CLOCK_PPM = 37, 12.0
SHIFTED = 5  # samples
LEAST_GAINED = 0.1  # samples


def clip(y, about):
    """Rails where one sample of a hundred would pass them."""
    level = round(about["level"] * about["full_scale"]) / about["full_scale"]
    limit = lambda v: np.clip(v, -level, level)  # noqa: E731
    return limit(y.real) + 1j * limit(y.imag), [_found("adc_clipping", level=(level, 0.02 * level))]


def coarse(y, about):
    """A lattice of about 32 steps from rail to rail."""
    unit = 1 / about["full_scale"]
    step = unit * max(2, round(about["peak"] / 16 / unit))
    grid = lambda v: np.round(v / step) * step  # noqa: E731
    return grid(y.real) + 1j * grid(y.imag), [_found("quantization", step=(step, 0.02 * step))]


def lost(y, about):
    """Samples dropped at the middle of what is fitted."""
    if about["vault"]:
        return y, []
    at = len(y) // 2
    y = np.concatenate([y[:at], y[at + DROPPED :]])
    return y, [_found("sample_loss", time_s=(at / about["rate"], 0.02 * len(y) / about["rate"]), samples=(DROPPED, 0.1))]


def second_oscillator(y, about):
    """The sampling clock alone, 12 ppm off (band-limited by an eight-fold FFT and cubic steps)."""
    fine = resample(y, 8 * len(y))
    position = np.minimum(np.arange(len(y)) * (1 + CLOCK_PPM * 1e-6), len(y) - 1)
    spline = CubicSpline(np.arange(len(fine)) / 8, np.stack([fine.real, fine.imag], 1))
    return spline(position) @ [1, 1j], [_found("sample_clock_offset", offset_ppm=(about["clock_ppm"] + CLOCK_PPM, 0.6))]


def inverted(y, about):
    return np.conj(y), [_found("spectral_inversion")]


def structural(y, about):
    """The twin's waveform is wrong: a sixteenth of it, past its middle, stands some samples late. Nothing but the place can be
    said of it."""
    return y, []


def _with_a_shifted_stretch(path: Path) -> list[float]:
    """Shift a stretch of a waveform file; returns its first and its last moment, s."""
    taken = recording.read(path, allow_nan=True)
    x = taken.samples.copy()
    known = np.flatnonzero(np.isfinite(x))
    a, b = known[len(known) * 9 // 16], known[len(known) * 10 // 16]
    x[a:b] = x[a - SHIFTED : b - SHIFTED].copy()
    recording.write(path, x, sample_rate_hz=taken.sample_rate_hz, datatype=taken.datatype)
    return [a / taken.sample_rate_hz, b / taken.sample_rate_hz]


DAMAGES = {f.__name__: f for f in (clip, coarse, lost, second_oscillator, inverted, structural)}


def invisible(case: Path, kind: str) -> str | None:
    """Why a damage leaves no trace in a case, where it leaves none."""
    twin = yaml.safe_load((case / "twin.yaml").read_text())
    told = [recording.read(case / w["file"], allow_nan=True).samples for w in twin["waveforms"].values()]
    known = [np.flatnonzero(np.isfinite(x)) for x in told]
    gained = max(CLOCK_PPM * 1e-6 * (k[-1] - k[0]) for k in known)
    if kind == "inverted" and all(not x[k].imag.any() for x, k in zip(told, known, strict=True)):
        return "the waveform is real: another carrier, another filter"
    if kind == "second_oscillator" and gained < LEAST_GAINED:
        return f"the clock gains {gained:.3f} samples"
    if kind == "lost" and all(k[-1] < len(x) // 2 for x, k in zip(told, known, strict=True)):
        return "nothing is known from the middle on"
    return None


def _found(family, **limits):
    ranges = {name: [value - reach, value + reach] for name, (value, reach) in limits.items()}
    return {"families": [family], "parameters": ranges}


def damage(case: Path, truth: dict, kind: str, folder: Path) -> dict:
    """Write the case `folder`: every recording of `case` damaged; returns its truth."""
    clocks = [w["parameters"]["offset_ppm"]["tx"] for w in truth["must_find"] if "sample_clock_offset" in w["families"]]
    clock_ppm = float(np.mean(clocks)) if clocks else 0.0
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(case, folder, copy_function=shutil.copyfile)
    twin = yaml.safe_load((case / "twin.yaml").read_text())
    every = [recording.read(case / entry["file"]) for entry in twin["recordings"]]
    levels = {}  # of every receiver's converter
    for entry, taken in zip(twin["recordings"], every, strict=True):
        levels.setdefault(entry["receiver"], []).extend([np.abs(taken.samples.real), np.abs(taken.samples.imag)])
    levels = {name: np.concatenate(parts) for name, parts in levels.items()}
    wanted = []
    for entry, taken in zip(twin["recordings"], every, strict=True):
        full_scale = {"cf32_le": 4096.0}.get(taken.datatype, recording.DATATYPES[taken.datatype][2])
        about = {"rate": taken.sample_rate_hz, "full_scale": full_scale, "clock_ppm": clock_ppm, "vault": "use" in entry}
        here = levels[entry["receiver"]]
        about |= {"level": float(np.quantile(here, 0.99)), "peak": float(here.max())}
        y, found = DAMAGES[kind](taken.samples.astype(complex), about)
        wanted = found or wanted
        recording.write(folder / entry["file"], y, sample_rate_hz=taken.sample_rate_hz, datatype=taken.datatype)
    families = {w["families"][0] for w in wanted}
    truth = copy.deepcopy(truth)
    truth["must_find"] = [w for w in truth["must_find"] if not families & set(w["families"])] + wanted
    truth["must_not_claim"] = [f for f in truth["must_not_claim"] if f not in families]
    truth["beat_db"] = 0.0
    if kind == "structural":
        stretches = [_with_a_shifted_stretch(folder / w["file"]) for w in twin["waveforms"].values()]
        truth |= {"verdict": ["unexplained"], "must_find": [], "left_time_s": stretches}
    if kind == "inverted":
        for w in truth["must_find"]:
            w["parameters"] = {k: v for k, v in w.get("parameters", {}).items() if k != "offset_hz"}
    return truth
