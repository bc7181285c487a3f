# SPDX-License-Identifier: GPL-3.0-or-later
"""What a transmitter sends: a known waveform, from a built-in code or from a SigMF file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.errors import CastError
from . import codes, recording


@dataclass(frozen=True, kw_only=True)
class Waveform:
    """Transmitted samples, complex64 (n,). `repeat`: periodic without a gap; otherwise sent once. NaN: not known."""

    samples: np.ndarray
    repeat: bool = True
    name: str = ""
    sample_rate_hz: float | None = None  # None: whatever the radio's rate is


# The positional parameters of a code's short name, `glfsr:8` or `zadoff_chu:255:7`.
_SHORT_NAME_KEYS = {
    "glfsr": ("degree", "mask", "seed"),
    "gold": ("length",),
    "zadoff_chu": ("length", "root"),
}


def is_code(text: str) -> bool:
    """Whether a text begins as a built-in code's short name does."""
    return text.partition(":")[0] in codes.CODES


def spec_from_text(text: str, samples_per_chip: int = 1) -> dict:
    """The waveform entry of a short name: `glfsr:8[:MASK[:SEED]]`, `gold:127`, `zadoff_chu:LENGTH:ROOT`, `ga128`, …"""
    name, *values = text.split(":")
    keys = _SHORT_NAME_KEYS.get(name, ())
    if name not in codes.CODES:
        raise CastError(f"code: got {text!r}, needs one of {', '.join(codes.CODES)} or file:STEM")
    if len(values) > len(keys):
        raise CastError(f"code: got {text!r}, {name} takes {len(keys)} numbers ({':'.join(keys) or 'none'})")
    try:
        numbers = [int(value, 0) for value in values]
    except ValueError:
        raise CastError(f"code: got {text!r}, needs integers after {name}: ({':'.join(keys)})") from None
    return {"code": name, **dict(zip(keys, numbers, strict=False)), "samples_per_chip": samples_per_chip}


def waveform_from_spec(spec: dict) -> Waveform:
    """The waveform of a built-in code entry."""
    name = ":".join(str(value) for key, value in spec.items() if key != "samples_per_chip")
    return Waveform(samples=codes.from_spec(spec), name=name)


def waveform_from_entry(entry: dict) -> Waveform:
    """The waveform of a twin's or a recording's entry, `{code: …}` or `{file: STEM, repeat: true}`."""
    if "file" not in entry:
        return waveform_from_spec(entry)
    if not isinstance(entry["file"], str):
        raise CastError(f"cast:waveform: file: got {entry['file']!r}, needs a SigMF stem")
    return waveform_from_file(entry["file"], repeat=bool(entry.get("repeat", True)))


@dataclass(frozen=True, kw_only=True)
class Repeated:
    """`count` samples of a waveform that repeats, and that was on the air before the first of them."""

    period: np.ndarray
    count: int

    def __len__(self) -> int:
        return self.count

    def between(self, first: int, last: int) -> np.ndarray:
        """(last − first,) complex64, from number `first` on, which may lie before the beginning."""
        return self.period[np.arange(first, last) % len(self.period)]


def waveform_from_file(path: str | Path, *, repeat: bool) -> Waveform:
    """The waveform of a SigMF file; NaN stands for samples that are not known."""
    file = recording.read(path, allow_nan=True)
    if not np.isfinite(file.samples).any():
        raise CastError(f"{path}: not one sample of the waveform is known")
    if not np.nan_to_num(file.samples).any():
        raise CastError(f"{path}: the waveform is zero throughout")
    return Waveform(
        samples=file.samples,
        repeat=repeat,
        name=f"file:{recording.stem_of(path).name}",
        sample_rate_hz=file.sample_rate_hz,
    )


def entry_from_text(text: str, *, samples_per_chip: int = 1, repeat: bool = True) -> dict:
    """The entry of a waveform that `--code` names: a built-in code's short name or `file:STEM`."""
    if text.startswith("file:"):
        return {"file": str(Path(text.removeprefix("file:")).resolve()), "repeat": repeat}
    return spec_from_text(text, samples_per_chip)


def waveform_from_text(text: str, *, samples_per_chip: int = 1, repeat: bool = True) -> Waveform:
    """The waveform that `--code` names: a built-in code's short name or `file:STEM`."""
    if text.startswith("file:"):
        return waveform_from_file(text.removeprefix("file:"), repeat=repeat)
    return waveform_from_spec(spec_from_text(text, samples_per_chip))
