# SPDX-License-Identifier: GPL-3.0-or-later
"""Carrier frequency offset of a received periodic waveform: found by search over delay and frequency, then refined."""

from dataclasses import dataclass

import numpy as np
from scipy.fft import fft, fftfreq, ifft, next_fast_len
from scipy.optimize import minimize_scalar

from .cir import detection_threshold
from .correlate import Template
from .receive import Periods, remove_offset

_SEARCH_SAMPLES = 1 << 18  # as many as one hypothesis is tried on: 60 dB of processing gain are enough to find a carrier
_MAX_HYPOTHESES = 4001


@dataclass(frozen=True, kw_only=True)
class CarrierOffset:
    """Offset in cycles per sample with its standard deviation; `found` is False, and the offset 0, without a signal. One that
    is `known` was not estimated."""

    cycles_per_sample: float
    std_cycles_per_sample: float
    found: bool
    searched: float  # cycles per sample to either side
    known: bool = False


NO_OFFSET = CarrierOffset(cycles_per_sample=0.0, std_cycles_per_sample=np.inf, found=False, searched=np.inf)


def _delay_doppler(periods: Periods, template: Template, offset: float) -> np.ndarray:
    """|matched filter|² over delay (rows) and Doppler (columns, cycles per period), one coherent sum over all periods."""
    responses = template.matched_filter(remove_offset(periods.samples, offset, periods.start_sample).T)
    return np.abs(fft(responses, next_fast_len(2 * responses.shape[1]), axis=1, workers=1)) ** 2


def find_offset(periods: Periods, template: Template, *, max_offset: float, false_alarm_rate: float = 1e-4) -> CarrierOffset:
    """Carrier offset within ±max_offset (cycles per sample) of periods sent without a gap between them.

    Coarse: a delay × Doppler map for every half cycle per period, coherent over up to 2^18 samples. Fine: the phase of
    the period-by-period response at the strongest delay, maximum likelihood for one frequency in white noise.
    """
    length = template.window
    take = max(1, min(len(periods.samples), _SEARCH_SAMPLES // length))
    # A whole run: a Doppler axis needs equal steps.
    steps = np.diff(periods.start_sample[:take]) != length
    take = int(np.argmax(steps)) + 1 if steps.any() else take
    some = Periods(samples=periods.samples[:take], start_sample=periods.start_sample[:take])
    spacing = 0.5 / length
    reach = min(int(np.ceil(max_offset / spacing)), _MAX_HYPOTHESES // 2)
    best = (-1.0, 0.0)
    for step in range(-reach, reach + 1):
        power = _delay_doppler(some, template, step * spacing)
        row, column = np.unravel_index(np.argmax(power), power.shape)
        if power[row, column] > best[0]:
            best = (power[row, column], step * spacing + fftfreq(power.shape[1])[column] / length)
    peak, offset = best
    noise = _noise_by_differences(some) or float(np.mean(np.abs(some.samples) ** 2))
    trials = length * take * (2 * reach + 1)
    threshold = detection_threshold(false_alarm_rate, trials, template.rms_bandwidth_rad)
    if peak / (template.energy * take) < threshold * noise:
        return NO_OFFSET
    offset, std = refine_offset(periods, template, offset, known_over=take * length)
    return CarrierOffset(cycles_per_sample=offset, std_cycles_per_sample=std, found=True, searched=reach * spacing)


def find_beyond(samples: np.ndarray, template: Template, *, false_alarm_rate: float = 1e-4) -> float | None:
    """Offset (cycles per sample) of a carrier that is farther off than was searched, from periods `samples` (periods, length)
    turned back by what was found; None unless the code stands out there fourfold.

    From period to period such a carrier turns as one nearer by a whole number of cycles, so that only those are tried.
    """
    length = template.window
    turn = float(np.angle(np.vdot(samples[:-1], samples[1:]))) / (2 * np.pi * length) if len(samples) > 1 else 0.0
    steady = remove_offset(samples, turn, length * np.arange(len(samples)))
    mean = steady.mean(axis=0, dtype=np.complex128)
    noise = _noise_by_differences(Periods(samples=steady, start_sample=np.arange(len(steady))))
    noise = float(np.mean(np.abs(mean) ** 2)) if noise is None else noise / len(samples)
    reach = min(length // 2, _MAX_HYPOTHESES // 2)
    cycles = np.arange(-reach, reach + 1)
    spectrum = fft(mean)
    peaks = np.array([np.max(np.abs(ifft(np.roll(spectrum, -k) * np.conj(template.spectrum))) ** 2) for k in cycles])
    best = int(np.argmax(peaks))
    threshold = detection_threshold(false_alarm_rate, length * len(cycles), template.rms_bandwidth_rad)
    if peaks[best] < max(4 * peaks[reach], threshold * noise * template.energy):
        return None
    return turn + cycles[best] / length


def _noise_by_differences(periods: Periods) -> float | None:
    """Noise power per sample from what changes between one period and the next but one turn of the carrier."""
    if len(periods.samples) < 4:
        return None
    first, second = periods.samples[:-1].reshape(-1), periods.samples[1:].reshape(-1)
    turn = np.vdot(first, second)
    turn = turn / abs(turn) if turn else 1.0
    return float(np.mean(np.abs(second - turn * first) ** 2) / 2)


def refine_offset(periods: Periods, template: Template, offset: float, *, known_over: float) -> tuple[float, float]:
    """Maximum-likelihood offset from the response at the strongest delay, period by period, and its standard deviation;
    `offset` keeps that response coherent over the first `known_over` samples."""
    turned = remove_offset(periods.samples, offset, periods.start_sample)
    responses = template.matched_filter(turned.T)
    strongest = int(np.argmax(np.sum(np.abs(responses) ** 2, axis=1)))
    if len(turned) < 8:  # too few to tell noise from offset: sample by sample, the waveform wiped off
        track = (turned * np.conj(template.columns([strongest])[:, 0])).reshape(-1)
        time, step = (periods.start_sample[:, None] + np.arange(template.window)).reshape(-1), 1
    else:
        track, time, step = responses[strongest], periods.start_sample, template.window
    change, std = strongest_frequency(track, time, step, known_over)
    if len(turned) == 1 and abs(change) < 4 * std:
        change = 0.0  # within one period an echo turns the phase as much: a doubtful offset is not corrected
    return offset + change, std


def strongest_frequency(track: np.ndarray, time: np.ndarray, step: float, known_over: float) -> tuple[float, float]:
    """Frequency (cycles per sample) of one exponential in noise near 0, at times in samples about `step` apart.

    0 is good enough to stay coherent over `known_over` samples; the span grows from there, fourfold a time, so that the
    search never reaches a sidelobe. Also gives the standard deviation (Rife and Boorstyn 1974).
    """
    time = time.astype(float) - time[0]
    end = time[-1] + step
    span, frequency = min(known_over, end), 0.0
    while True:
        frequency = _peak_frequency(track[time < span], time[time < span], frequency, 0.5 / span)
        if span >= end:
            break
        span = min(4 * span, end)
    steady = track * np.exp(-2j * np.pi * frequency * time)
    amplitude = np.mean(steady)
    noise = max(float(np.mean(np.abs(steady - amplitude) ** 2)), 1e-12 * abs(amplitude) ** 2)
    spread = max(float(np.sum((time - time.mean()) ** 2)), 1.0)
    return frequency, float(np.sqrt(noise / (2 * abs(amplitude) ** 2 * spread)) / (2 * np.pi))


def _peak_frequency(track: np.ndarray, time: np.ndarray, near: float, reach: float) -> float:
    """The frequency within `near` ± `reach` at which the track adds up to most."""

    def minus_power(frequency):
        return -(np.abs(np.sum(track * np.exp(-2j * np.pi * frequency * time))) ** 2)

    grid = near + np.linspace(-reach, reach, 9)
    start = grid[np.argmin([minus_power(frequency) for frequency in grid])]
    bounds = (start - reach / 4, start + reach / 4)
    return float(minimize_scalar(minus_power, bounds=bounds, method="bounded", options={"xatol": 1e-5 * reach}).x)


def find_offset_once(
    samples: np.ndarray, known: np.ndarray, *, max_offset: float, false_alarm_rate: float = 1e-4
) -> tuple[CarrierOffset, int]:
    """Where a waveform sent once starts in `samples` (index of known[0]), and its carrier offset.

    A stretch of up to 4096 known samples is correlated with the recording for every half cycle of offset over it,
    relative to the energy received there, so that a louder signal elsewhere does not win.
    """
    size = min(len(known), 4096)
    head = int(np.argmax(_window_energy(known, size)))
    piece = known[head : head + size]
    grid = next_fast_len(len(samples) + size)
    spectrum = fft(samples, grid)
    received = _window_energy(np.concatenate([samples, np.zeros(size)]), size)[: len(samples)]
    received = np.maximum(received, 1e-3 * received.mean() + 1e-30) * float(np.sum(np.abs(piece) ** 2))
    n = np.arange(size)
    spacing = 0.5 / size
    reach = min(int(np.ceil(max_offset / spacing)), _MAX_HYPOTHESES // 2)
    best = (-1.0, 0, 0.0)
    for step in range(-reach, reach + 1):
        hypothesis = piece * np.exp(2j * np.pi * step * spacing * n)
        response = ifft(spectrum * np.conj(fft(hypothesis, grid)))[: len(samples)]
        share = np.abs(response) ** 2 / received
        peak = int(np.argmax(share))
        if share[peak] > best[0]:
            best = (float(share[peak]), peak, step * spacing)
    share, peak, offset = best
    start = peak - head
    trials = len(samples) * (2 * reach + 1)
    chance = trials * np.exp((size - 1) * np.log1p(-min(share, 1 - 1e-12)))  # (1 − share)^(n−1) for each trial
    if chance > false_alarm_rate:
        return NO_OFFSET, start
    low, high = max(start, 0), min(start + len(known), len(samples))
    track = samples[low:high] * np.conj(known[low - start : high - start])
    time = np.arange(len(track))
    change, std = strongest_frequency(track * np.exp(-2j * np.pi * offset * time), time, 1, size)
    total = offset + change
    if abs(total) < 4 * std or max_offset == 0:
        total = 0.0
    return CarrierOffset(cycles_per_sample=total, std_cycles_per_sample=std, found=True, searched=reach * spacing), start


def _window_energy(samples: np.ndarray, size: int) -> np.ndarray:
    """Energy of every stretch of `size` samples: (n − size + 1,)."""
    total = np.concatenate([[0.0], np.cumsum(np.abs(samples.astype(np.complex128)) ** 2)])
    return total[size:] - total[:-size]
