# SPDX-License-Identifier: GPL-3.0-or-later
"""Oscillators, clocks, amplifiers, gains and filters. Each cause: (link, rng, aim of λ) → Found."""

import math

import numpy as np
from scipy import signal

from . import channel, strength
from .scene import Redraw, db, factor, power
from .strength import scaled
from .truth import Found, told

TURN = 2 * np.pi
MAINS = (50, 60, 100, 120, 150, 180, 300, 360, 400, 800, 1200, 2400, 8000, 16000, 31250, 66000, 120000, 250000)
BEFORE = 4000  # samples of a phase's course before the recording


def carrier_offset(link, rng, aim):
    sign = rng.choice([-1, 1])
    ratio = rng.uniform(-3, 3) if rng.random() < 0.35 else 0.0
    hi = min(0.004 * link.rate, 2e-6 * link.carrier, 60 / link.duration)
    unseen = 0.003 / TURN / max(max(t["delay_s"] for t in link.taps), 1e-12)  # a transmitter's offset turns late paths too
    if link.network:
        hi, ratio = min(hi, unseen), 0.0

    def make(s):
        at = "tx" if s * (1 + abs(ratio)) < unseen else "rx"
        return dict(at=at, offset_hz=sign * s, drift=ratio * s / link.duration)

    spec, lam = scaled(link, "carrier_frequency_offset", make, min(hi, 0.05 / link.duration), 1e-9, hi, aim)
    f, drift = spec["offset_hz"], spec["drift"]
    p = dict(offset_hz=told(f, True, [f + drift * link.duration / 2] if drift else []))
    if drift:
        p["drift_hz_per_s"] = told(drift, True)
    same = ["tap_doppler"] if len(link.taps) == 1 and not link.network else []
    return Found(spec=spec, lam=lam, parameters=p, same_as=same)


def sample_clock(link, rng, aim):
    sign = rng.choice([-1, 1])
    spec, lam = scaled(link, "sample_clock_offset", lambda s: dict(ppm=sign * s), 2, 1e-4, 60, aim)
    return Found(spec={**spec, "at": link.side(rng)}, lam=lam, parameters=dict(offset_ppm=told(spec["ppm"], True)))


def phase_noise(link, rng, aim):
    """Free wandering, the noise that a loop passes, or flicker; λ of the law, not of its one course."""
    n = link.n + link.spare + 2 * BEFORE
    w, at = rng.standard_normal(n), link.side(rng)
    form = rng.choice(["wander", "loop", "flicker"])
    first, last = (int(v) for v in link.on_air)
    f = np.abs(np.fft.fftfreq(last - first))[1:]
    if form == "wander":
        course, density = np.cumsum(w), 1 / (2 - 2 * np.cos(TURN * f))
    elif form == "loop":
        lowest = 12 / link.duration
        pole = math.exp(-TURN * rng.uniform(lowest, max(40 / link.duration, 0.02 * link.rate)) / link.rate)
        course = signal.lfilter([1], [1, -pole], w)
        density = 1 / (1 + pole**2 - 2 * pole * np.cos(TURN * f))
    else:
        corner = rng.uniform(5, 60) / link.n
        u = np.fft.rfftfreq(n)
        u[0] = u[1]
        law = lambda v: (corner / v) / (1 + (v / corner) ** 2) ** 1.5  # noqa: E731
        course, density = np.fft.irfft(np.fft.rfft(w) * np.sqrt(law(u)), n), law(f)
    inside = np.arange(link.n)
    line = np.polyfit(inside, course[BEFORE : BEFORE + link.n], 1)  # an offset is another family
    course = course - np.polyval(line, np.arange(n) - BEFORE)
    rms = np.std(course[BEFORE : BEFORE + link.n])
    t = (np.arange(n) - BEFORE) / link.rate
    make = lambda s: dict(at=at, t=t, phase=course * s / rms, rms=s)  # noqa: E731
    density = density / np.mean(density)
    ratio = link.wanted_on / link.noise
    measure = lambda spec: strength.phase_course(last - first, ratio, spec["rms"] ** 2 * density)  # noqa: E731
    spec, lam = scaled(link, "phase_noise", make, 0.01, 1e-5, 1.2 if form == "wander" else 0.5, aim, measure)
    heard = spec["phase"][BEFORE + first : BEFORE + last]
    heard = heard - np.polyval(np.polyfit(np.arange(len(heard)), heard, 1), np.arange(len(heard)))
    s = float(np.std(spec["phase"][BEFORE : BEFORE + link.n]))
    p = dict(rms_rad=told(s, form != "wander" and link.repeat, [] if link.repeat else [np.std(heard)]))
    if form == "wander":
        p["linewidth_hz"] = told((spec["rms"] / rms) ** 2 * link.rate / TURN)
    return Found(spec=spec, lam=lam, parameters=p)


def imbalance(link, rng, aim):
    real = link.traits.get("real")
    if real and not link.offset_hz:
        raise Redraw("a real waveform's image is itself")
    at = "rx" if real else link.side(rng)
    gain_share = {"gain": 1.0, "phase": 0.05, "both": rng.uniform(0.3, 0.9)}[rng.choice(["gain", "phase", "both"])]
    gain_sign, phase_sign = rng.choice([-1, 1], 2)

    def make(s):
        g = 1 + 2 * s * gain_share * gain_sign
        phase = 2 * s * math.sqrt(1 - gain_share**2 + 1e-9) * phase_sign
        made = dict(at=at, g=g, turn=phase, **mixed(g, phase))
        if at == "rx":  # the mean power of its noise stays
            mean = math.hypot(abs(made["direct"]), abs(made["image"]))
            made |= dict(direct=made["direct"] / mean, image=made["image"] / mean)
        return made

    spec, lam = scaled(link, "iq_imbalance", make, 0.01, 1e-5, 0.12, aim)
    p = dict(
        image_rejection_db=told(20 * math.log10(abs(spec["direct"] / spec["image"])), True, unsigned=True),
        gain_imbalance_db=told(20 * math.log10(spec["g"]), unsigned=True),
        phase_imbalance_rad=told(spec["turn"], unsigned=True),
    )
    return Found(spec=spec, lam=lam, parameters=p)


def mixed(g, phase):
    """The Q arm has gain g and is off by a phase: shares of the signal and of its image."""
    return dict(direct=(1 + g * np.exp(-1j * phase)) / 2, image=(1 - g * np.exp(1j * phase)) / 2)


def leakage(link, rng, aim):
    if not link.offset_hz and not link.network:
        raise Redraw("the receiver's own zero would hide it")
    phase = rng.uniform(-np.pi, np.pi)
    sending = power(link.x) * link.amplitude**2
    a = link.lead * channel.FINE
    recorded = power(channel.sent(link)[a : a + link.n * channel.FINE])
    make = lambda s: dict(level=s * math.sqrt(sending) * np.exp(1j * phase), size=s)  # noqa: E731
    spec, lam = scaled(link, "lo_leakage", make, 0.02, 1e-6, 0.5, aim)
    level = 20 * math.log10(spec["size"])
    through = abs(sum(channel.tap_gain(t) for t in link.taps) * link.gain * spec["level"])
    also = [level + db(sending / recorded), db(through**2 / link.wanted)]
    return Found(spec=spec, lam=lam, parameters=dict(level_dbc=told(level, link.repeat, also)))


def amplifier(link, rng, aim):
    """Rapp's and Saleh's curves, and a cubic with memory; size: about the loss of gain at the peak."""
    u = channel.sent(link)[link.lead * channel.FINE : (link.lead + link.n) * channel.FINE]
    top, sampled = float(np.max(np.abs(u))), float(np.max(np.abs(u[:: channel.FINE])))
    form, sharp, bend = rng.choice(["rapp", "saleh", "cubic"]), rng.uniform(1.0, 2.5), rng.uniform(-0.8, 0.8)
    late = [rng.uniform(lo, hi) * np.exp(1j * rng.uniform(-2, 2)) for lo, hi in ((0.2, 0.5), (0.1, 0.3))]

    def make(s):
        if form == "rapp":
            knee = top / ((1 - s) ** (-2 * sharp) - 1) ** (1 / (2 * sharp))
            curve = lambda a: (1 + (a / knee) ** (2 * sharp)) ** (-1 / (2 * sharp)) + 0j  # noqa: E731
        elif form == "saleh":
            b = s / (1 - s) / top**2
            curve = lambda a: np.exp(2j * bend * b * a**2 / (1 + b * a**2)) / (1 + b * a**2)  # noqa: E731
        else:
            third = -s / top**2 * np.exp(1j * bend)

            def remembering(v, fine):
                c = v * np.abs(v) ** 2
                return v + third * (c + late[0] * np.roll(c, fine) + late[1] * np.roll(c, 2 * fine))

            total = 1 + sum(late)
            curves = [lambda a: 1 + third * total * a**2, lambda a: 1 + third * a**2]
            return dict(bend=remembering, curves=curves)
        return dict(bend=lambda v, fine: v * curve(np.abs(v)), curves=[curve])

    spec, lam = scaled(link, "pa_nonlinearity", make, 0.05, 1e-6, 0.45, aim)
    lost = [-20 * math.log10(abs(curve(np.array([a]))[0])) for curve in spec["curves"] for a in (top, sampled)]
    p = dict(compression_db=told(lost[0], also=lost[1:], unsigned=True))
    return Found(spec=spec, lam=lam, parameters=p, values=dict(memory=form == "cubic"))


# ---------------------------------------------------------------- gains
def balanced(link, gain, at):
    """A receiver's gain leaves the mean power of its noise."""
    if at == "tx":
        return gain
    mean = math.sqrt(np.mean(gain(np.arange(link.n) / link.rate) ** 2))
    return lambda t: gain(t) / mean


def place(link, rng, margin=0.15):
    """A sample within what is on the air."""
    if "known" in link.traits:
        raise Redraw("the place may lie where nothing is known")
    a, b = link.on_air
    return int(rng.uniform(a + margin * (b - a), b - margin * (b - a)))


def gain_step(link, rng, aim):
    when, sign, at = place(link, rng) / link.rate, rng.choice([-1, 1]), link.side(rng)

    def make(s):
        return dict(at=at, s=sign * s, gain=balanced(link, lambda t: np.where(t < when - 1e-12, 1.0, factor(sign * s)), at))

    spec, lam = scaled(link, "gain_step", make, 0.1, 1e-5, 6, aim)
    p = dict(time_s=told(when), step_db=told(spec["s"], True))
    return Found(spec=spec, lam=lam, parameters=p, where=dict(time_s=[when, when]))


def gain_drift(link, rng, aim):
    sign, at, whole = rng.choice([-1, 1]), link.side(rng), link.duration
    tau = rng.uniform(0.12, 0.5) * whole if rng.random() < 0.5 else None

    def course(t):
        inside = np.clip(t, 0, whole)
        return inside / whole if tau is None else np.expm1(-inside / tau) / math.expm1(-whole / tau)

    def make(s):
        return dict(at=at, s=sign * s, gain=balanced(link, lambda t: factor(sign * s * course(t)), at))

    spec, lam = scaled(link, "gain_drift", make, 0.1, 1e-5, 5, aim)
    p = dict(total_db=told(spec["s"], tau is None, [] if tau is None else [spec["s"] / -math.expm1(-whole / tau)]))
    if tau:
        p["time_constant_s"] = told(tau)
    return Found(spec=spec, lam=lam, parameters=p)


def hum(link, rng, aim):
    at, lines = link.side(rng), []
    for f in MAINS:
        if not 2.2 < f * link.duration < 400 or f > 0.01 * link.rate:
            continue
        cycles = [abs(f / (link.rate / len(link.x)) - k) for k in (1, 2, 3)]  # a period's own harmonic: another waveform
        if not link.repeat or min(cycles) > 0.02:
            lines.append(f)
    if not lines:
        raise Redraw("no line shows")
    f, turn = float(rng.choice(lines[:5])), rng.uniform(-np.pi, np.pi, 3)
    more = (rng.uniform(0.1, 0.3), rng.uniform(0.03, 0.15)) if rng.random() < 0.4 else (0, 0)

    def make(s):
        def gain(t):
            out = np.cos(TURN * f * t + turn[0])
            for k, share in enumerate(more, 2):
                out = out + share * np.cos(k * TURN * f * t + turn[k - 1])
            return 1 + s * out

        return dict(at=at, s=s, gain=gain)

    spec, lam = scaled(link, "power_supply_hum", make, 0.01, 1e-5, 0.3, aim)
    depth = told(spec["s"], not any(more), [2 * spec["s"]])
    return Found(spec=spec, lam=lam, parameters=dict(frequency_hz=told(f, True), depth=depth))


# ---------------------------------------------------------------- filters
def centred(h, half):
    """A response without its mean delay in a band of ± half."""
    band = np.linspace(-half, half, 401)
    slope = np.polyfit(band, np.unwrap(np.angle(h(band))), 1, w=np.abs(h(band)))[0]
    return lambda f: h(f) * np.exp(-1j * slope * f)


def filtering(link, rng, aim):
    """Roll-offs, a mismatched cable, a surface-wave filter, without their mean delay, which the link's unknown delay takes; at
    the receiver the mean power of its noise stays."""
    at, form, rate = link.side(rng), rng.choice(["butterworth", "chebyshev", "cable", "surface wave"]), link.rate
    half = link.traits["bw"] * rate / 2
    if form == "butterworth":
        b, a = signal.butter(int(rng.integers(2, 6)), 1, analog=True)
        off = rng.uniform(-0.1, 0.1) * half
        shape = lambda s: lambda f: signal.freqs(b, a, (f - off) / half * s)[1]  # noqa: E731
        first, lo, hi = 0.5, 0.12, 1.1
    elif form == "chebyshev":
        order = int(rng.integers(3, 6))

        def shape(s):
            b, a = signal.cheby1(order, s, 1, analog=True)
            return lambda f: signal.freqs(b, a, f / (half * 1.35))[1]

        first, lo, hi = 0.1, 1e-4, 2.0
    elif form == "cable":
        late, turn = rng.uniform(0.3, 0.85) / rate, rng.uniform(-np.pi, np.pi)
        shape = lambda s: lambda f: 1 + s * np.exp(1j * turn - 1j * TURN * f * late)  # noqa: E731
        first, lo, hi = 0.03, 1e-5, 0.35
    else:
        waves, turn, tilt = rng.uniform(0.7, 1.3), rng.uniform(0, TURN), rng.uniform(-1, 1)
        bend = np.pi * waves / half * link.traits["bw"] * 0.5 / max(link.traits["bw"], 0.5)
        shape = lambda s: lambda f: factor(s * (tilt * f / half + np.cos(bend * f + turn)))  # noqa: E731
        first, lo, hi = 0.2, 1e-4, 3.0

    def make(s):
        h = centred(shape(s), half)
        mean = math.sqrt(power(h(np.linspace(-rate / 2, rate / 2, 2001)))) if at == "rx" else 1.0
        return dict(at=at, response=lambda f: h(f) / mean)

    spec, lam = scaled(link, "front_end_filter", make, first, lo, hi, aim, tries=7)
    line, f = np.abs(np.fft.fft(link.x)) ** 2, np.fft.fftfreq(len(link.x), 1 / rate)
    order = np.argsort(np.abs(f), kind="stable")
    share = np.cumsum(line[order]) / line.sum()
    ripple = []
    for within in (0.99, 0.95, 0.9, 0.999):
        edge = abs(f[order][np.searchsorted(share, within)])
        h = 20 * np.log10(np.abs(spec["response"](np.linspace(-edge, edge, 801))))
        ripple.append(float(h.max() - h.min()))
    p = dict(ripple_db=told(ripple[0], also=[*ripple[1:], ripple[0] / 2], unsigned=True))
    return Found(spec=spec, lam=lam, parameters=p, same_as=["extra_path_within_sample"])
