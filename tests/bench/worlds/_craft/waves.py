# SPDX-License-Identifier: GPL-3.0-or-later
"""Waveforms: a period or a burst at the recording's rate, and the band-limited signal between its samples."""

from dataclasses import dataclass, field

import numpy as np

FINE = 4  # samples of the transmitted signal per sample of the recording, where it is distorted
PAD = 2048  # silence on either side of a burst, so that filters and tails can ring
REACH = 10  # half the taps of the interpolating kernel, on the fine grid
ROWS = 2048  # its tabulated fractions


@dataclass(frozen=True, kw_only=True)
class Wave:
    name: str
    samples: np.ndarray
    repeat: bool
    samples_per_chip: int = 1
    band: float = 0.8  # share of the sample rate that it occupies
    real: bool = False  # BPSK: its image is itself
    flat: bool = False  # constant envelope: shows one point of an amplifier
    unique: bool = True  # another seed gives a waveform that has nothing in common with it
    extra: dict = field(default_factory=dict)

    @property
    def period(self):
        return len(self.samples)


def upsampled(x, factor=FINE):
    """Trigonometric interpolation of a period on a finer grid; the bin at half the rate is shared by both sides."""
    n = len(x)
    spectrum = np.fft.fft(x)
    wide = np.zeros(n * factor, complex)
    half = n // 2
    wide[: half + 1] = spectrum[: half + 1]
    wide[len(wide) - (n - half - 1) :] = spectrum[half + 1 :]
    if n % 2 == 0:
        wide[half] = spectrum[half] / 2
        wide[len(wide) - half] = spectrum[half] / 2
    return np.fft.ifft(wide) * factor


def _table():
    fraction = np.arange(ROWS + 1)[:, None] / ROWS
    place = np.arange(-REACH + 1, REACH + 1)[None, :] - fraction
    window = np.i0(11.0 * np.sqrt(np.clip(1 - (place / REACH) ** 2, 0, 1))) / np.i0(11.0)
    return np.sinc(place) * window


TABLE = _table()


class Sheet:
    """The transmitted signal on its fine grid; `at` gives it at any instant, in samples of the recording."""

    def __init__(self, wave, fine=None):
        self.wave = wave
        if fine is None:
            x = np.asarray(wave.samples, complex)
            fine = upsampled(x if wave.repeat else np.concatenate([np.zeros(PAD), x, np.zeros(PAD)]))
        self.fine = fine

    def frequencies(self):
        """Of the fine grid's bins, in cycles per sample of the recording."""
        return np.fft.fftfreq(len(self.fine)) * FINE

    def changed(self, fine):
        return Sheet(self.wave, fine)

    def filtered(self, response):
        return self.changed(np.fft.ifft(np.fft.fft(self.fine) * response))

    def at(self, instants):
        u = np.asarray(instants, float)
        out = np.empty(len(u), complex)
        length = len(self.fine)
        for a in range(0, len(u), 40000):
            v = u[a : a + 40000] * FINE + (0 if self.wave.repeat else PAD * FINE)
            whole = np.floor(v).astype(np.int64)
            row = (v - whole) * ROWS
            low = np.minimum(row.astype(np.int64), ROWS - 1)
            weight = TABLE[low] + (row - low)[:, None] * (TABLE[low + 1] - TABLE[low])
            index = whole[:, None] + np.arange(-REACH + 1, REACH + 1)[None, :]
            if self.wave.repeat:
                values = self.fine[index % length]
            else:
                values = np.where((index >= 0) & (index < length), self.fine[np.clip(index, 0, length - 1)], 0)
            out[a : a + 40000] = np.einsum("ij,ij->i", values, weight)
        return out

    def on_lattice(self, n, delay):
        """At n − delay for whole n that follow one another: one period is worked out, and laid end to end."""
        period = self.wave.period
        if not self.wave.repeat or len(n) <= period:
            return self.at(n - delay)
        one = self.at(np.arange(period) - delay)
        return one[np.asarray(n) % period]


# ---------------------------------------------------------------- making waveforms
def root_raised_cosine(f, rolloff):
    """Spectrum over frequency in symbol rates."""
    f = np.abs(f)
    a, b = (1 - rolloff) / 2, (1 + rolloff) / 2
    edge = np.cos(np.pi / (2 * max(rolloff, 1e-9)) * (f - a))
    return np.where(f <= a, 1.0, np.where(f < b, edge, 0.0))


def rectangle(f):
    """Of one symbol's length, over frequency in symbol rates."""
    return np.sinc(f)


def lowpass(f, edge, width):
    """1 up to edge − width, a raised cosine down to 0 at edge (cycles per sample)."""
    x = np.clip((np.abs(f) - (edge - width)) / width, 0, 1)
    return 0.5 + 0.5 * np.cos(np.pi * x)


def shaped(symbols, period, pulse, stagger=0.0):
    """A period of any length, odd or prime too, of a periodic train of pulses: the train's Fourier series, times the pulse's.

    pulse(f) with f in symbol rates; stagger shifts the imaginary part by that share of a symbol (offset QPSK).
    """
    symbols = np.asarray(symbols)
    harmonics = np.rint(np.fft.fftfreq(period) * period).astype(int)
    shape = pulse(harmonics / len(symbols)) * lowpass(harmonics / period, 0.49, 0.05)

    def series(values, late):
        line = np.fft.fft(values)[harmonics % len(symbols)]
        return np.fft.ifft(line * shape * np.exp(-2j * np.pi * harmonics * late / len(symbols)))

    if stagger:
        return series(symbols.real, 0.0) + 1j * series(symbols.imag, stagger)
    return series(symbols, 0.0)


def decimated(fine, period):
    """A period on a fine grid brought down to `period` samples, with what lies above half their rate removed."""
    spectrum = np.fft.fft(fine)
    k = np.rint(np.fft.fftfreq(period) * period).astype(int)
    return np.fft.ifft(spectrum[k % len(fine)] * lowpass(k / period, 0.495, 0.03)) * period / len(fine)


def shift_keyed(levels, period, index, product=None, fine=8):
    """Continuous-phase FSK over one period: levels in units of half the spacing, modulation index, Gaussian BT (or none).

    The phase must close over the period; what is missing is spread as a carrier offset far below one line.
    """
    steps = np.zeros(period * fine)
    symbol = (np.arange(period * fine) * len(levels)) // (period * fine)
    steps[:] = np.asarray(levels, float)[symbol]
    if product is not None:
        f = np.fft.fftfreq(len(steps)) * len(steps) / len(levels)  # symbol rates
        steps = np.fft.ifft(np.fft.fft(steps) * np.exp(-(np.log(2) / 2) * (f / product) ** 2)).real
    phase = np.cumsum(steps) * np.pi * index * len(levels) / len(steps)
    phase -= np.arange(len(phase)) / len(phase) * (phase[-1] - 2 * np.pi * np.rint(phase[-1] / (2 * np.pi)))
    return decimated(np.exp(1j * phase), period)


def normal(x, peak=0.95):
    """Scaled to a peak that a converter takes."""
    return np.asarray(x) * (peak / np.max(np.abs(x)))


def register(taps, length, state):
    """A shift register's output bits: taps (1-based) fed back; state an integer other than 0."""
    order = max(taps)
    bits = [(state >> k) & 1 for k in range(order)]
    out = np.empty(length, int)
    for i in range(length):
        out[i] = bits[-1]
        back = 0
        for t in taps:
            back ^= bits[t - 1]
        bits = [back] + bits[:-1]
    return out
