# SPDX-License-Identifier: GPL-3.0-or-later
"""The contract's channel twice: by GNU Radio's filters (`play`), and as its closed formula (`predict`)."""

import numpy as np
from gnuradio import filter

from . import flow


def amplitude(tap):
    return 10 ** (tap["gain_db"] / 20) * np.exp(1j * tap["phase_rad"])


def kernel(offsets, gains, period):
    """FIR of band-limited delays (samples) about its middle: Dirichlet's if periodic, else windowed sinc."""
    if period:
        count, f = period, np.fft.fftfreq(period)
        turns = np.exp(-2j * np.pi * np.outer(np.asarray(offsets) + period // 2, f))
        if period % 2 == 0:
            turns[:, period // 2] = turns[:, period // 2].real
        return np.fft.ifft(np.asarray(gains) @ turns)
    count = 801 + 2 * int(np.ceil(max(offsets)))
    lag = np.arange(count)[None, :] - count // 2 - np.asarray(offsets)[:, None]
    window = np.where(np.abs(lag) <= 400, np.i0(12 * np.sqrt(np.clip(1 - (lag / 400) ** 2, 0, 1))) / np.i0(12), 0)
    return np.asarray(gains) @ (np.sinc(lag) * window)


def play(stream, taps, *, rate, first, offset, period, fading=None):
    """A transmitted stream through taps, one `fft_filter_ccc` per Doppler; aligned with its input.

    taps: contract's entries; offset: bulk delay below one sample; first: index of t = 0;
    fading: {tap index: stream}.
    """
    fading = fading or {}
    groups = {}
    for index, tap in enumerate(taps):
        key = (tap["doppler_hz"], index if index in fading else None)
        groups.setdefault(key, []).append(tap)
    out = np.zeros(len(stream), complex)
    for (doppler, index), group in groups.items():
        h = kernel([t["delay_s"] * rate + offset for t in group], [amplitude(t) for t in group], period)
        ahead = np.concatenate([stream, np.zeros(len(h) + 8192)])
        y = flow.through(ahead, filter.fft_filter_ccc(1, h.astype(complex).tolist()))
        y = y[len(h) // 2 :][: len(stream)]
        if doppler:
            y = flow.multiply(y, flow.oscillator(doppler / rate, len(y), first))
        if index is not None:
            y = flow.multiply(y, fading[index])
        out = flow.add(out, y)
    return out


def predict(waveform, taps, *, rate, delay, count):
    """The contract's formula in NumPy: Σ taps g·e^{j2πft}·x(t − delay_s − delay), t = 0 at the first sample.

    delay: bulk delay in samples, any real number. waveform: waveforms.Waveform.
    """
    n, out = np.arange(count), np.zeros(count, complex)
    x = waveform.samples
    if not waveform.repeat:
        span = len(x) + count + int(np.ceil(abs(delay) + max(t["delay_s"] for t in taps) * rate)) + 2048
        x = np.concatenate([x, np.zeros(1 << (span - 1).bit_length())])[: 1 << (span - 1).bit_length()]
    spectrum, f = np.fft.fft(x), np.fft.fftfreq(len(x))
    for tap in taps:
        turn = np.exp(-2j * np.pi * f * (delay + tap["delay_s"] * rate))
        if len(x) % 2 == 0:
            turn[len(x) // 2] = turn[len(x) // 2].real
        y = np.fft.ifft(spectrum * turn)
        y = np.resize(y, count) if waveform.repeat else y[:count]
        out += amplitude(tap) * y * np.exp(2j * np.pi * tap["doppler_hz"] / rate * n)
    return out
