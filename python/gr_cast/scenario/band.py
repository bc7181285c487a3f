# SPDX-License-Identifier: GPL-3.0-or-later
"""Power in a band: what a flat signal of B Hz gets through taps, which is not the sum of |tap|^2.

Taps nearer than 1/B to each other add as amplitudes: the mean of |H(f)|^2 over the band is
sum_pq gain_p conj(gain_q) sinc(B (delay_p - delay_q)).
"""

import numpy as np

from ..core.units import db_from_power
from .model import Scenario, played_gain

WIDEST_HZ = 80e6  # that Colosseum plays: the band of a scenario that does not say its own
_CHUNK = 1 << 21  # elements of one intermediate array


def band_hz(scenario: Scenario) -> float:
    """The scenario's own band in Hz, or Colosseum's 80 MHz."""
    return scenario.bandwidth_hz or WIDEST_HZ


def in_band_power(delay_s: np.ndarray, gain: np.ndarray, bandwidth_hz: float) -> np.ndarray:
    """Mean of |H(f)|^2 over the band, (T,), of paths or taps `delay_s` and `gain` (T, P)."""
    out = np.empty(len(gain))
    step = max(1, _CHUNK // max(1, gain.shape[1] ** 2))
    for start in range(0, len(gain), step):
        part = slice(start, start + step)
        shape = np.sinc(bandwidth_hz * (delay_s[part, :, None] - delay_s[part, None, :]))
        out[part] = np.einsum("tp,tpq,tq->t", gain[part].conj(), shape, gain[part], optimize=True).real
    return np.maximum(out, 0.0)


def band_power_db(scenario: Scenario, key: tuple[str, str], bandwidth_hz: float) -> np.ndarray:
    """In-band power of one link over time (T or 1,), in dB, base loss applied."""
    return db_from_power(in_band_power(scenario.links[key].delay_s, played_gain(scenario, key), bandwidth_hz))


def path_gain_matrix_db(scenario: Scenario, bandwidth_hz: float | None = None) -> np.ndarray:
    """Mean in-band power (over time, linear) of every link, base loss applied: (N, N), row tx, column rx; no link is -inf.

    The band is the scenario's own unless another is given.
    """
    width_hz = bandwidth_hz or band_hz(scenario)
    return _matrix_db(scenario, lambda key: in_band_power(scenario.links[key].delay_s, played_gain(scenario, key), width_hz))


def path_gain_over_time_db(scenario: Scenario, instants: np.ndarray, bandwidth_hz: float) -> np.ndarray:
    """In-band power of every link at those of the scenario's instants (T,), base loss applied: (T, N, N) as the matrix above."""
    place = {node: index for index, node in enumerate(scenario.nodes)}
    power = np.zeros((len(instants), len(scenario.nodes), len(scenario.nodes)))
    for key, taps in scenario.links.items():
        at = np.zeros(1, int) if taps.is_static else instants
        power[:, place[key[0]], place[key[1]]] = in_band_power(taps.delay_s[at], played_gain(scenario, key)[at], bandwidth_hz)
    return db_from_power(power)


def tap_power_matrix_db(scenario: Scenario) -> np.ndarray:
    """Mean sum of |tap|^2 of every link, as `path_gain_matrix_db`."""
    return _matrix_db(scenario, lambda key: np.sum(np.abs(played_gain(scenario, key)) ** 2, axis=1))


def taps_over_band_db(scenario: Scenario, bandwidth_hz: float | None = None) -> tuple[float, float]:
    """By how many dB the sum of |tap|^2 is more than the power in the band: least and most over the links; (0, 0) without."""
    taps_db, in_band_db = tap_power_matrix_db(scenario), path_gain_matrix_db(scenario, bandwidth_hz)
    heard = np.isfinite(taps_db) & np.isfinite(in_band_db)
    apart_db = (taps_db - np.where(heard, in_band_db, 0.0))[heard]
    return (float(apart_db.min()), float(apart_db.max())) if apart_db.size else (0.0, 0.0)


def _matrix_db(scenario: Scenario, power_of) -> np.ndarray:
    place = {node: index for index, node in enumerate(scenario.nodes)}
    power = np.zeros((len(scenario.nodes),) * 2)
    for key in scenario.links:
        power[place[key[0]], place[key[1]]] = np.mean(power_of(key))
    return db_from_power(power)
