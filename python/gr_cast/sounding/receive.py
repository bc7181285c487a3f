# SPDX-License-Identifier: GPL-3.0-or-later
"""From a recording to periods of the code: whole ones only, on one axis of time, gaps left out."""

from dataclasses import dataclass

import numpy as np

from ..core.errors import CastError
from ..signals.recording import Recording


@dataclass(frozen=True, kw_only=True)
class Periods:
    """Whole code periods: `samples` (p, length) complex64; `start_sample` (p,) counts lost samples too."""

    samples: np.ndarray
    start_sample: np.ndarray


def contiguous_runs(recording: Recording) -> list[tuple[int, int, int]]:
    """(first file sample, end, samples lost so far) of every stretch without a gap."""
    edges = [0] + [start for start, _ in recording.gaps] + [len(recording.samples)]
    lost = np.concatenate([[0], np.cumsum([count for _, count in recording.gaps])]).astype(int)
    return [(a, b, int(n)) for a, b, n in zip(edges[:-1], edges[1:], lost, strict=True) if b > a]


def whole_periods(recording: Recording, length: int) -> Periods:
    """Cut a recording into periods of `length` samples that keep the phase of the code across gaps.

    Sample 0 of the recording starts a period; after a gap the next period starts where the code does, lost samples counted.
    Raises CastError where not one whole period is there.
    """
    pieces, starts = [], []
    for first, end, lost in contiguous_runs(recording):
        begin = first + (-(first + lost)) % length
        count = (end - begin) // length
        if count > 0:
            pieces.append(recording.samples[begin : begin + count * length].reshape(count, length))
            starts.append(begin + lost + length * np.arange(count))
    if not pieces:
        raise CastError(
            f"recording: {len(recording.samples)} samples hold no whole period of the code ({length} samples) without a gap"
        )
    return Periods(samples=np.concatenate(pieces), start_sample=np.concatenate(starts))


def clipped_fraction(samples: np.ndarray, datatype: str = "cf32_le") -> float:
    """Share of samples whose I or Q sits at the largest value of the recording, where that value is a rail.

    Noise meets its own maximum once, a converter at its limit all the time. Two levels alone are no rail but a signal
    of constant envelope, so some values just below the largest are asked for. Integer samples clip at full scale alone.
    """
    parts = np.abs(np.ascontiguousarray(samples, np.complex64).view(np.float32)).reshape(-1, 2)
    rail = parts.max()
    if (datatype != "cf32_le" and rail < 0.95) or np.ptp(np.abs(samples)) < 1e-3 * rail:
        return 0.0
    at_rail = parts >= rail * (1 - 1e-6)
    share = float(np.mean(at_rail.any(axis=1)))
    spread = float(np.mean((parts > 0.5 * rail) & (parts < 0.99 * rail)))
    return share if share > 1e-3 and at_rail.sum() >= 10 and spread > share / 10 else 0.0


def remove_offset(samples: np.ndarray, offset_cycles_per_sample: float, start_sample: np.ndarray | int = 0) -> np.ndarray:
    """Turn samples (…, n) back by a carrier offset; `start_sample` (…,) is the index of each row's first sample."""
    if offset_cycles_per_sample == 0:
        return samples
    first = np.mod(np.asarray(start_sample) * offset_cycles_per_sample, 1.0)[..., None]
    within = np.exp(-2j * np.pi * offset_cycles_per_sample * np.arange(samples.shape[-1]))
    return samples * (np.exp(-2j * np.pi * first) * within).astype(np.complex64)
