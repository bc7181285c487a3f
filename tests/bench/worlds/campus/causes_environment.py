# SPDX-License-Identifier: GPL-3.0-or-later
"""Others on the air: transmitters, tones, bands of noise, pulses, impulses. Each: (link, rng, aim of λ) → Found."""

import math

import numpy as np
from scipy import signal

from . import interpolation, strength
from .channel import MARGIN
from .scene import Redraw, db, power
from .strength import scaled
from .truth import Found, told

TURN = 2 * np.pi


def gaussian(rng, n):
    return (rng.standard_normal(n) + 1j * rng.standard_normal(n)) / math.sqrt(2)


def span(link):
    return link.n + link.spare + 2 * MARGIN


def played(link, z, size):
    """signal(t) of a spec, at the recording's samples."""
    return lambda t: size * z[np.round(t * link.rate).astype(int) + MARGIN]


def second_transmitter(link, rng, aim):
    if link.second is None:
        raise Redraw("no silent waveform")
    x = link.second[0]
    d, phase = rng.uniform(0, len(x)), rng.uniform(-np.pi, np.pi)
    one = interpolation.periodic(x, 1, d, np.arange(len(x)))

    def make(s):
        gain = s * np.exp(1j * phase) * link.gain
        return dict(size=s, signal=lambda t: gain * one[np.round(t * link.rate).astype(int) % len(x)])

    spec, lam = scaled(link, "second_transmitter", make, 0.03, 1e-6, 0.7, aim)
    level, period = 20 * math.log10(spec["size"]), len(x) / link.rate
    late = ((d - link.delay) / link.rate) % period  # on the scale of the taps
    p = dict(
        gain_db=told(level, True, [level - 20 * math.log10(link.amplitude)]),
        delay_s=told(late, also=[d / link.rate, late - period]),
    )
    return Found(spec=spec, lam=lam, parameters=p, values=dict(code="w9"))


def tone(link, rng, aim):
    while True:
        f = rng.uniform(-0.46, 0.46) * link.rate
        if rng.random() < 0.3:  # beside a simple share of the sample rate
            f = rng.choice([-1, 1]) * link.rate / float(rng.choice([3, 5, 6, 8, 10])) * (1 + rng.uniform(-2e-3, 2e-3))
        if min(abs(f), abs(f - link.offset_hz)) > 30 / link.duration:
            break
    phase, rms = rng.uniform(-np.pi, np.pi), math.sqrt(link.wanted)
    make = lambda s: dict(s=s, signal=lambda t: s * rms * np.exp(1j * (TURN * f * t + phase)))  # noqa: E731
    spec, lam = scaled(link, "tone_interference", make, 0.02, 1e-6, 0.7, aim)
    level = 20 * math.log10(spec["s"])
    p = dict(frequency_hz=told(f, True), power_dbc=told(level, True, link.while_on(level)))
    return Found(spec=spec, lam=lam, parameters=p, where=dict(frequency_hz=[f, f]))


def banded(rng, link, middle, width, n):
    line, f = np.fft.fft(gaussian(rng, n)), np.fft.fftfreq(n, 1 / link.rate)
    return np.fft.ifft(line * (np.abs((f - middle + link.rate / 2) % link.rate - link.rate / 2) <= width / 2))


def narrowband(link, rng, aim):
    """A band of noise with edges; a keyed or a frequency-modulated carrier, whose band has none."""
    width, middle = rng.uniform(0.01, 0.1) * link.rate, rng.uniform(-0.4, 0.4) * link.rate
    n, form = span(link), rng.choice(["noise", "gmsk", "fm"])
    if form == "noise":
        z = banded(rng, link, middle, width, n)
        inside = max(1, round(width / link.rate * link.n))
        density = np.concatenate([np.full(inside, link.n / inside), np.zeros(link.n - inside)])
        widths, middles, where = [width, 0.99 * width], [], dict(frequency_hz=[middle - width / 2, middle + width / 2])
    else:
        if form == "gmsk":
            sps = link.rate / width * 0.9
            bits = 2.0 * rng.integers(0, 2, int(n / sps) + 4) - 1
            f = bits[(np.arange(n) / sps).astype(int)] / (4 * sps)
            smooth = np.hanning(max(3, int(sps)))
            f = np.convolve(f, smooth / smooth.sum(), "same")
        else:
            f = banded(rng, link, 0, width * 0.1, n).real
            f = f / np.std(f) * width / link.rate / 5
        z = np.exp(1j * TURN * (np.cumsum(f) + middle / link.rate * np.arange(n)))
        density = signal.welch(z, nperseg=512, return_onesided=False, scaling="density", detrend=False)[1]
        density = np.repeat(density / np.mean(density), max(1, link.n // 512))
        line = np.abs(np.fft.fft(z)) ** 2
        f = (np.fft.fftfreq(n) * link.rate - middle + link.rate / 2) % link.rate - link.rate / 2
        order = np.argsort(np.abs(f))
        share = np.cumsum(line[order]) / line.sum()
        widths = [2 * abs(f[order][np.searchsorted(share, q)]) for q in (0.99, 0.9, 0.95, 0.8)] + [width]
        middles, where = [middle + float(np.sum(f * line) / np.sum(line))], {}
    z /= math.sqrt(power(z))
    rms, scale = math.sqrt(link.wanted), link.n / len(density)
    make = lambda s: dict(s=s, signal=played(link, z, s * rms))  # noqa: E731
    measure = lambda spec: scale * strength.uneven(1 + spec["s"] ** 2 * link.wanted / link.noise * density)  # noqa: E731
    spec, lam = scaled(link, "narrowband_interference", make, 0.05, 1e-5, 3.0, aim, measure)
    level = 20 * math.log10(spec["s"])
    p = dict(
        frequency_hz=told(middle, also=middles),
        power_dbc=told(level, also=link.while_on(level)),
        bandwidth_hz=told(widths[0], also=widths[1:]),
    )
    return Found(spec=spec, lam=lam, parameters=p, where=where)


def pulsed(link, rng, aim):
    """Pulses of a carrier, of a chirp, or of noise; each of the first two has a phase of its own."""
    period = link.duration / rng.uniform(6, 60)
    duty = max(rng.uniform(0.015, 0.2), 12 / (period * link.rate))
    if duty > 0.3:
        raise Redraw("pulses without pauses")
    start, form, f0 = rng.uniform(0, period), rng.choice(["carrier", "chirp", "noise"]), rng.uniform(-0.3, 0.3) * link.rate
    n = span(link)
    t = (np.arange(n) - MARGIN) / link.rate
    inside, number = (t - start) % period, np.floor((t - start) / period)
    on = inside < duty * period
    if form == "noise":
        z = gaussian(rng, n)
    else:
        sweep = rng.uniform(0.1, 0.35) * link.rate / (duty * period) if form == "chirp" else 0.0
        z = np.exp(1j * (TURN * (f0 * inside + 0.5 * sweep * (inside - duty * period / 2) ** 2) + (1.7 * number**2) % TURN))
    z = z * on
    rms, heard, measure = math.sqrt(link.wanted), on[MARGIN : MARGIN + link.n][link.mask], None
    if form == "noise":
        measure = lambda spec: strength.uneven(1 + spec["s"] ** 2 * link.wanted / link.noise * heard)  # noqa: E731
    make = lambda s: dict(s=s, signal=played(link, z, s * rms))  # noqa: E731
    spec, lam = scaled(link, "pulsed_interference", make, 0.05, 1e-5, 4.0, aim, measure)
    level = 20 * math.log10(spec["s"])
    also = [level + db(duty), *link.while_on(level)]
    p = dict(period_s=told(period), duty_cycle=told(duty), power_dbc=told(level, also=also))
    return Found(spec=spec, lam=lam, parameters=p)


def impulses(link, rng, aim):
    """Gaussian ones in single samples, or ignition: sizes within 3 dB, ringing through a few samples."""
    n, form = span(link), rng.choice(["gaussian", "ignition"])
    expected = rng.uniform(12, min(300, link.n / 60))
    places = np.flatnonzero(rng.random(n) < expected / link.n)
    spread = 10 ** (np.linspace(-3, 3, 9) / 20)
    train = np.zeros(n, complex)
    if form == "gaussian":
        train[places] = gaussian(rng, len(places))
        z, gathered, sizes = train, 1.0, None
    else:
        count = len(places)
        train[places] = np.exp(1j * rng.uniform(-np.pi, np.pi, count)) * 10 ** (rng.uniform(-3, 3, count) / 20)
        ring = rng.uniform(0.3, 0.7)
        z = signal.lfilter([1], [1, -ring * np.exp(1j * rng.uniform(-1, 1))], train)
        gathered, sizes = 1 / math.sqrt(1 - ring**2), spread  # what a matched filter gathers into one sample
    window = slice(MARGIN, MARGIN + link.n)
    hit = np.flatnonzero(train[window])
    if len(hit) < 8:
        raise Redraw("few impulses")
    own, share = int(rng.integers(2**31)), expected / link.n

    def measure(spec):
        size = spec["s"] * gathered
        known = None if sizes is None else sizes * size
        return strength.impulses(train[window][link.mask] * size, share, known, link.noise, np.random.default_rng(own))

    most = 0.9 / np.max(np.abs(np.stack([z.real, z.imag])))
    make = lambda s: dict(s=s, signal=played(link, z, s))  # noqa: E731
    first = min(most, math.sqrt(link.noise * max(10.0, aim / len(hit))))
    spec, lam = scaled(link, "impulsive_noise", make, first, 1e-6, most, aim, measure, tries=10)
    heard = np.abs(spec["s"] * z[window]) ** 2
    peak, energy, middle = np.mean(heard[hit]), np.sum(heard) / len(hit), np.median(heard[hit])
    rate = len(hit) / link.duration
    above = np.count_nonzero(heard > 10 * link.noise) / link.duration  # samples, not impulses
    p = dict(
        rate_hz=told(rate, also=[expected / link.duration, *([above] if above else [])]),
        power_db=told(db(peak), also=[db(energy), db(middle), db(np.max(heard))]),
    )
    return Found(spec=spec, lam=lam, parameters=p)
