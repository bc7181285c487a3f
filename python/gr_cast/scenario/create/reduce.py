# SPDX-License-Identifier: GPL-3.0-or-later
"""One link's paths to its four taps over time, with what every stage loses: a task of its own."""

from dataclasses import dataclass

import numpy as np

from ...core.units import db_from_power
from ..band import in_band_power
from ..model import GRID_STEP_S
from .approximate import TAPS, Loss, best_shift_s, kmeans, least_squares, loss
from .paths import LinkPaths, at

_LOSS_EVERY = 50  # instants: losses change slowly, and are as costly as the fit


@dataclass(frozen=True, kw_only=True)
class Job:
    """How to reduce one link: its paths, the carrier and band in Hz, the method, and the clock (T,) in s."""

    link: LinkPaths
    carrier_hz: float
    bandwidth_hz: float
    method: str
    clock_s: np.ndarray
    hold_s: float


@dataclass(frozen=True, kw_only=True)
class Reduced:
    """Taps (T or 1, 4): delays in s and gains; what they lose; by how much each hold's delays were moved (H,); and by how many dB
    the power steps where one hold follows another, beyond what the paths' own does (H - 1 or fewer,)."""

    delay_s: np.ndarray
    gain: np.ndarray
    loss: Loss
    shift_s: np.ndarray
    power_step_db: np.ndarray


def reduce(job: Job) -> Reduced:
    """Four taps for every instant, each support held for `hold_s`.

    For each hold the delays are moved together by at most half a grid step, to where the taps fit best: gains keep the phase
    of the true delays, so that nothing moves at the carrier. The losses are counted after that move.
    """
    clock_s = np.zeros(1) if len(job.link.time_s) == 1 else job.clock_s
    per_hold = max(1, int(round(job.hold_s / np.diff(clock_s).min()))) if len(clock_s) > 1 else 1
    delay_s, gain = np.zeros((len(clock_s), TAPS)), np.zeros((len(clock_s), TAPS), np.complex128)
    losses, shifts_s, steps_db, last_db = [], [], [], np.nan
    for start in range(0, len(clock_s), per_hold):
        part = slice(start, min(start + per_hold, len(clock_s)))
        paths_s, paths = at(job.link, clock_s[part], job.carrier_hz)
        here = (paths != 0).any(axis=0)  # of all paths of a long way, most are elsewhere
        paths_s, paths = paths_s[:, here], paths[:, here]
        shifts_s.append(best_shift_s(paths_s, paths, job.bandwidth_hz))
        paths_s = paths_s + shifts_s[-1]
        if job.method == "kmeans":
            taps_s, taps = kmeans(paths_s, paths)
        else:
            support, taps = least_squares(paths_s, paths, job.bandwidth_hz)
            taps_s = np.broadcast_to(support * GRID_STEP_S, taps.shape)
        delay_s[part, : taps.shape[1]], gain[part, : taps.shape[1]] = taps_s, taps
        looked = np.flatnonzero((paths != 0).any(axis=1))[::_LOSS_EVERY]
        if looked.size:
            losses.append(loss(paths_s[looked], paths[looked], taps_s[looked], taps[looked], job.bandwidth_hz))
        ends = [0, -1]
        first_db, end_db = _power_error_db(paths_s[ends], paths[ends], taps_s[ends], taps[ends], job.bandwidth_hz)
        steps_db.append(first_db - last_db)
        last_db = end_db
    names = ("nmse_db", "power_error_db", "delay_spread_error_s")
    joined = {name: np.concatenate([getattr(item, name) for item in losses] or [np.zeros(0)]) for name in names}
    return Reduced(delay_s=delay_s, gain=gain, loss=Loss(**joined), shift_s=np.array(shifts_s), power_step_db=_told(steps_db))


def _power_error_db(paths_s, paths, taps_s, taps, bandwidth_hz: float) -> np.ndarray:
    """dB by which the taps' power in the band is more than the paths', (T,); NaN where one of them has none."""
    powers = np.stack([in_band_power(taps_s, taps, bandwidth_hz), in_band_power(paths_s, paths, bandwidth_hz)])
    return np.where((powers > 0).all(axis=0), db_from_power(powers[0]) - db_from_power(powers[1]), np.nan)


def _told(steps_db: list) -> np.ndarray:
    return np.array(steps_db)[np.isfinite(steps_db)]
