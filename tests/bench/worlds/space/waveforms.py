# SPDX-License-Identifier: GPL-3.0-or-later
"""Waveforms of satellites, ships, aircraft and the short waves."""

import numpy as np

from .._craft.waves import decimated, normal, rectangle, register, root_raised_cosine, shaped, shift_keyed

ODD = (1601, 1637, 1721, 1811, 1881, 1921, 1973, 1999, 2079, 2187, 2297)


def odd(rng):
    return int(rng.choice(ODD))


def gnss(rng, period):
    """A Gold code of 1023 chips (two registers of ten stages, a drawn phase between them), rectangular chips, band-limited."""
    g1 = register((3, 10), 1023, 1023)
    g2 = register((2, 3, 6, 8, 9, 10), 1023, 1023)
    chips = 1.0 - 2.0 * (g1 ^ np.roll(g2, int(rng.integers(1, 1023))))
    return normal(shaped(chips, period, rectangle).real), dict(name="gnss", band=0.97, samples_per_chip=2)


gnss.lengths = odd


def boc(rng, period):
    """BOC(1,1): each of 511 chips of a Gold code times a square wave."""
    a = register((5, 9), 511, 511)
    b = register((3, 4, 6, 9), 511, 511)
    chips = 1.0 - 2.0 * (a ^ np.roll(b, int(rng.integers(1, 511))))
    halves = np.stack([chips, -chips], 1).ravel()
    return normal(shaped(halves, period, rectangle).real), dict(name="boc", band=0.97, samples_per_chip=4)


boc.lengths = odd


def _bits(rng, count):
    """Randomized telemetry."""
    return rng.integers(0, 2, count)


def qpsk(rng, length):
    period, count = length
    symbols = (1 - 2.0 * _bits(rng, count) + 1j * (1 - 2.0 * _bits(rng, count))) / np.sqrt(2)
    x = shaped(symbols, period, lambda f: root_raised_cosine(f, 0.35))
    return normal(x), dict(name="ccsds_qpsk", band=1.3 * count / period, samples_per_chip=round(period / count))


def _qpsk_length(rng):
    period = odd(rng)
    return period, int(period / rng.uniform(2.0, 4.0))


qpsk.lengths = _qpsk_length


def offset_qpsk(rng, length):
    period, count = length
    symbols = (1 - 2.0 * _bits(rng, count) + 1j * (1 - 2.0 * _bits(rng, count))) / np.sqrt(2)
    x = shaped(symbols, period, lambda f: root_raised_cosine(f, 0.5), 0.5)
    return normal(x), dict(name="offset_qpsk", band=1.4 * count / period, samples_per_chip=round(period / count))


offset_qpsk.lengths = _qpsk_length


def bpsk(rng, length):
    period, count = length
    x = shaped(1 - 2.0 * _bits(rng, count), period, lambda f: root_raised_cosine(f, 0.5)).real
    return normal(x), dict(name="ccsds_bpsk", band=1.4 * count / period, samples_per_chip=round(period / count))


bpsk.lengths = _qpsk_length


def d8psk(rng, length):
    """As aviation's data link: differential 8-PSK, raised cosine of 0.6; the phases close over the period."""
    period, count = length
    steps = rng.integers(0, 8, count)
    steps[-1] = (-np.sum(steps[:-1])) % 8
    x = shaped(np.exp(2j * np.pi * np.cumsum(steps) / 8), period, lambda f: root_raised_cosine(f, 0.6))
    return normal(x), dict(name="d8psk", band=1.5 * count / period, samples_per_chip=round(period / count))


d8psk.lengths = lambda rng: (lambda p: (p, int(p / rng.uniform(2.5, 5.0))))(odd(rng))


def gmsk(rng, length):
    """As ships': BT 0.4, index a half."""
    period, count = length
    levels = 1 - 2.0 * _bits(rng, count)
    x = normal(shift_keyed(levels, period, 0.5, 0.4), 0.9)
    return x, dict(name="gmsk", band=min(0.9, 1.2 * count / period), samples_per_chip=round(period / count))


gmsk.lengths = lambda rng: (lambda p: (p, int(p / rng.uniform(2.5, 5.0))))(odd(rng))


def eight_fsk(rng, length):
    """Eight tones one symbol rate apart, Gaussian transitions."""
    period, count = length
    tones = rng.integers(0, 8, count) * 2.0 - 7.0
    x = normal(shift_keyed(tones, period, 1.0, 2.0), 0.9)
    return x, dict(name="eight_fsk", band=min(0.9, 9.0 * count / period), samples_per_chip=round(period / count))


eight_fsk.lengths = lambda rng: (lambda p: (p, int(p / rng.uniform(14, 24))))(odd(rng))


def ionosonde(rng, period):
    """A repeated chirp over 0.4 to 0.8 of the band, with a phase code of 13 drawn chips on top of it."""
    u = np.arange(period * 8) / (period * 8)
    width = rng.uniform(0.4, 0.75) * period
    sweep = np.rint(width)
    start = np.rint(-width / 2)
    code = rng.integers(0, 8, 13)[(u * 13).astype(int)]
    x = np.exp(2j * np.pi * (start * u + sweep / 2 * (u**2 - u / 1.0) + sweep / 2 * u + code / 8))
    return normal(decimated(x, period), 0.9), dict(name="ionosonde", band=min(0.95, width / period + 0.1), samples_per_chip=1)


ionosonde.lengths = odd


def squitter(rng, length):
    """Aircraft's pulse-position squitters, sent once: preamble and 112 bits each, gaps drawn; a slot is half a microsecond."""
    slot, frames = length
    parts = [np.zeros(400)]
    for _ in range(frames):
        slots = np.zeros(16 + 224)
        slots[[0, 2, 7, 9]] = 1
        bits = rng.integers(0, 2, 112)
        slots[16 + 2 * np.arange(112) + (1 - bits)] = 1
        parts += [np.repeat(slots, slot) * rng.uniform(0.6, 1.0), np.zeros(int(rng.integers(150, 900)))]
    x = np.concatenate(parts)
    f = np.fft.fftfreq(len(x))
    x = np.fft.ifft(np.fft.fft(x) * np.exp(-((f * slot / 0.75) ** 2)) * (np.abs(f) < 0.47)).real
    return normal(x), dict(name="squitter", band=min(0.9, 1.6 / slot), samples_per_chip=slot)


squitter.lengths = lambda rng: (int(rng.choice([2, 3, 4])), int(rng.integers(16, 30)))


def burst_gmsk(rng, length):
    """Slots of ships, sent once, with ramps."""
    step, slots = length
    parts = [np.zeros(300, complex)]
    for _ in range(slots):
        bits = 1 - 2.0 * rng.integers(0, 2, 256)
        x = shift_keyed(bits, 256 * step, 0.5, 0.4)
        ramp = np.clip(np.minimum(np.arange(len(x)), np.arange(len(x))[::-1]) / (6.0 * step), 0, 1)
        parts += [x * np.sin(np.pi / 2 * ramp) ** 2 * np.exp(2j * np.pi * rng.uniform()), np.zeros(int(rng.integers(100, 500)))]
    return normal(np.concatenate(parts), 0.9), dict(name="burst_gmsk", band=min(0.9, 1.3 / step), samples_per_chip=step)


burst_gmsk.lengths = lambda rng: (int(rng.choice([3, 4, 5])), int(rng.integers(14, 28)))


def frame_qpsk(rng, length):
    """A telemetry frame that is sent once, longer than twenty thousand samples."""
    count, total = length
    symbols = (1 - 2.0 * _bits(rng, count) + 1j * (1 - 2.0 * _bits(rng, count))) / np.sqrt(2)
    edge = int(60 * count / total) + 8
    symbols[:edge] = symbols[-edge:] = 0
    x = shaped(symbols, total, lambda f: root_raised_cosine(f, 0.35))
    return normal(x), dict(name="frame_qpsk", band=1.3 * count / total, samples_per_chip=round(total / count))


frame_qpsk.lengths = lambda rng: (lambda n: (int(n / rng.uniform(2.0, 4.0)), n))(int(rng.uniform(20e3, 45e3)))
