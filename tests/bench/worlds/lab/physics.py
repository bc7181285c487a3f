# SPDX-License-Identifier: GPL-3.0-or-later
"""Oscillators, amplifiers, filters and interferers as instruments' data sheets and textbooks have them."""

import numpy as np
from scipy import signal
from scipy.fft import fft, fftfreq, ifft

from ..rig import waves
from ..rig.world import log, pick, sign


# ---------------------------------------------------------------- phase noise: processes (rng, n, rate) → phase
def coloured(rng, n, density):
    """Gaussian noise of this one-sided density over |f| in cycles per sample."""
    f = np.abs(fftfreq(n))
    f[0] = f[1]
    return ifft(fft(rng.standard_normal(n)) * np.sqrt(density(f))).real


def wiener(rng, n, rate):
    """A free-running oscillator."""
    return np.cumsum(rng.standard_normal(n))


def locked(loop, peak):
    """A synthesiser: 1/f³ and 1/f² outside the loop, a plateau with a peak inside."""

    def process(rng, n, rate):
        bound = max(loop / rate, 8 / n)
        return coloured(rng, n, lambda f: (1 + peak * (f / bound) ** 2) / (1 + (f / bound) ** 4) + 1e-5)

    return process


def flicker(corner):
    """1/f close to the carrier and a white floor."""

    def process(rng, n, rate):
        return coloured(rng, n, lambda f: corner / f + 0.3)

    return process


def phase_noise(rng, scene):
    """(process, free, form)"""
    return pick(
        rng,
        [
            (wiener, True, "free-running"),
            (locked(log(rng, 2e-4, 2e-2) * scene.rate, rng.uniform(0.3, 3)), False, "locked loop"),
            (flicker(log(rng, 1e-4, 1e-2)), False, "flicker and white floor"),
        ],
    )


# ---------------------------------------------------------------- amplifiers: curve(r) → complex gain
def rapp(p):
    return lambda r: 1 / (1 + r ** (2 * p)) ** (1 / (2 * p))


def polynomial(third, fifth):
    """Third and fifth order, complex: compression and phase together."""
    return lambda r: 1 + third * np.minimum(r, 1.2) ** 2 + fifth * np.minimum(r, 1.2) ** 4


def amplifier(rng):
    """(curve, echoes, range of the drive, form)"""
    kind = int(rng.integers(4))
    if kind < 2:
        return rapp(rng.uniform(1.0, 3.0)), [], (0.02, 1.6), "Rapp"
    angle = rng.uniform(-0.6, 0.6)
    third = -rng.uniform(0.15, 0.3) * np.exp(1j * angle)
    if kind == 2:
        return polynomial(third, 0.04 * np.exp(1j * rng.uniform(-3, 3))), [], (0.01, 1.0), "polynomial"
    echoes = [(1, -rng.uniform(0.1, 0.35)), (2, rng.uniform(0.03, 0.12))]
    return polynomial(third, 0.0), echoes, (0.01, 1.0), "memory polynomial"


# ---------------------------------------------------------------- filters: response(f, knob)
def prototype(kind, order, half):
    """An analogue low-pass about the carrier; knob: the occupied half band over the corner."""

    def response(f, knob):
        b, a = {
            "Butterworth": lambda: signal.butter(order, 1.0, analog=True),
            "Chebyshev": lambda: signal.cheby1(order, 0.5, 1.0, analog=True),
            "elliptic": lambda: signal.ellip(order, 0.3, 40, 1.0, analog=True),
            "Bessel": lambda: signal.bessel(order, 1.0, analog=True, norm="mag"),
        }[kind]()
        return signal.freqs(b, a, worN=np.asarray(f) / (half / knob))[1]

    return response


def surface_wave(rng, half):
    """Linear phase, ripple in the pass band: echoes of the transducers, before and after."""
    turns, phases = rng.uniform(0.4, 1.6, 3), rng.uniform(0, 2 * np.pi, 3)

    def response(f, knob):
        u = np.asarray(f) / half
        ripple = sum(np.cos(np.pi * t * u + p) for t, p in zip(turns, phases, strict=True)) / 3
        return 10 ** (knob * ripple / 20) / (1 + (np.abs(u) / 2.2) ** 10)

    return response


def cavity(offset, half):
    """A band pass tuned beside the carrier: one side falls."""

    def response(f, knob):
        return 1 / (1 + 1j * knob * (np.asarray(f) / half - offset))

    return response


def front_end(rng, scene):
    """(response, first knob, range, form)"""
    lo, hi = scene.wave(next(iter(scene.transmitters))).band(10)
    half = max(-lo, hi) * scene.rate
    kind = pick(rng, ["Butterworth", "Chebyshev", "elliptic", "Bessel", "surface wave", "cavity"])
    if kind == "surface wave":
        return surface_wave(rng, half), 0.3, (1e-3, 4.0), kind
    if kind == "cavity":
        return cavity(sign(rng) * rng.uniform(0.2, 0.8), half), 0.1, (1e-3, 1.5), kind
    return prototype(kind, int(rng.integers(2, 6)), half), 0.4, (0.02, 1.3), kind


# ---------------------------------------------------------------- fading of one path: (process, largest Doppler, form)
def sinusoids(angles_of, spread, lines=48):
    def process(rng, n, rate):
        t = np.arange(n) / rate
        out = np.zeros(n, complex)
        for f in spread * angles_of(rng, lines):
            out += np.exp(2j * np.pi * (f * t + rng.uniform()))
        return out / np.sqrt(lines)

    return process


def fading(rng, scene):
    spread = log(rng, 3.0, 60.0) / scene.duration
    kind = pick(rng, ["Jakes", "Gaussian", "flat"])
    angles = {
        "Jakes": lambda r, k: np.cos(2 * np.pi * r.uniform(size=k)),
        "Gaussian": lambda r, k: np.clip(0.35 * r.standard_normal(k), -1, 1),
        "flat": lambda r, k: r.uniform(-1, 1, k),
    }[kind]
    return sinusoids(angles, spread), spread, kind


# ---------------------------------------------------------------- interferers
def boxed_noise(rng, n, rate, bandwidth):
    f = np.abs(fftfreq(n, 1 / rate))
    return ifft(fft(rng.standard_normal(n) + 1j * rng.standard_normal(n)) * (f <= bandwidth / 2))


def frequency_modulated(rng, n, rate, bandwidth):
    """A hand-held radio: FM by voice."""
    f = np.abs(fftfreq(n, 1 / rate))
    tone = ifft(fft(rng.standard_normal(n)) * ((f < bandwidth / 8) & (f > 0))).real
    return np.exp(2j * np.pi * np.cumsum(tone / np.std(tone) * bandwidth / 5) / rate)


def telemetry(rng, n, rate, bandwidth):
    """A narrow QPSK carrier."""
    count = max(8, int(n * bandwidth / 1.25 / rate))
    return waves.shaped(waves.constellation(rng, 4, count), n, 0.25)


def narrowband(rng, scene):
    """(process, noise-like box, form)"""
    return pick(
        rng,
        [
            (boxed_noise, True, "band of noise"),
            (frequency_modulated, False, "FM"),
            (telemetry, True, "narrow QPSK"),
        ],
    )


def gated_carrier(rng, n, rate, k):
    return np.exp(2j * np.pi * rng.uniform()) * np.ones(n)


def gated_noise(rng, n, rate, k):
    return (rng.standard_normal(n) + 1j * rng.standard_normal(n)) / np.sqrt(2)


def pulse_compression(share):
    def burst(rng, n, rate, k):
        t = np.arange(n) / max(n, 1)
        return np.exp(1j * np.pi * share * n * (t - 0.5) ** 2)

    return burst


def pulsed(rng):
    """(burst, coherent, form)"""
    return pick(
        rng,
        [
            (gated_carrier, True, "gated carrier"),
            (gated_noise, False, "gated noise"),
            (pulse_compression(rng.uniform(0.1, 0.6)), True, "coherent chirps"),
        ],
    )


def glitch(rng, rate):
    return np.ones(1, complex)


def discharge(rng, rate):
    """An electrostatic discharge through the antenna's filter: a damped ring, band-limited."""
    n = np.arange(24)
    ring = np.exp(-n / 4.0) * np.exp(2j * np.pi * 0.12 * n) * (1 - np.exp(-(n + 1) / 0.7))
    return ring / np.abs(ring).max()


def impulses(rng):
    """(shape, spread in dB, bunch, form)"""
    return pick(
        rng,
        [
            (glitch, 0.0, 1, "single samples"),
            (discharge, 2.0, 1, "discharges"),
            (discharge, 3.0, 4, "relay bounce"),
        ],
    )
