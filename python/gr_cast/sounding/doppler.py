# SPDX-License-Identifier: GPL-3.0-or-later
"""How fast every tap turns: the phase of its autocorrelation over ever longer lags (pulse pairs, Miller and Rochwarger 1972)."""

from dataclasses import dataclass

import numpy as np

_COHERENT = 0.9  # of a tap's autocorrelation: a longer lag is not looked at once it has fallen to this
_SURE_RAD = 0.5  # standard deviation of a lag's phase beyond which nothing is read from it


@dataclass(frozen=True, kw_only=True)
class Doppler:
    """Mean Doppler of a tap, weighted by power, in cycles per sample, with its standard deviation, and the rms spread round it,
    0 where there is none beyond chance."""

    mean: float
    std: float
    spread: float


def tap_doppler(track: np.ndarray, noise: float, time: np.ndarray) -> Doppler | None:
    """Doppler of one tap from its gains `track` (n,), each with noise power `noise`, at `time` (n,) in samples; None where
    the noise does not let it be told. Steps of time are alike but for gaps; a step turns by less than half a cycle."""
    power = float(np.mean(np.abs(track) ** 2) - noise)
    step = float(np.median(np.diff(time))) if len(track) > 1 else 0.0
    found, lag = None, 1
    while power > 5 * noise / np.sqrt(len(track)) and lag <= len(track) // 2:
        straight = np.abs(time[lag:] - time[:-lag] - lag * step) < 0.5
        pairs = int(straight.sum())
        if pairs < 2:
            break
        known = 2 * np.pi * found.mean * lag * step if found else 0.0
        mean = np.mean((track[lag:] * np.conj(track[:-lag]))[straight]) * np.exp(-1j * known)
        std_rad = np.sqrt((noise**2 + 2 * power * noise) / pairs / 2) / power
        coherence = abs(mean) / power
        if std_rad > _SURE_RAD or (found and coherence + 3 * std_rad < _COHERENT):
            break
        turn = 2 * np.pi * lag * step
        lost = 1 - coherence
        spread = np.sqrt(2 * lost) / turn if lost > 3 * std_rad else 0.0
        std = np.hypot(std_rad / turn, spread / np.sqrt(pairs / lag + 1))  # stretches of one lag are what the mean is taken over
        found = Doppler(mean=(known + float(np.angle(mean))) / turn, std=float(std), spread=float(spread))
        lag *= 2
    return found
