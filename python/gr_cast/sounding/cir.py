# SPDX-License-Identifier: GPL-3.0-or-later
"""Channel impulse response: which taps are there at a stated false-alarm rate, and their delays and gains.

Taps are found one by one in the matched filter of what is left, then all are refitted together by least squares, which
in white noise is the maximum-likelihood estimate (Kay, Estimation Theory, ch. 7; Golub and Pereyra 1973 for the delays).
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import betaln, gammaincinv

from .correlate import OVERSAMPLING, Template

DB_PER_NEPER = 20 / np.log(10)
FLOAT32_ROUNDING = 2.0**-48  # least noise of float32 samples over their power: no measurement is without noise
FLOAT32_HALF_UNIT = 2.0**-50  # what rounding may leave over the power: it repeats with the code and no averaging lowers it
LEAST_APART = 0.5  # samples between two taps; closer ones are one tap with what is left of them
LEAST_SURE = 1.0  # error of a tap's gain over the gain, beyond which it is no tap of its own
_MEDIAN_EFFICIENCY = np.log(2) ** 2  # of a median against a mean, as an estimate of an exponential variable's scale


@dataclass(frozen=True, kw_only=True)
class Taps:
    """Taps in order of delay. Arrays (k,), complex gains (k, blocks); standard deviations are the Cramér-Rao bound's."""

    delay_samples: np.ndarray
    gain: np.ndarray
    delay_std_samples: np.ndarray
    gain_std: np.ndarray  # of |gain|, per block
    phase_std_rad: np.ndarray
    noise_variance: float  # per sample of a block, as used
    smallest_power: float  # the limit: no tap below it is reported

    @property
    def power(self) -> np.ndarray:
        """Mean power of each tap over the blocks, (k,), noise bias removed where it is a mean of powers."""
        power = np.mean(np.abs(self.gain) ** 2, axis=1)
        if self.gain.shape[1] == 1:
            return power
        return np.maximum(power - 2 * self.gain_std**2, np.finfo(float).tiny)

    @property
    def gain_std_db(self) -> np.ndarray:
        """Standard deviation of the mean gain, dB, (k,)."""
        blocks = self.gain.shape[1]
        return DB_PER_NEPER * self.gain_std / np.sqrt(blocks * self.power)


def detection_threshold(
    false_alarms_per_cir: float, delays: float, rms_bandwidth_rad: float, blocks: int = 1, noise_freedom: float = np.inf
) -> float:
    """Level that Σ_blocks |matched filter|²/noise exceeds somewhere at the stated rate when there is noise alone.

    Expected up-crossings of a χ² process over `delays` samples (Rice 1945): delays·β·√(u/π)·p(u), with p the density
    of the statistic and β its rms bandwidth; `noise_freedom` (complex) is that of the noise estimate.
    """
    freedom = min(noise_freedom, 1e9)
    scale = betaln(blocks, freedom) + blocks * math.log(freedom)

    def over(u):
        """ln of the expected crossings over those stated; the density is that of blocks · F(2 blocks, 2 freedom)."""
        density = (blocks - 1) * math.log(u) - (blocks + freedom) * math.log1p(u / freedom) - scale
        return math.log(delays * rms_bandwidth_rad * math.sqrt(u / math.pi) / false_alarms_per_cir) + density

    low = blocks + 1.0
    high = 2.0 * low
    while over(high) > 0:
        high *= 2
    return brentq(over, low, high)


def _inverse(columns):
    """What makes least-squares amplitudes of samples, (k, window): taps are few and blocks many, for which it is made once."""
    return np.linalg.pinv(columns, rcond=np.finfo(float).eps * len(columns))


def _normal_matrix(columns, inverse, slopes, gain):
    """The slopes clear of the columns, and the normal matrix of the delays for amplitudes `gain`."""
    clear = slopes - columns @ (inverse @ slopes)
    return clear, np.real((clear.conj().T @ clear) * (gain.conj() @ gain.T))


def _refit(template, observed, delays, limit=0.5, iterations=25):
    """Joint least squares of all delays and amplitudes by variable projection; delays move `limit` samples a step."""

    def fit(delays):
        columns = template.columns(delays)
        inverse = _inverse(columns)
        gain = inverse @ observed
        rest = observed - columns @ gain
        return columns, inverse, gain, rest, np.vdot(rest, rest).real

    if not len(delays):
        return delays, np.empty((0, observed.shape[1]), complex)
    columns, inverse, gain, rest, before = fit(delays)
    for _ in range(iterations):
        clear, normal = _normal_matrix(columns, inverse, template.slopes(delays), gain)
        gradient = np.real(np.sum(gain.conj() * (clear.conj().T @ rest), axis=1))
        step = np.clip(np.linalg.lstsq(normal, gradient, rcond=None)[0], -limit, limit)
        there = fit(delays + step)
        if there[-1] > before:
            limit /= 4
            if limit < 1e-7:
                break
            continue
        delays, (columns, inverse, gain, rest, before) = delays + step, there
        if np.max(np.abs(step)) < 1e-8:
            break
    return delays, gain


def _strongest(template, power, taken, separation, delays_searched):
    """The delay (samples) and power of the strongest peak of `_powers` clear of the `taken` delays."""
    axis = np.arange(len(power)) / OVERSAMPLING
    allowed = axis < delays_searched if not template.circular else np.ones(len(power), bool)
    for delay in taken:
        distance = np.abs(axis - delay)
        if template.circular:
            distance = np.minimum(distance, template.grid - distance)
        allowed &= distance >= separation
    if not allowed.any():
        return None
    masked = np.where(allowed, power, -1.0)
    peak = int(np.argmax(masked))
    # The parabola through a peak and its neighbours; at the edge of what is allowed there is no peak to refine.
    left, here, right = power[peak - 1], power[peak], power[(peak + 1) % len(power)]
    bend = left - 2 * here + right
    shift = 0.5 * (left - right) / bend if here >= max(left, right) and bend < 0 else 0.0
    return axis[peak] + shift / OVERSAMPLING, here - 0.25 * (left - right) * shift


def _standard_deviations(template, delays, gain, noise_variance):
    """Cramér-Rao bounds of delay (samples), |gain| and phase, (k,) each, for the amplitudes at hand."""
    columns, slopes = template.columns(delays), template.slopes(delays)
    inverse = _inverse(columns)
    delay_covariance = noise_variance / 2 * np.linalg.pinv(_normal_matrix(columns, inverse, slopes, gain)[1])
    # An amplitude moves with the delays by −A⁺·D·x: its share of the delays' errors comes on top of the noise.
    coupling = -inverse @ slopes
    rms_gain = np.sqrt(np.mean(np.abs(gain) ** 2, axis=1))
    direction = gain[:, 0] / np.maximum(np.abs(gain[:, 0]), np.finfo(float).tiny)
    moved = coupling * (rms_gain * direction)[None, :] * direction.conj()[:, None]
    along = np.einsum("ki,ij,kj->k", moved.real, delay_covariance, moved.real)
    across = np.einsum("ki,ij,kj->k", moved.imag, delay_covariance, moved.imag)
    noise = noise_variance / 2 * np.sum(np.abs(inverse) ** 2, axis=1)
    return (
        np.sqrt(np.diag(delay_covariance)),
        np.sqrt(noise + along),
        np.sqrt(noise + across) / rms_gain,
    )


def _are_apart(template: Template, delays: np.ndarray, gain: np.ndarray, noise_variance: float) -> bool:
    """Whether the band tells these taps from each other: two within a small part of a sample have gains of any size."""
    if len(delays) < 2:
        return True
    around = np.sort(np.mod(delays, template.grid))
    if min(np.diff(around).min(), around[0] + template.grid - around[-1]) < LEAST_APART:
        return False
    rms_gain = np.sqrt(np.mean(np.abs(gain) ** 2, axis=1))
    _, gain_std, _ = _standard_deviations(template, delays, gain, noise_variance)
    return bool(np.all(gain_std < np.sqrt(gain.shape[1]) * LEAST_SURE * rms_gain))


def _spurs(gain: np.ndarray, spur: float) -> float:
    """The most power that what taps leave at other delays may add up to at one."""
    return float((spur * np.sqrt(np.mean(np.abs(gain) ** 2, axis=1)).sum()) ** 2)


def _powers(template: Template, rest: np.ndarray) -> np.ndarray:
    """Σ_blocks |matched filter|²/energy every 1/OVERSAMPLING samples, in noise of variance 1 a gamma variable of the blocks."""
    return np.sum(np.abs(template.matched_filter(rest, OVERSAMPLING)) ** 2, axis=1) / template.energy


def _unsteady(power: np.ndarray, blocks: int, noise: float) -> float:
    """Variance per sample, beyond the noise, of what blocks of a moving channel leave at every delay; 0 where it is chance.

    Taps that change within a period do not add up to its code: the rest has one pattern over the delays in all blocks, whose
    `power` (delays,) is taken as exponential. It shows in the median, and in the quartiles where it has passed for noise.
    """
    if blocks == 1:
        return 0.0
    low, median, high = np.percentile(power, (25, 50, 75)) / blocks
    chance = 3 * noise / np.sqrt(blocks * _MEDIAN_EFFICIENCY * len(power))
    level = median - noise * gammaincinv(blocks, 0.5) / blocks
    width = high - low - noise * np.diff(gammaincinv(blocks, (0.25, 0.75)))[0] / blocks
    return max(level / np.log(2) if level > chance else 0.0, width / np.log(3) if width > 2 * chance else 0.0)


def estimate_taps(
    observed: np.ndarray,
    template: Template,
    *,
    noise_variance: float | None = None,
    noise_freedom: float = np.inf,
    false_alarm_rate: float = 1e-3,
    max_taps: int = 64,
    separation_samples: float = 1.0,
    delays_searched: float | None = None,
    spur: float = 0.0,
) -> Taps:
    """Find and fit the taps of `observed` = Σ_k gain[k]·s(n − delay[k]) + white noise.

    observed: (window,) or (window, blocks) complex, blocks sharing delays but not amplitudes. noise_variance: of a
    complex sample of a block, known with `noise_freedom` complex degrees of freedom; None reads it off the delays without taps.
    No two taps are closer than `separation_samples`, none is below the stated limit (`smallest_power`). `delays_searched`
    bounds the delays of a waveform sent once. `spur` is the amplitude, over a tap's, of what each leaves at other delays: it
    repeats with the waveform, so that no averaging and no longer waveform lowers it, and may add up over the taps.
    """
    observed = observed.reshape(len(observed), -1).astype(np.complex128)
    blocks = observed.shape[1]
    span = template.grid if template.circular else min(delays_searched or template.grid, template.grid)
    known_noise = noise_variance is not None
    if not known_noise:
        noise_freedom = _MEDIAN_EFFICIENCY * span * blocks
    threshold = detection_threshold(false_alarm_rate, span, template.rms_bandwidth_rad, blocks, noise_freedom)
    one_block = detection_threshold(false_alarm_rate, span, template.rms_bandwidth_rad) if blocks > 1 else 0.0
    least_noise = FLOAT32_ROUNDING * float(np.mean(np.abs(observed) ** 2))
    delays = np.empty(0)
    gain = np.empty((0, blocks), complex)
    rest = observed
    while True:
        power = _powers(template, rest)
        whole = power[::OVERSAMPLING][:span]
        noise = noise_variance if known_noise else max(np.median(whole) / gammaincinv(blocks, 0.5), least_noise)
        unsteady = one_block * _unsteady(whole, blocks, noise)
        found = _strongest(template, power, delays, separation_samples, span)
        least = max(threshold * noise + blocks * unsteady, blocks * template.energy * _spurs(gain, spur))
        if found is None or len(delays) >= max_taps or not found[1] > least:
            break
        more = _refit(template, observed, np.append(delays, found[0]))
        if not _are_apart(template, *more, noise):
            break
        delays, gain = more
        rest = observed - template.columns(delays) @ gain
    # Powers of several blocks are reported without their noise, that of one block with it.
    surplus = threshold if blocks == 1 else (threshold - blocks) / blocks
    rounding = FLOAT32_HALF_UNIT * float(np.mean(np.abs(observed) ** 2))
    limit = max((surplus * noise + unsteady) / template.energy, rounding, _spurs(gain, spur))
    taps = _in_order(template, delays, gain, noise, limit)
    while len(taps.delay_samples) and taps.power.min() < limit:  # together they may be weaker than one by one
        delays, gain = _refit(template, observed, np.delete(taps.delay_samples, np.argmin(taps.power)))
        taps = _in_order(template, delays, gain, noise, limit)
    return taps


def _in_order(template: Template, delays, gain, noise: float, limit: float) -> Taps:
    if template.circular:
        delays = np.mod(delays + 0.5, template.grid) - 0.5  # a tap at zero stays there when noise makes it early
    order = np.argsort(delays)
    delays, gain = delays[order], gain[order]
    empty = np.empty(0)
    stds = _standard_deviations(template, delays, gain, noise) if len(delays) else (empty, empty, empty)
    return Taps(
        delay_samples=delays,
        gain=gain,
        delay_std_samples=stds[0],
        gain_std=stds[1],
        phase_std_rad=stds[2],
        noise_variance=float(noise),
        smallest_power=float(limit),
    )
