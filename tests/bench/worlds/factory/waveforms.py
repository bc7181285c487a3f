# SPDX-License-Identifier: GPL-3.0-or-later
"""Waveforms of wireless networks, sensors and soundings indoors."""

import numpy as np

from .._craft.waves import decimated, lowpass, normal, rectangle, register, root_raised_cosine, shaped, shift_keyed

ODD = (1607, 1693, 1753, 1847, 1881, 1921, 1979, 2053, 2101, 2145, 2203, 2269)
BARKER = np.array([1, -1, 1, 1, -1, 1, 1, 1, -1, -1, -1], float)


def odd(rng):
    return int(rng.choice(ODD))


def _ofdm_symbols(rng, count, guard=16):
    """52 carriers of 64 in QPSK, a guard interval each; a quarter of the symbols are training (±1)."""
    out = []
    carriers = np.concatenate([np.arange(1, 27), np.arange(38, 64)])
    for k in range(count):
        spectrum = np.zeros(64, complex)
        data = rng.choice([1, 1j, -1, -1j], 52) if k % 4 else rng.choice([1.0, -1.0], 52)
        spectrum[carriers] = data
        x = np.fft.ifft(spectrum) * 8
        out.append(np.concatenate([x[-guard:], x]))
    return np.concatenate(out)


def _between(x, total):
    """Samples of one rate on a grid of `total`, periodically."""
    spectrum, n = np.fft.fft(x), len(x)
    k = np.rint(np.fft.fftfreq(total) * total).astype(int)
    inside = np.abs(k) < n / 2
    wide = np.where(inside, spectrum[k % n], 0) * lowpass(k / total, 0.49, 0.03)
    return np.fft.ifft(wide) * total / n


def ofdm(rng, length):
    """Preambles of an OFDM network, repeated without a gap."""
    period, count = length
    x = _ofdm_symbols(rng, count)
    x = normal(_between(x, period))
    return x, dict(name="ofdm", band=min(0.92, 0.83 * len(x) / period), samples_per_chip=max(1, round(period / len(x))))


ofdm.lengths = lambda rng: (lambda p: (p, int(p / 80 / rng.uniform(1.2, 2.5))))(odd(rng))


def barker(rng, length):
    """DBPSK spread by eleven chips."""
    period, count = length
    bits = rng.choice([-1.0, 1.0], count)
    chips = (bits[:, None] * BARKER).ravel()
    x = shaped(chips, period, lambda f: root_raised_cosine(f, 0.4)).real
    return normal(x), dict(name="barker", band=1.3 * len(chips) / period, samples_per_chip=round(period / len(chips)))


barker.lengths = lambda rng: (lambda p: (p, int(p / 11 / rng.uniform(2.0, 3.5))))(odd(rng))


def cck(rng, length):
    """Complementary code keying: eight chips from four drawn phases."""
    period, count = length
    a, b, c, d = rng.integers(0, 4, (4, count)) * np.pi / 2
    phases = np.stack([a + b + c + d, a + c + d, a + b + d, a + d + np.pi, a + b + c, a + c, a + b + np.pi, a], 1)
    chips = np.exp(1j * phases).ravel()
    x = shaped(chips, period, lambda f: root_raised_cosine(f, 0.3))
    return normal(x), dict(name="cck", band=1.25 * len(chips) / period, samples_per_chip=round(period / len(chips)))


cck.lengths = lambda rng: (lambda p: (p, int(p / 8 / rng.uniform(1.7, 3.0))))(odd(rng))


def gfsk(rng, length):
    """Gaussian FSK of BT 0.5, index near a third."""
    period, count = length
    bits = rng.choice([-1.0, 1.0], count)
    x = normal(shift_keyed(bits, period, 0.32, 0.5), 0.9)
    return x, dict(name="gfsk", band=min(0.9, 1.2 * count / period), samples_per_chip=round(period / count))


gfsk.lengths = lambda rng: (lambda p: (p, int(p / rng.uniform(2.2, 4.0))))(odd(rng))


def _chirps(rng, symbols, factor, over, fine=4):
    """Up-chirps of 2^factor chips, each begun at a drawn chip."""
    chips = 2**factor
    u = (np.arange(chips * over * fine) + 0.5) / (over * fine)
    out = []
    for k in range(symbols):
        start = 0 if k < 2 else int(rng.integers(0, chips))
        f = (start + u) % chips / chips - 0.5
        out.append(f)
    phase = 2 * np.pi * np.cumsum(np.concatenate(out)) / (over * fine)
    phase -= np.arange(len(phase)) / len(phase) * (phase[-1] - 2 * np.pi * np.rint(phase[-1] / (2 * np.pi)))
    return np.exp(1j * phase), chips * over * symbols


def chirps(rng, length):
    """Chirp spread spectrum: 2^7 chips a symbol."""
    symbols, over = length
    x, period = _chirps(rng, symbols, 7, over)
    return normal(decimated(x, period), 0.9), dict(name="chirps", band=0.95 / over + 0.02, samples_per_chip=over)


chirps.lengths = lambda rng: (int(rng.choice([5, 7, 9])), 2)


def pulses(rng, period):
    """Ultra-wideband: ternary pulses on a drawn raster, each a Gaussian's derivative shape within the band."""
    raster = np.zeros(period // 6)
    raster[rng.uniform(size=len(raster)) < 0.6] = 1
    raster *= rng.choice([-1.0, 1.0], len(raster))
    x = shaped(raster, period, lambda f: np.exp(-((f / 2.2) ** 2)) * (1 - np.exp(-((f / 0.3) ** 2))))
    return normal(x.real), dict(name="pulses", band=0.95, samples_per_chip=6)


pulses.lengths = odd


def half_sine(rng, length):
    """Offset QPSK with half-sine pulses and a 32-chip spreading, as sensors use."""
    period, count = length
    code = 1 - 2.0 * register((1, 3, 5, 6), 64, int(rng.integers(1, 63)))[:32]
    words = np.array([np.roll(code, 4 * k) for k in range(8)])
    chips = words[rng.integers(0, 8, count // 16 + 1)].ravel()
    symbols = (chips[0::2] + 1j * chips[1::2])[:count]

    def pulse(f):
        f = np.abs(f)
        near = np.abs(f - 0.25) < 1e-6
        return np.where(near, np.pi / 4, np.cos(2 * np.pi * f) / np.where(near, 1, 1 - 16 * f**2))

    x = shaped(symbols, period, pulse, 0.5)
    return normal(x), dict(name="half_sine", band=min(0.9, 1.6 * count / period), samples_per_chip=round(period / count))


half_sine.lengths = lambda rng: (lambda p: (p, int(p / rng.uniform(2.5, 4.0))))(odd(rng))


def sounding(rng, length):
    """An m-sequence of 1023 bits, or 511, begun anywhere, on rectangular chips behind the band's filter; a drawn polynomial."""
    period, count = length
    taps = {
        511: ((5, 9), (4, 9), (3, 4, 6, 9), (4, 5, 8, 9), (1, 4, 8, 9), (2, 3, 5, 9)),
        1023: ((3, 10), (7, 10), (2, 3, 8, 10), (1, 3, 4, 10), (1, 5, 8, 10), (2, 4, 9, 10)),
    }[count]
    chips = 1.0 - 2.0 * register(taps[int(rng.integers(len(taps)))], count, int(rng.integers(1, count)))
    x = normal(shaped(chips, period, rectangle).real)
    return x, dict(name="sounding", band=0.97, samples_per_chip=max(1, round(period / count)))


sounding.lengths = lambda rng: (odd(rng), int(rng.choice([511, 1023])))


def qam(rng, length):
    """Sixteen-point constellation, of a proprietary link."""
    period, count = length
    points = np.array([-3, -1, 1, 3])
    symbols = rng.choice(points, count) + 1j * rng.choice(points, count)
    x = shaped(symbols, period, lambda f: root_raised_cosine(f, 0.25))
    return normal(x), dict(name="qam", band=1.2 * count / period, samples_per_chip=round(period / count))


qam.lengths = lambda rng: (lambda p: (p, int(p / rng.uniform(1.8, 3.5))))(odd(rng))


def packets(rng, length):
    """OFDM packets with gaps, sent once."""
    over, count = length
    parts = [np.zeros(200)]
    for _ in range(count):
        parts += [_ofdm_symbols(rng, int(rng.integers(8, 20))) * rng.uniform(0.7, 1.0), np.zeros(int(rng.integers(60, 400)))]
    x = np.concatenate(parts)
    x = normal(_between(x, int(len(x) * over)))
    return x, dict(name="packets", band=min(0.92, 0.83 / over), samples_per_chip=max(1, round(over)))


packets.lengths = lambda rng: (float(rng.choice([1.25, 1.6, 2.0])), int(rng.integers(12, 22)))


def chirp_packet(rng, length):
    """A chirp packet, sent once."""
    x, period = _chirps(rng, length, 8, 2)
    edge = np.clip(np.minimum(np.arange(len(x)), np.arange(len(x))[::-1]) / 400.0, 0, 1)
    return normal(decimated(x * edge, period), 0.9), dict(name="chirp_packet", band=0.52, samples_per_chip=2)


chirp_packet.lengths = lambda rng: int(rng.integers(40, 70))
