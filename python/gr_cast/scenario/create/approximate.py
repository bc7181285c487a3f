# SPDX-License-Identifier: GPL-3.0-or-later
"""Many paths to four taps on the 10 ns grid, and what that loses.

Paths of one link are delays `delay_s` (T, P) and coefficients `gain` (T, P), 0 where a path is absent. Over a band of B Hz,
<e_a, e_b> = sinc(B (a - b)) is the inner product of two unit echoes at delays a and b, so that fits and errors are closed
expressions: with G the Gram matrix of the taps and b their inner products with the channel, the best gains are inv(G) b.
"""

from dataclasses import dataclass

import numpy as np

from ...core.errors import CastError
from ...core.units import db_from_power
from ..band import in_band_power
from ..model import GRID_STEP_S, GRID_TAPS

TAPS = 4
_RIDGE = 1e-3  # keeps gains bounded where the band is too narrow to tell neighbouring taps apart
_HAIR_S = 1e-16  # moves a path off the grid, where sin(x)/x needs no special case; its phase turns 1e-7 rad at most
_MARGIN = 3  # grid steps looked at before the first and after the last path
_CHUNK = 1 << 21  # elements of one intermediate array
_POWER_EVERY = 8  # instants at which the taps' power is held against the paths'
_MOST_POWER = 100.0  # that taps are scaled up by
_FEW = 10  # instants that a support is chosen on
_SHIFTS = 5


@dataclass(frozen=True, kw_only=True)
class Loss:
    """What an approximation loses, per instant (T,): in dB over the band, and of the rms delay spread in s."""

    nmse_db: np.ndarray
    power_error_db: np.ndarray
    delay_spread_error_s: np.ndarray


def kmeans(delay_s: np.ndarray, gain: np.ndarray, taps: int = TAPS) -> tuple[np.ndarray, np.ndarray]:
    """Cluster each instant's paths by delay and give every cluster one tap: delays and gains, (T, taps).

    The power-weighted squared distance to the cluster's mean delay is least over all clusterings: exact by dynamic
    programming, for in one dimension clusters are intervals (Wang & Song 2011). A tap is the complex sum of its paths.
    """
    out_delay_s, out_gain = np.zeros((len(gain), taps)), np.zeros((len(gain), taps), np.complex128)
    for instant, (delays, gains) in enumerate(zip(delay_s, gain, strict=True)):
        present = np.flatnonzero(gains)
        order = present[np.argsort(delays[present], kind="stable")]
        borders = _best_intervals(delays[order], np.abs(gains[order]) ** 2, taps)
        for index, (first, last) in enumerate(zip(borders, borders[1:], strict=False)):
            members = order[first:last]
            mean_s = np.average(delays[members], weights=np.abs(gains[members]) ** 2)
            out_delay_s[instant, index] = np.clip(np.rint(mean_s / GRID_STEP_S), 0, GRID_TAPS - 1) * GRID_STEP_S
            out_gain[instant, index] = gains[members].sum()
    return out_delay_s, out_gain


def _best_intervals(delay_s: np.ndarray, weight: np.ndarray, clusters: int) -> list[int]:
    """Borders of the best split of sorted delays into at most `clusters` intervals."""
    count = delay_s.size
    if count <= clusters:
        return list(range(count + 1))
    centred = delay_s - delay_s[0]
    sums = [np.concatenate([[0.0], np.cumsum(weight * centred**power)]) for power in (0, 1, 2)]
    mass, first, second = (total[None, :] - total[:, None] for total in sums)  # [i, j]: paths i to j - 1
    with np.errstate(invalid="ignore", divide="ignore"):
        cost = np.where(mass > 0, np.maximum(second - first**2 / mass, 0.0), np.inf)
    best, choices = cost[0], []
    for _ in range(clusters - 1):
        total = best[:, None] + cost
        choices.append(np.argmin(total, axis=0))
        best = np.min(total, axis=0)
    borders = [count]
    for choice in reversed(choices):
        borders.append(int(choice[borders[-1]]))
    return [0, *reversed(borders)] if borders[-1] else list(reversed(borders))


def least_squares(delay_s: np.ndarray, gain: np.ndarray, bandwidth_hz: float, taps: int = TAPS):
    """The grid taps that fit the channel best over the band: (support (taps,) int, gains (T, taps)).

    One support serves all instants; it is chosen on a few of them. Gains follow at every instant, and are then as large as makes
    the power in the band that of the paths: it does not jump where another support begins, and a fit that keeps the share c of
    the energy has an error of 2 (1 - sqrt(c)) in the place of 1 - c, 0.1 dB more at -13 dB.
    """
    few = _spread(len(gain))
    support, _ = choose_support(delay_s[few], gain[few], bandwidth_hz, taps)
    b = inner_products(delay_s, gain, support * GRID_STEP_S, bandwidth_hz)
    fitted = b @ np.linalg.inv(_gram(support, bandwidth_hz))  # G is real and symmetric
    return support, fitted * _to_power(delay_s, gain, support * GRID_STEP_S, fitted, bandwidth_hz)[:, None]


def _to_power(delay_s, gain, tap_delay_s, tap_gain, bandwidth_hz: float) -> np.ndarray:
    """What to multiply taps (T, K) by, (T,), for the paths' power in the band: at every eighth instant and both ends, which is
    costly, and geometrically between them."""
    looked = np.unique(np.append(np.arange(0, len(gain), _POWER_EVERY), len(gain) - 1))
    before = in_band_power(delay_s[looked], gain[looked], bandwidth_hz)
    after = in_band_power(np.broadcast_to(tap_delay_s, tap_gain[looked].shape), tap_gain[looked], bandwidth_hz)
    known = (before > 0) & (after > before / _MOST_POWER)  # else there is hardly a fit to be scaled
    if not known.any():
        return np.ones(len(gain))
    return np.exp(np.interp(np.arange(len(gain)), looked[known], np.log(before[known] / after[known]) / 2))


def best_shift_s(delay_s: np.ndarray, gain: np.ndarray, bandwidth_hz: float, taps: int = TAPS) -> float:
    """By how much to move all delays, within half a grid step, so that the taps fit best.

    The best of a few moves, one of which puts the strongest path on the grid.
    """
    few = _spread(len(gain))
    middle = few[len(few) // 2]
    strongest_s = delay_s[middle, np.argmax(np.abs(gain[middle]))]
    onto_grid_s = np.rint(strongest_s / GRID_STEP_S) * GRID_STEP_S - strongest_s
    shifts_s = np.append(GRID_STEP_S * ((np.arange(_SHIFTS) + 0.5) / _SHIFTS - 0.5), onto_grid_s)
    captured = [choose_support(delay_s[few] + shift, gain[few], bandwidth_hz, taps)[1] for shift in shifts_s]
    return float(shifts_s[int(np.argmax(captured))])


def _spread(count: int) -> np.ndarray:
    return np.unique(np.linspace(0, count - 1, min(count, _FEW)).round().astype(int))


def choose_support(delay_s: np.ndarray, gain: np.ndarray, bandwidth_hz: float, taps: int) -> tuple[np.ndarray, float]:
    """Grid indices (taps,), and the share of energy that they capture, averaged over the instants.

    Found forward, then by exchanging one tap at a time until no exchange helps: the mean share of energy,
    trace(inv(G) R) with R = mean(b b^H / E), decides.
    """
    present = gain != 0
    if not present.any():
        return np.zeros(0, int), 0.0
    candidates = _candidates(delay_s[present])
    b = inner_products(delay_s, gain, candidates * GRID_STEP_S, bandwidth_hz)
    energy = in_band_power(delay_s, gain, bandwidth_hz)
    weighted = b[energy > 0] / np.sqrt(energy[energy > 0])[:, None]
    r = weighted.T @ weighted.conj() / max(len(weighted), 1)
    gram = _gram(candidates, bandwidth_hz)
    chosen = np.sort(_exchange(gram, r, _forward(gram, r, min(taps, candidates.size))))
    return candidates[chosen], float(_captured(gram, r, chosen[None])[0])


def _candidates(delay_s: np.ndarray) -> np.ndarray:
    """Grid indices near any path."""
    near = np.unique(np.rint(delay_s / GRID_STEP_S).astype(int))
    near = np.unique(near[:, None] + np.arange(-_MARGIN, _MARGIN + 1))
    return near[(near >= 0) & (near < GRID_TAPS)]


def _gram(indices: np.ndarray, bandwidth_hz: float) -> np.ndarray:
    steps = indices[:, None] - indices[None, :]
    return np.sinc(bandwidth_hz * GRID_STEP_S * steps) + _RIDGE * np.eye(len(indices))


def _captured(gram: np.ndarray, r: np.ndarray, supports: np.ndarray) -> np.ndarray:
    """trace(inv(G_S) R_S) of many supports (n, k)."""
    rows, columns = supports[:, :, None], supports[:, None, :]
    return np.einsum("nii->n", np.linalg.solve(gram[rows, columns], r[rows, columns].real))


def _with_any(support: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Every candidate that is not in the support, and the supports that it would make."""
    others = np.setdiff1d(np.arange(count), support)
    return others, np.column_stack([np.tile(support, (others.size, 1)), others])


def _forward(gram: np.ndarray, r: np.ndarray, taps: int) -> np.ndarray:
    support = np.zeros(0, int)
    for _ in range(taps):
        others, supports = _with_any(support, len(gram))
        support = np.append(support, others[np.argmax(_captured(gram, r, supports))])
    return support


def _exchange(gram: np.ndarray, r: np.ndarray, support: np.ndarray) -> np.ndarray:
    score = _captured(gram, r, support[None])[0]
    while support.size < len(gram):
        trials = [_with_any(np.delete(support, place), len(gram))[1] for place in range(support.size)]
        trials = np.concatenate(trials)
        scores = _captured(gram, r, trials)
        if scores.max() <= score * (1 + 1e-9):
            break
        support, score = trials[np.argmax(scores)], scores.max()
    return support


def inner_products(delay_s: np.ndarray, gain: np.ndarray, at_s: np.ndarray, bandwidth_hz: float) -> np.ndarray:
    """b[t, k] = sum_p gain[t, p] sinc(B (at_s[k] - delay_s[t, p])), (T, K)."""
    turn = np.pi * bandwidth_hz
    out = np.empty((len(gain), len(at_s)), np.complex128)
    step = max(1, _CHUNK // max(1, gain.shape[1] * len(at_s)))
    for start in range(0, len(gain), step):
        part = slice(start, start + step)
        delays = delay_s[part] + _HAIR_S
        # sin(x - y) = sin x cos y - cos x sin y leaves one division per term instead of one sine.
        inverse = 1.0 / (turn * (at_s[None, None, :] - delays[:, :, None]))
        cosine, sine = gain[part] * np.cos(turn * delays), gain[part] * np.sin(turn * delays)
        sums = np.stack([cosine.real, cosine.imag, sine.real, sine.imag], axis=1) @ inverse
        out[part] = np.sin(turn * at_s) * (sums[:, 0] + 1j * sums[:, 1])
        out[part] -= np.cos(turn * at_s) * (sums[:, 2] + 1j * sums[:, 3])
    return out


def loss(delay_s, gain, tap_delay_s, tap_gain, bandwidth_hz: float) -> Loss:
    """What taps (T, K) lose of paths (T, P) over the band."""
    both_s = np.concatenate([delay_s, tap_delay_s], axis=1)
    error = in_band_power(both_s, np.concatenate([gain, -tap_gain], axis=1), bandwidth_hz)
    before = in_band_power(delay_s, gain, bandwidth_hz)
    after = in_band_power(tap_delay_s, tap_gain, bandwidth_hz)
    if (before == 0).any():
        raise CastError("loss: a channel without any path has no relative error")
    return Loss(
        nmse_db=db_from_power(error / before),
        power_error_db=db_from_power(after / before),
        delay_spread_error_s=delay_spread_s(tap_delay_s, tap_gain) - delay_spread_s(delay_s, gain),
    )


def delay_spread_s(delay_s: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Root-mean-square delay spread of each instant, weighted by power, (T,)."""
    power = np.abs(gain) ** 2
    total = np.maximum(power.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    mean_s = (power * delay_s).sum(axis=1, keepdims=True) / total
    return np.sqrt((power * (delay_s - mean_s) ** 2).sum(axis=1) / total[:, 0])
