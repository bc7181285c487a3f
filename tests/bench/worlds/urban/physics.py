# SPDX-License-Identifier: GPL-3.0-or-later
"""Handsets' and base stations' parts, the channel of a street, and what else is on its air."""

import numpy as np
from scipy import signal
from scipy.fft import fft, fftfreq, ifft

from ..rig import waves
from ..rig.world import log, pick, sign

# Relative delays and powers in dB: 3GPP TR 38.901 TDL-A…C by rms delay spread 1 (strong taps), TS 36.101 EPA, EVA, ETU in ns.
NORMALISED = {
    "TDL-A": ((0.0, 0.3819, 0.4025, 0.5868, 0.7708, 1.1021, 1.5977, 2.2242), (-13.4, 0.0, -2.2, -4.0, -8.2, -9.9, -7.5, -15.9)),
    "TDL-B": ((0.0, 0.1072, 0.2095, 0.4154, 0.6427, 1.0187, 1.8836, 3.1059), (0.0, -2.2, -0.6, -5.9, -1.3, -3.2, -6.2, -11.4)),
    "TDL-C": ((0.0, 0.2099, 0.6366, 0.8213, 1.3083, 2.1704, 4.2589), (-4.4, -1.2, 0.0, -6.6, -6.8, -11.6, -13.9)),
    "TDL-D": ((0.0, 0.612, 1.363, 1.844, 2.885, 4.283), (0.0, -18.8, -20.1, -21.5, -21.6, -20.6)),
}
ABSOLUTE_NS = {
    "EPA": ((0, 70, 110, 190, 410), (0.0, -2.0, -8.0, -17.2, -20.8)),
    "EVA": ((0, 150, 370, 710, 1090, 1730, 2510), (0.0, -1.4, -0.6, -9.1, -7.0, -12.0, -16.9)),
    "ETU": ((0, 200, 500, 1600, 2300, 5000), (-1.0, 0.0, 0.0, -3.0, -5.0, -7.0)),
}


# ---------------------------------------------------------------- oscillators
def density(rng, n, law):
    f = np.abs(fftfreq(n))
    f[0] = f[1]
    return ifft(fft(rng.standard_normal(n)) * np.sqrt(law(f))).real


def crystal(rng, n, rate):
    """Leeson: 1/f³ close in, 1/f² beyond, a floor far out."""
    return density(rng, n, lambda f: (1 + 3e-4 / f) * (1e-4 / np.maximum(f, 2 / n)) ** 2 + 1e-7)


def integer_loop(loop):
    """A phase-locked loop: in-band plateau, third-order roll-off."""

    def process(rng, n, rate):
        b = max(loop / rate, 10 / n)
        return density(rng, n, lambda f: 1 / (1 + (f / b) ** 6) + 0.02 / (1 + (f / (5 * b)) ** 2))

    return process


def drifting_line(rng, n, rate):
    """Random-walk phase of a transmitter on a warm board."""
    return np.cumsum(rng.standard_normal(n))


def microphonic(f):
    """Vibration: a narrow band of phase modulation and a white floor."""

    def process(rng, n, rate):
        b, a = signal.iirpeak(min(f / rate * 2, 0.9), 12)
        shake = signal.lfilter(b, a, rng.standard_normal(n))
        return shake / np.std(shake) + 0.3 * rng.standard_normal(n)

    return process


def phase_noise(rng, scene):
    return pick(
        rng,
        [
            (crystal, False, "Leeson"),
            (integer_loop(log(rng, 3e-4, 1e-2) * scene.rate), False, "locked loop"),
            (drifting_line, True, "free-running"),
            (microphonic(log(rng, 30, 300) / scene.duration), False, "vibration"),
        ],
    )


# ---------------------------------------------------------------- amplifiers
def saleh(alpha, beta, alpha_phase, beta_phase):
    """Saleh 1981: AM/AM αr/(1+βr²), AM/PM αr²/(1+βr²), as a gain that is 1 at r = 0."""
    return lambda r: 1 / (1 + beta * r**2) * np.exp(1j * alpha_phase * r**2 / (1 + beta_phase * r**2)) * alpha / alpha


def solid_state(p, a, b):
    """Rapp with phase (IEEE 802.11ad's model)."""
    return lambda r: np.exp(1j * a * r**2 / (1 + (r / b) ** 2)) / (1 + r ** (2 * p)) ** (1 / (2 * p))


def expanding(rise):
    """A Doherty stage: the gain rises before it falls."""
    return lambda r: 1 + rise * np.minimum(r, 1.1) ** 2 - (rise + 0.2) * np.minimum(r, 1.1) ** 4


def amplifier(rng):
    kind = int(rng.integers(4))
    if kind == 0:
        return saleh(2.1587, 1.1517, 0.8 * sign(rng), 2.0), [], (0.02, 0.8), "Saleh"
    if kind == 1:
        return solid_state(rng.uniform(0.8, 2), rng.uniform(-0.4, 0.4), 1.2), [], (0.02, 1.4), "Rapp with phase"
    if kind == 2:
        return expanding(rng.uniform(0.05, 0.15)), [], (0.05, 1.05), "Doherty"
    echoes = [(rng.uniform(0.6, 1.5), rng.uniform(0.1, 0.3)), (3, -rng.uniform(0.05, 0.15))]
    return solid_state(1.2, 0.2, 1.0), echoes, (0.02, 1.2), "memory"


# ---------------------------------------------------------------- filters
def duplexer(rng, order, half):
    """A Chebyshev band pass seen from the carrier beside its middle."""
    offset = rng.uniform(-0.3, 0.3)
    b, a = signal.cheby1(order, 0.3, 1.0, analog=True)

    def response(f, knob):
        return signal.freqs(b, a, worN=(np.asarray(f) / half + offset) * knob)[1]

    return response


def cauer(order, half):
    b, a = signal.ellip(order, 0.2, 35, 1.0, analog=True)
    return lambda f, knob: signal.freqs(b, a, worN=np.asarray(f) / half * knob)[1]


def butterworth(order, half):
    b, a = signal.butter(order, 1.0, analog=True)
    return lambda f, knob: signal.freqs(b, a, worN=np.asarray(f) / half * knob)[1]


def acoustic(rng, half):
    """A SAW filter: fine ripple and group-delay ripple that need not follow one another."""
    turns, p, q = rng.uniform(0.3, 1.8, 4), rng.uniform(0, 6.28, 4), rng.uniform(0, 6.28, 4)

    def response(f, knob):
        u = np.asarray(f) / half
        level = sum(np.cos(np.pi * t * u + a) for t, a in zip(turns, p, strict=True)) / 4
        phase = sum(np.cos(np.pi * t * u + a) for t, a in zip(turns, q, strict=True)) / 4
        return np.exp(knob * (level + 1j * phase))

    return response


def tilt(rng, half):
    """A long cable or an antenna beside its resonance: so many dB over the band, with its minimum phase."""
    s = sign(rng)

    def response(f, knob):
        u = np.clip(np.asarray(f) / half, -3, 3)
        return 10 ** (s * knob * u / 40) * np.exp(1j * 0.1 * knob * (u**2 / 2))

    return response


def front_end(rng, scene):
    lo, hi = scene.wave(next(iter(scene.transmitters))).band(10)
    half = max(-lo, hi) * scene.rate
    order = int(rng.integers(2, 6))
    return pick(
        rng,
        [
            (duplexer(rng, order, half), 0.3, (0.02, 0.95), "duplexer"),
            (cauer(order, half), 0.3, (0.02, 1.1), "elliptic"),
            (butterworth(order, half), 0.5, (0.03, 1.3), "Butterworth"),
            (acoustic(rng, half), 0.05, (1e-4, 0.4), "SAW ripple"),
            (tilt(rng, half), 0.3, (1e-3, 5.0), "tilt"),
        ],
    )


# ---------------------------------------------------------------- fading of one path
def shaped_process(spread, law):
    """Gaussian scattering of a Doppler density law(f / spread), zero beyond 1."""

    def process(rng, n, rate):
        m = 4 * n if spread / rate * n < 40 else n
        f = fftfreq(m, 1 / rate) / spread
        d = np.where(np.abs(f) < 1, law(np.clip(f, -0.999, 0.999)), 0.0)
        h = ifft(fft(rng.standard_normal(m) + 1j * rng.standard_normal(m)) * np.sqrt(d))[:n]
        return h / np.sqrt(np.sum(d) * 2 / m)

    return process


LAWS = {
    "Jakes": lambda f: 1 / np.sqrt(1 - f**2),
    "bell": lambda f: 1 / (1 + 9 * (f / 0.4) ** 2),
    "one-sided": lambda f: np.where(f > 0, 1 / np.sqrt(1 - f**2), 0),
    "rounded": lambda f: 1 - 1.72 * f**2 + 0.785 * f**4,
}


def fading(rng, scene):
    kind = pick(rng, list(LAWS))
    spread = log(rng, 4.0, 80.0) / scene.duration
    return shaped_process(spread, LAWS[kind]), spread, kind


# ---------------------------------------------------------------- interferers
def voice_am(rng, n, rate, bandwidth):
    """Aircraft band: a carrier with amplitude-modulated voice."""
    f = np.abs(fftfreq(n, 1 / rate))
    voice = ifft(fft(rng.standard_normal(n)) * (f < bandwidth / 2)).real
    return 0.35 + voice / np.std(voice)


def narrow_data(rng, n, rate, bandwidth):
    """A narrow-band IoT carrier: QPSK under a root raised cosine."""
    return waves.shaped(waves.constellation(rng, 4, max(8, int(n * bandwidth / 1.22 / rate))), n, 0.22)


def bandpass_noise(rng, n, rate, bandwidth):
    """A broadband-over-power-line carrier, Gaussian."""
    f = np.abs(fftfreq(n, 1 / rate))
    return ifft(fft(rng.standard_normal(n) + 1j * rng.standard_normal(n)) * (f <= bandwidth / 2))


def keyed(rng, n, rate, bandwidth):
    """A pager or weather sonde: 2-FSK."""
    bits = rng.choice([-1.0, 1.0], max(8, int(n * bandwidth / 2 / rate)))
    drive = np.interp(np.arange(n), np.linspace(0, n, len(bits)), bits)
    return np.exp(2j * np.pi * np.cumsum(drive) * bandwidth / 3 / rate)


def narrowband(rng, scene):
    return pick(
        rng,
        [
            (voice_am, True, "AM"),
            (narrow_data, True, "narrow QPSK"),
            (bandpass_noise, True, "band of noise"),
            (keyed, False, "2-FSK"),
        ],
    )


def lan(rng, n, rate, k):
    """A wireless-LAN burst beside the band: OFDM, ramped."""
    x = waves.ofdm(rng, size=64, prefix=16, active=52, symbols=max(1, -(-n // 160)), times=2)[:n]
    return x / np.sqrt(np.mean(np.abs(x) ** 2))


def radar(share, up):
    """The same chirp in every pulse."""

    def burst(rng, n, rate, k):
        t = (np.arange(n) + 0.5) / n
        return np.exp(1j * np.pi * (1 if up else -1) * share * n * (t - 0.5) ** 2)

    return burst


def uplink(rng, n, rate, k):
    """A handset's slot: shaped QPSK."""
    x = waves.shaped(waves.constellation(rng, 4, max(8, n // 4)), n, 0.25)
    return x


def keyed_carrier(rng, n, rate, k):
    """A gated carrier whose oscillator runs on: its phase goes on from pulse to pulse only by chance."""
    return np.exp(2j * np.pi * rng.uniform()) * np.ones(n)


def pulsed(rng):
    return pick(
        rng,
        [
            (lan, False, "LAN bursts"),
            (radar(rng.uniform(0.1, 0.5), rng.random() < 0.5), True, "radar chirps"),
            (uplink, False, "uplink slots"),
            (keyed_carrier, True, "gated carrier"),
        ],
    )


def spark(rng, rate):
    """Ignition: a few microseconds of decaying, band-limited noise."""
    n = 32
    x = (rng.standard_normal(n) + 1j * rng.standard_normal(n)) * np.exp(-np.arange(n) / 6.0)
    x = np.convolve(x, np.hanning(7)[1:-1])
    return x / np.abs(x).max()


def corona(rng, rate):
    """A short pulse through the receiver's band pass."""
    n = np.arange(-6, 7)
    return np.sinc(0.7 * (n - rng.uniform(-0.5, 0.5))) * np.hanning(15)[1:-1]


def impulses(rng):
    return pick(rng, [(spark, 3.0, 1, "ignition"), (corona, 0.0, 1, "corona"), (spark, 2.0, 6, "trains of sparks")])
