# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmitted waveforms: built-in codes, and the pulses and carriers from which the worlds make theirs."""

from dataclasses import dataclass, field

import numpy as np
from scipy.fft import fft, fftfreq, ifft

MASKS = {5: 0x12, 6: 0x21, 7: 0x41, 8: 0x8E, 9: 0x108, 10: 0x204, 11: 0x402}
PAIRS = {63: ((6, 1, 0), (6, 5, 2, 1, 0)), 127: ((7, 3, 0), (7, 3, 2, 1, 0)), 511: ((9, 4, 0), (9, 6, 4, 3, 0))}


@dataclass(kw_only=True)
class Wave:
    """samples: what is transmitted, one period or all of it; known: where the file tells it; entry: a built-in code."""

    name: str
    samples: np.ndarray
    repeat: bool = True
    entry: dict | None = None
    known: np.ndarray | None = None
    samples_per_chip: float = 1.0
    limited: bool = True  # its spectrum ends well inside the sampled band
    family: dict = field(default_factory=dict)

    def __post_init__(self):
        """Between samples the Nyquist frequency is not defined: a repeated file holds nothing there."""
        n = len(self.samples)
        if self.repeat and self.entry is None and n % 2 == 0:
            turn = 1 - 2.0 * (np.arange(n) % 2)
            self.samples = self.samples - np.mean(self.samples * turn) * turn

    @property
    def real(self):
        return bool(np.max(np.abs(self.samples.imag)) < 1e-9 * np.max(np.abs(self.samples)))

    @property
    def power(self):
        return float(np.mean(np.abs(self.samples) ** 2))

    @property
    def on_power(self):
        p = np.abs(self.samples) ** 2
        return float(np.mean(p[p > 1e-6 * p.max()]))

    @property
    def variation(self):
        """Variance of the envelope's square over its mean's square: zero where the envelope is constant."""
        p = np.abs(self.samples) ** 2
        p = p[p > 1e-6 * p.max()]
        return float(np.var(p) / np.mean(p) ** 2)

    def band(self, below_db=20.0):
        """(lowest, highest) frequency in cycles per sample whose smoothed density is within `below_db` of the highest."""
        s = np.abs(fft(self.samples)) ** 2
        f = fftfreq(len(s))
        edges = np.linspace(-0.5, 0.5, 129)
        which = np.digitize(f, edges) - 1
        d = np.bincount(np.clip(which, 0, 127), s, 128) / np.maximum(np.bincount(np.clip(which, 0, 127), minlength=128), 1)
        hit = np.flatnonzero(d > d.max() * 10 ** (-below_db / 10))
        return float(edges[hit[0]]), float(edges[hit[-1] + 1])


# ---------------------------------------------------------------- built-in codes
def glfsr(degree, seed):
    state, chips = seed, np.empty(2**degree - 1)
    for n in range(len(chips)):
        chips[n] = 2.0 * (state & 1) - 1
        state = (state >> 1) ^ (MASKS[degree] if state & 1 else 0)
    return chips


def gold(length):
    bits = np.zeros(length, int)
    for exponents in PAIRS[length]:
        degree = exponents[0]
        a = np.zeros(length, int)
        a[0] = 1
        for n in range(degree, length):
            a[n] = np.bitwise_xor.reduce([a[n - degree + e] for e in exponents[1:]])
        bits ^= a
    return 2.0 * bits - 1


def ls():
    a, b = np.array([1, 1]), np.array([-1, 1])
    while len(a) < 256:
        a, b = np.concatenate([a, b]), np.concatenate([a, -b])
    return a.astype(float)


def golay128(second=False):
    a = np.zeros(128)
    a[0] = 1
    b = a.copy()
    for delay, weight in zip((1, 8, 2, 4, 16, 32, 64), (-1, -1, -1, -1, 1, -1, -1), strict=True):
        moved = np.concatenate([np.zeros(delay), b[:-delay]])
        a, b = weight * a + moved, weight * a - moved
    return (b if second else a)[::-1].copy()


def zadoff_chu(length, root):
    n = np.arange(length)
    return np.exp(-1j * np.pi * (root * (n * (n + length % 2) % (2 * length)) % (2 * length)) / length)


def builtin(entry):
    """The Wave of a `waveforms` entry with a built-in code."""
    name, hold = entry["code"], entry["samples_per_chip"]
    chips = {
        "glfsr": lambda: glfsr(entry["degree"], entry["seed"]),
        "gold": lambda: gold(entry["length"]),
        "ls": ls,
        "ga128": golay128,
        "gb128": lambda: golay128(True),
        "zadoff_chu": lambda: zadoff_chu(entry["length"], entry["root"]),
    }[name]()
    x = np.repeat(chips, hold).astype(np.complex64).astype(complex)
    return Wave(name=name, samples=x, entry=entry, samples_per_chip=hold, limited=False)


# ---------------------------------------------------------------- shaping
def shaped(symbols, period, beta, root=True):
    """A period of `period` samples of len(symbols) symbols under a (root) raised cosine; any ratio, even no integer."""
    n = len(symbols)
    f = fftfreq(period) * period / n  # in symbol rates
    a = np.abs(f)
    h = np.where(a <= (1 - beta) / 2, 1.0, 0.0)
    edge = (a > (1 - beta) / 2) & (a < (1 + beta) / 2)
    h[edge] = 0.5 * (1 + np.cos(np.pi / beta * (a[edge] - (1 - beta) / 2)))
    h = np.sqrt(h) if root else h
    k = np.rint(f * n).astype(int)
    x = ifft(fft(symbols)[k % n] * h) * period / n
    return x / np.sqrt(np.mean(np.abs(x) ** 2))


def constellation(rng, order, count):
    if order == 2:
        return rng.choice([-1.0, 1.0], count).astype(complex)
    m = int(np.sqrt(order))
    levels = 2 * np.arange(m) - (m - 1)
    s = rng.choice(levels, count) + 1j * rng.choice(levels, count)
    return s / np.sqrt(np.mean(np.abs(s) ** 2))


def ofdm(rng, *, size, prefix, active, symbols, order=4, taper=0, hollow=True, times=1):
    """CP-OFDM; `times` oversamples; `taper` samples of every symbol's edges are shaped."""
    k = np.arange(-(active // 2), active // 2 + 1)
    k = k[k != 0] if hollow else k
    out = []
    n, cp = size * times, prefix * times
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(taper) + 0.5) / taper) if taper else None
    for _ in range(symbols):
        grid = np.zeros(n, complex)
        grid[k % n] = constellation(rng, order, len(k))
        s = ifft(grid) * n
        s = np.concatenate([s[-cp:], s]) if cp else s
        if taper:
            s[:taper] *= ramp
            s[-taper:] *= ramp[::-1]
        out.append(s)
    x = np.concatenate(out)
    return x / np.sqrt(np.mean(np.abs(x) ** 2))


def continuous_phase(bits, per_symbol, index, bt, closed=True):
    """GFSK/GMSK: bits ±1 through a Gaussian filter of BT `bt` into a phase; `closed` (an even number of bits, index 1/2)
    makes the phase return, for repetition."""
    bits = np.asarray(bits, float).copy()
    if closed and int(bits.sum()) % 4:
        bits[0] = -bits[0]
    n = len(bits) * per_symbol
    drive = np.repeat(bits, per_symbol)
    if bt:
        f = fftfreq(n) * per_symbol  # in symbol rates
        drive = ifft(fft(drive) * np.exp(-np.log(2) / 2 * (f / bt) ** 2)).real
    return np.exp(1j * np.pi * index / per_symbol * (np.cumsum(drive) - drive[0]))


def chirps(values, factor, times, up=True):
    """LoRa-like symbols: 2^factor chips, each symbol a cyclically shifted chirp, `times` samples per chip."""
    m = 2**factor
    n = np.arange(m * times) / times
    frequency = [((n + v) % m) / m - 0.5 for v in values]
    phase = np.concatenate([np.cumsum(f) / times for f in frequency])
    return np.exp((1 if up else -1) * 2j * np.pi * phase)
