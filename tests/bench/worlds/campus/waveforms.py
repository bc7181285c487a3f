# SPDX-License-Identifier: GPL-3.0-or-later
"""What is sent: each maker (rng, length, once) → (samples, traits).

Traits: `name`, `spc` (samples per chip or symbol), `bw` (occupied band re the sample rate), and where they hold `const`
(constant envelope), `real`, `code` (the twin's entry of a built-in code), `known` (which samples the twin knows).
"""

import math

import numpy as np
from scipy import signal

TURN = 2 * np.pi
MASKS = {6: 0x21, 7: 0x41, 8: 0x8E, 9: 0x108, 10: 0x204}


def glfsr(degree, seed):
    register, out = seed, []
    for _ in range(2**degree - 1):
        bit = register & 1
        register = (register >> 1) ^ (MASKS[degree] if bit else 0)
        out.append(1.0 if bit else -1.0)
    return np.array(out)


def root_raised_cosine(sps, beta, span=12):
    t = np.arange(-span * sps, span * sps + 1) / sps
    h = np.zeros(len(t))
    for i, x in enumerate(t):
        if abs(x) < 1e-9:
            h[i] = 1 + beta * (4 / np.pi - 1)
        elif abs(abs(4 * beta * x) - 1) < 1e-9:
            a = np.pi / 4 / beta
            h[i] = beta / math.sqrt(2) * ((1 + 2 / np.pi) * math.sin(a) + (1 - 2 / np.pi) * math.cos(a))
        else:
            top = math.sin(np.pi * x * (1 - beta)) + 4 * beta * x * math.cos(np.pi * x * (1 + beta))
            h[i] = top / (np.pi * x * (1 - (4 * beta * x) ** 2))
    return h / math.sqrt(np.sum(h**2))


def around(x, h):
    """Circular convolution with a filter about its middle: the period has no edge."""
    wide = np.zeros(len(x))
    np.add.at(wide, (np.arange(len(h)) - len(h) // 2) % len(x), h)
    return np.fft.ifft(np.fft.fft(x) * np.fft.fft(wide))


def shaped(symbols, sps, beta, circular):
    up = np.zeros(len(symbols) * sps, complex)
    up[::sps] = symbols
    h = root_raised_cosine(sps, beta)
    return around(up, h) if circular else np.convolve(up, h)


def symbols(rng, count, order):
    k = int(math.sqrt(order))
    a = (2 * rng.integers(0, k, count) - k + 1) + 1j * (2 * rng.integers(0, k, count) - k + 1)
    return a / math.sqrt(2 * (k * k - 1) / 3)


def ofdm(rng, n, once):
    size = int(rng.choice([64, 128, 256] if n < 15000 else [64, 128, 256, 512, 1024]))
    occupied = rng.uniform(0.6, 0.82)
    half = int(size * occupied / 2)
    carriers = np.concatenate([np.arange(-half, 0), np.arange(1, half + 1)])
    prefix = size // int(rng.choice([4, 8, 16]))
    room = n if once else min(n // 3, int(rng.integers(4, 40)) * size)
    count = max(2, room // (size + prefix))
    order = int(rng.choice([4, 16, 64]))
    pilots = carriers[3::12]
    out = []
    for s in range(count):
        x = np.zeros(size, complex)
        x[carriers] = symbols(rng, len(carriers), 4 if s % 7 == 0 else order)
        x[pilots] = rng.choice([-1, 1], len(pilots))
        v = np.fft.ifft(x)
        out.append(np.concatenate([v[-prefix:], v]))
    x = np.concatenate(out)
    traits = dict(name="ofdm", spc=1, bw=occupied)
    if once and rng.random() < 0.35:  # data that the twin does not know
        known = np.repeat(np.arange(count) % 7 < 4, size + prefix)
        traits |= dict(name="ofdm_pilots", known=known)
    return x, traits


def qam(rng, n, once):
    sps = int(rng.choice([2, 3, 4]))
    beta = rng.uniform(0.2, 0.4)
    count = (n if once else min(n // 4, int(rng.integers(200, 2500)) * sps)) // sps
    x = shaped(symbols(rng, count, int(rng.choice([4, 4, 16, 64]))), sps, beta, not once)
    return x, dict(name="rrc_qam", spc=sps, bw=(1 + 0.5 * beta) / sps)


def gmsk(rng, n, once):
    sps = int(rng.choice([4, 5, 8]))
    count = (n if once else min(n // 4, int(rng.integers(200, 1200)) * sps)) // sps
    count -= count % 2
    bits = 2.0 * rng.integers(0, 2, count) - 1
    while int(bits.sum()) % 4:  # a period ends at the phase at which it begins
        bits[int(rng.integers(count))] *= -1
    pulse = np.exp(-0.5 * (np.arange(-3 * sps, 3 * sps + 1) / (0.132 / 0.3 * sps)) ** 2)
    f = around(np.repeat(bits, sps) / sps, pulse / pulse.sum()).real
    return np.exp(1j * np.pi / 2 * np.cumsum(f)), dict(name="gmsk", spc=sps, bw=0.9 / sps, const=True)


def lora(rng, n, once):
    chips, sps = 2 ** int(rng.integers(6, 9)), int(rng.choice([2, 4]))
    room = n if once else min(n // 3, int(rng.integers(6, 20)) * chips * sps)
    count = max(3, room // (chips * sps))
    t = np.arange(chips * sps) / sps
    f = [((int(rng.integers(chips)) if s > 2 else 0) + t) % chips / chips - 0.5 for s in range(count)]
    return np.exp(1j * TURN * np.cumsum(np.concatenate(f) / sps)), dict(name="lora", spc=sps, bw=1 / sps, const=True)


def fm(rng, n, once):
    v = signal.lfilter(*signal.butter(2, [0.004, 0.05], "band"), rng.standard_normal(n + 2000))[2000:]
    v = v / np.std(v) * (0.6 + 0.4 * np.sin(TURN * np.arange(n) / n * rng.uniform(1, 4)) ** 2)
    x = np.exp(1j * np.cumsum(0.25 * v))
    ramp = min(300, n // 10)
    edge = np.ones(n)
    edge[:ramp] = np.sin(np.arange(ramp) / ramp * np.pi / 2) ** 2
    edge[-ramp:] = edge[:ramp][::-1]
    return x * edge, dict(name="fm_voice", spc=4, bw=0.15)


def dsss(rng, n, once):
    degree = int(rng.choice([6, 7, 8]))
    a, b = glfsr(degree, 1), glfsr(degree, 5)
    codes = [a * np.roll(b, int(rng.integers(len(a)))) for _ in range(2)]
    count = int(rng.integers(3, 9))
    arms = [np.concatenate([code * k for k in rng.choice([-1, 1], count)]) for code in codes]
    chips = (arms[0] + 1j * arms[1]) / math.sqrt(2)
    sps = int(rng.choice([2, 3, 4]))
    if once:
        chips = np.tile(chips, max(1, n // (sps * len(chips))))
    return shaped(chips, sps, 0.25, not once), dict(name="dsss", spc=sps, bw=1.12 / sps)


def zadoff_chu(rng, n, once):
    length = int(rng.choice([139, 283, 571, 839]))
    root, k = int(rng.integers(1, length)), np.arange(length)
    z = np.exp(-1j * np.pi * root * k * (k + 1) / length)
    size = int(length * rng.uniform(1.3, 2.0))
    x = np.zeros(size, complex)
    x[np.arange(length) - length // 2] = np.fft.fft(z)
    v = np.fft.ifft(x)
    return (np.tile(v, max(1, n // size)) if once else v), dict(name="zadoff_chu", spc=1, bw=length / size)


def dme(rng, n, once):
    """Pairs of Gaussian pulses at random moments."""
    width = rng.uniform(4, 9)  # samples at half height
    period = n if once else min(n // 4, int(rng.integers(1500, 6000)))
    t, x, at = np.arange(period), np.zeros(period), 30.0
    while at < period - 6 * width - 30:
        for late, size in ((0, 1.0), (3.4 * width, 0.97)):
            x += size * np.exp(-4 * math.log(2) * ((t - at - late) / width) ** 2)
        at += rng.uniform(8, 22) * width
    return x.astype(complex), dict(name="dme", spc=int(width), bw=0.9 / width, real=True)


def fmcw(rng, n, once):
    period, band = int(rng.integers(600, 3000)), rng.uniform(0.3, 0.6)
    up = int(period * 0.85)
    f = np.concatenate([np.linspace(-band / 2, band / 2, up), np.linspace(band / 2, -band / 2, period - up)])
    phase = np.cumsum(f)
    phase -= np.arange(period) / period * (phase[-1] - round(phase[-1]))
    x = np.exp(1j * TURN * phase)
    return (np.tile(x, max(1, n // period)) if once else x), dict(name="fmcw", spc=2, bw=band, const=True)


def builtin(rng, n, once):
    degree, spc = int(rng.choice([8, 8, 9, 10])), int(rng.choice([2, 3, 4]))
    seed = int(rng.integers(1, 2**degree))
    code = dict(code="glfsr", degree=degree, mask=0, seed=seed, samples_per_chip=spc)
    x = np.repeat(glfsr(degree, seed), spc).astype(complex)  # held an even number of times: nothing at half the rate
    return x, dict(name="builtin", spc=spc, bw=1.2 / spc, real=True, code=code)


MAKERS = dict(
    ofdm=ofdm, qam=qam, gmsk=gmsk, lora=lora, fm=fm, dsss=dsss, zc=zadoff_chu, dme=dme, fmcw=fmcw, builtin=builtin
)  # fmt: skip
SHARES = dict(ofdm=0.24, qam=0.2, gmsk=0.08, lora=0.06, fm=0.04, dsss=0.1, zc=0.06, dme=0.05, fmcw=0.05, builtin=0.12)


def without_nyquist(x):
    """No line at half the sample rate: a delay by a fraction is not defined for it."""
    if len(x) % 2:
        return x
    sign = 1 - 2.0 * (np.arange(len(x)) % 2)
    return x - np.mean(x * sign) * sign


def wave(rng, n, kinds=None):
    """→ (samples of mean power 1 as a file holds them, traits, repeated)."""
    names = kinds or list(MAKERS)
    p = np.array([SHARES[k] for k in names])
    kind = str(rng.choice(names, p=p / p.sum()))
    once = kind == "fm" or bool(rng.random() < (0.0 if kind in ("builtin", "fmcw", "zc") else 0.35))
    x, traits = MAKERS[kind](rng, int(n / 1.25) if once else n, once)
    if "code" not in traits:
        x = without_nyquist(x)
        x = (x / math.sqrt(np.mean(np.abs(x) ** 2))).astype(np.complex64).astype(complex)
    return x, traits, not once


def silent(rng):
    """A repeated waveform that the twin lists and believes off the air."""
    if rng.random() < 0.5:
        return builtin(rng, 0, False)
    while True:
        x, traits, repeated = wave(rng, 9000, ["qam"])
        if repeated:
            return x, traits
