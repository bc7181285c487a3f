# SPDX-License-Identifier: GPL-3.0-or-later
"""The families of the contract, each acting at its place in the radio, with the numbers that the contract asks of it.

`knob` is the strength: λ grows with it. What is drawn at random is drawn from `rng(context)`, the same at every call.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from . import numeric, scene
from .scene import MARGIN, Tap


def par(value, z=True, also=(), unsigned=False):
    return {"value": float(value), "z": bool(z), "also": [float(a) for a in also], "unsigned": unsigned}


def db(ratio):
    return 10 * np.log10(ratio)


@dataclass(kw_only=True)
class Cause:
    family: str
    slot: str
    level: str
    name: str
    knob: float
    lo: float = 0.0
    hi: float = np.inf
    seed: int = 0
    form: str = ""
    fixed: bool = False  # its strength is not to be tuned
    noise_like: bool = False
    stochastic: bool = False
    same_as: list = field(default_factory=list)

    def rng(self, context):
        return np.random.default_rng([self.seed, context.recording.index])

    def act(self, y, context):
        raise NotImplementedError

    def truth(self, contexts):
        """(parameters, values, where)"""
        raise NotImplementedError

    def nats(self, context):
        raise NotImplementedError


# ---------------------------------------------------------------- oscillators and clocks
@dataclass(kw_only=True)
class CarrierOffset(Cause):
    sign: float = 1.0
    drift_ratio: float = 0.0  # drift over the recording, re the offset
    family: str = "carrier_frequency_offset"

    @property
    def signed(self):
        return self.sign * self.knob

    def act(self, y, context):
        t = context.time / context.stretch
        drift = self.signed * self.drift_ratio / context.duration
        return y * np.exp(2j * np.pi * (self.signed * t + drift * t**2 / 2))

    def truth(self, contexts):
        p = {"offset_hz": par(self.signed)}
        if self.drift_ratio:
            p["drift_hz_per_s"] = par(self.signed * self.drift_ratio / contexts[0].duration)
        return p, {}, {}


@dataclass(kw_only=True)
class ClockOffset(Cause):
    """knob: ppm; positive: the received waveform runs fast."""

    sign: float = 1.0
    family: str = "sample_clock_offset"

    def act(self, y, context):
        n = np.arange(len(y)) - MARGIN
        return numeric.at(y, MARGIN + n * (1 + 1e-6 * self.sign * self.knob))

    def truth(self, contexts):
        return {"offset_ppm": par(self.sign * self.knob)}, {}, {}


@dataclass(kw_only=True)
class PhaseNoise(Cause):
    """process(rng, n, rate) → phase of any scale; knob: its rms in the recording without offset and mean."""

    process: object = None
    free: bool = False  # wanders without a bound: a line width exists
    family: str = "phase_noise"
    stochastic: bool = True

    def course(self, context):
        phase = self.process(self.rng(context), context.length, context.rate)
        t = np.linspace(-1, 1, context.count)
        inside = phase[context.window]
        line = np.polynomial.polynomial.polyfit(t, inside, 1)
        rms = np.std(inside - line[0] - line[1] * t)
        return (phase - line[0]) * self.knob / rms, self.knob / rms

    def slope_hz(self, context):
        """The offset that the realised phase holds in the recording."""
        t = context.time[context.window]
        return float(np.polyfit(t, self.course(context)[0][context.window], 1)[0] / (2 * np.pi))

    def act(self, y, context):
        return y * np.exp(1j * self.course(context)[0])

    def truth(self, contexts):
        p = {"rms_rad": par(self.knob)}
        if self.free:
            scaled = self.course(contexts[0])[0][contexts[0].window]
            step = np.var(np.diff(scaled))
            p["linewidth_hz"] = par(step * contexts[0].rate / (2 * np.pi), z=len(contexts) == 1)
        return p, {}, {}


# ---------------------------------------------------------------- mixers
@dataclass(kw_only=True)
class Imbalance(Cause):
    """knob: the image's amplitude; turn: how it is split between gain and phase; both arms or the Q arm alone carry it."""

    turn: float = 0.0
    both: bool = False
    family: str = "iq_imbalance"

    def gains(self):
        gain, phase = 1 + 2 * self.knob * np.cos(self.turn), 2 * self.knob * np.sin(self.turn)
        if self.both:
            i, q = np.sqrt(gain) * np.exp(-0.5j * phase), np.exp(0.5j * phase) / np.sqrt(gain)
        else:
            i, q = 1.0, gain * np.exp(1j * phase)
        return gain, phase, (i + q) / 2, np.conj(i - q) / 2

    def act(self, y, context):
        _, _, direct, image = self.gains()
        return direct * y + image * np.conj(y)

    def truth(self, contexts):
        gain, phase, direct, image = self.gains()
        p = {
            "image_rejection_db": par(db(abs(direct / image) ** 2), unsigned=True),
            "gain_imbalance_db": par(2 * db(gain), z=False, unsigned=True),
            "phase_imbalance_rad": par(phase, z=False, unsigned=True),
        }
        return p, {}, {}


@dataclass(kw_only=True)
class DirectCurrent(Cause):
    """knob: amplitude re the rms of the wanted signal; with decay_s the transient of an AC-coupled stage."""

    angle: float = 0.0
    decay_s: float = 0.0
    family: str = "dc_offset"
    slot: str = "rx_dc"

    def act(self, y, context):
        level = self.knob * np.sqrt(context.wanted) * np.exp(1j * self.angle)
        if self.decay_s:
            level = level * np.exp(-np.maximum(context.time, 0) / self.decay_s)
        return y + level

    def truth(self, contexts):
        level = 2 * db(self.knob)
        if not self.decay_s:
            return {"level_dbc": par(level, z=len(contexts) == 1)}, {}, {}
        ratio = self.decay_s / contexts[0].duration
        mean = level + db(ratio / 2 * (1 - np.exp(-2 / ratio)))
        return {"level_dbc": par(level, z=False, also=[mean]), "decay_s": par(self.decay_s)}, {}, {}


@dataclass(kw_only=True)
class Leakage(Cause):
    angle: float = 0.0
    family: str = "lo_leakage"
    slot: str = "tx_leak"

    def act(self, x, context):
        wave = context.scene.wave(context.transmitter)
        amplitude = context.scene.transmitters[context.transmitter][1]
        return x + amplitude * np.sqrt(wave.on_power) * self.knob * np.exp(1j * self.angle)

    def truth(self, contexts):
        c = contexts[0]
        wave = c.scene.wave(self.name)
        level = 2 * db(self.knob)
        also = [level + db(wave.on_power / wave.power)]
        if not wave.repeat:
            also.append(level + db(wave.on_power / wave.power * c.count / len(wave.samples)))
        return {"level_dbc": par(level, also=also, z=wave.repeat)}, {}, {}


@dataclass(kw_only=True)
class Inversion(Cause):
    family: str = "spectral_inversion"
    slot: str = "rx_iq"
    fixed: bool = True

    def act(self, y, context):
        return np.conj(y)

    def truth(self, contexts):
        return {}, {}, {}


# ---------------------------------------------------------------- amplifiers and gains
@dataclass(kw_only=True)
class Amplifier(Cause):
    """curve(r) → complex gain at amplitude r, with gain 1 at 0; knob: largest transmitted amplitude re r = 1.
    echoes: [(samples, share)]: memory, as delayed copies of the distortion."""

    curve: object = None
    echoes: list = field(default_factory=list)
    family: str = "pa_nonlinearity"
    slot: str = "pa"

    def peak(self, context, times=1):
        s = context.scene
        top = max([s.transmitters[self.name][1]] + [r.amplitude.get(self.name, 0) for r in s.recordings])
        x = s.wave(self.name).samples
        return top * np.max(np.abs(numeric.oversampled(x, times) if times > 1 else x))

    def act(self, x, context):
        times = 4
        fine = numeric.oversampled(x, times)
        unit = self.knob / self.peak(context)
        bent = fine * (self.curve(np.abs(fine) * unit) - 1)
        out = fine + bent
        for lag, share in self.echoes:
            out = out + share * np.roll(bent, int(round(lag * times)))
        return numeric.narrowed(out, times)

    def truth(self, contexts):
        c = contexts[0]
        total = 1 + sum(share for _, share in self.echoes)
        between = self.knob * self.peak(c, 4) / self.peak(c)  # the largest value between the samples
        loss = [-2 * db(abs(1 + (self.curve(np.array([r]))[0] - 1) * total)) for r in (self.knob, between)]
        plain = -2 * db(abs(self.curve(np.array([self.knob]))[0]))
        p = {"compression_db": par(loss[0], z=False, also=[loss[1], plain], unsigned=True)}
        return p, {"memory": bool(self.echoes)}, {}


@dataclass(kw_only=True)
class Gain(Cause):
    """A gain's course; shape(context) gives it for knob, in dB or as a factor."""

    sign: float = 1.0
    where_s: float = 0.0  # of a step
    time_constant_s: float = 0.0  # of a relaxation
    frequency_hz: float = 0.0
    phase: float = 0.0
    harmonics: list = field(default_factory=list)  # [(order, share, phase)]

    def factor(self, context):
        t = context.time
        if self.family == "gain_step":
            return 10 ** (self.sign * self.knob / 20 * (t >= self.where_s - 1e-12))
        if self.family == "gain_drift":
            total, inside = context.duration, np.clip(t, 0, context.duration)
            if self.time_constant_s:
                course = -np.expm1(-inside / self.time_constant_s) / -np.expm1(-total / self.time_constant_s)
            else:
                course = inside / total
            return 10 ** (self.sign * self.knob / 20 * course)
        w = 2 * np.pi * self.frequency_hz / context.stretch * t
        phase = self.phase + 2.4 * context.recording.index
        hum = np.cos(w + phase)
        for order, share, turn in self.harmonics:
            hum = hum + share * np.cos(order * (w + phase) + turn)
        return 1 + self.knob * hum

    def act(self, y, context):
        return y * self.factor(context)

    def truth(self, contexts):
        if self.family == "gain_step":
            place = self.where_s
            p = {"time_s": par(place, z=False), "step_db": par(self.sign * self.knob)}
            return p, {}, {"time_s": [place, place]}
        if self.family == "gain_drift":
            p = {"total_db": par(self.sign * self.knob)}
            if self.time_constant_s:
                p["time_constant_s"] = par(self.time_constant_s)
            return p, {}, {}
        return {"frequency_hz": par(self.frequency_hz), "depth": par(self.knob, z=not self.harmonics)}, {}, {}


# ---------------------------------------------------------------- filters
@dataclass(kw_only=True)
class Filter(Cause):
    """response(f_hz, knob) → complex gain."""

    response: object = None
    family: str = "front_end_filter"
    same_as: list = field(default_factory=lambda: ["extra_path_within_sample"])

    def act(self, y, context):
        return numeric.filtered(y, lambda f: self.response(f, self.knob), context.rate)

    def truth(self, contexts):
        c = contexts[0]
        wave = c.scene.wave(c.recording.transmitters[0])
        shift = 0.0
        if self.slot == "rx_filter":
            shift = sum(k.signed for k in c.scene.known if k.family == "carrier_frequency_offset")
        ripples = []
        for below in (20, 10, 30):
            lo, hi = wave.band(below)
            h = 2 * db(np.abs(self.response(np.linspace(lo, hi, 801) * c.rate + shift, self.knob)))
            ripples.append(float(h.max() - h.min()))
        return {"ripple_db": par(ripples[0], z=False, also=ripples[1:], unsigned=True)}, {}, {}


# ---------------------------------------------------------------- paths
@dataclass(kw_only=True)
class Path(Cause):
    slot: str = "paths"
    level: str = "link"
    tap: int = 0

    def entry(self, context):
        a, b = self.name.split(">")
        return context.scene.links[(a, b)][self.tap]


@dataclass(kw_only=True)
class ExtraPath(Path):
    """knob: amplitude on the taps' scale."""

    family: str = "extra_path"
    delay_s: float = 0.0
    phase: float = 0.0
    doppler_hz: float = 0.0

    def act(self, taps, context):
        gain = self.knob * np.exp(1j * self.phase)
        return taps + [Tap(delay_s=self.delay_s, gain=gain, doppler_hz=self.doppler_hz)]

    def truth(self, contexts):
        level = 2 * db(self.knob)
        p = {"delay_s": par(self.delay_s), "gain_db": par(level), "phase_rad": par(self.phase, z=self.doppler_hz == 0)}
        if self.doppler_hz:
            p["doppler_hz"] = par(self.doppler_hz)
        return p, {}, {"delay_s": [self.delay_s, self.delay_s]}


@dataclass(kw_only=True)
class MissingPath(Path):
    family: str = "missing_path"
    fixed: bool = True

    def act(self, taps, context):
        return taps[: self.tap] + taps[self.tap + 1 :]

    def truth(self, contexts):
        d = self.entry(contexts[0])["delay_s"]
        return {"delay_s": par(d, z=False)}, {}, {"delay_s": [d, d]}


@dataclass(kw_only=True)
class TapError(Path):
    """tap_gain_error (knob: relative size), tap_delay_error (knob: seconds), tap_doppler (knob: Hz)."""

    turn: float = 0.0
    sign: float = 1.0
    steady: bool = False  # the Doppler turns the phase alone

    def act(self, taps, context):
        tap = taps[self.tap]
        if self.family == "tap_gain_error":
            tap = replace(tap, gain=tap.gain * (1 + self.knob * np.exp(1j * self.turn)))
        elif self.family == "tap_delay_error":
            tap = replace(tap, delay_s=tap.delay_s + self.sign * self.knob)
        else:
            tap = replace(tap, doppler_hz=tap.doppler_hz + self.sign * self.knob, moving=True)
        return taps[: self.tap] + [tap] + taps[self.tap + 1 :]

    def truth(self, contexts):
        e = self.entry(contexts[0])
        d = e["delay_s"]
        p = {"delay_s": par(d, z=False)}
        if self.family == "tap_gain_error":
            g = 1 + self.knob * np.exp(1j * self.turn)
            p |= {"error_db": par(2 * db(abs(g))), "error_rad": par(np.angle(g))}
        elif self.family == "tap_delay_error":
            p["error_s"] = par(self.sign * self.knob)
        else:
            change = self.sign * self.knob
            p["doppler_hz"] = par(change, also=[change + e["doppler_hz"]])
        return p, {}, {"delay_s": [d, d]}


@dataclass(kw_only=True)
class TapFading(Path):
    """process(rng, n, rate) → complex course of mean power 1; knob: scattered amplitude re the steady one."""

    family: str = "tap_fading"
    process: object = None
    spread_hz: float = 0.0
    stochastic: bool = True

    def course(self, context):
        return 1 + self.knob * self.process(self.rng(context), context.length, context.rate)

    def act(self, taps, context):
        tap = taps[self.tap]
        now = tap.gain if tap.course is None else tap.course
        return taps[: self.tap] + [replace(tap, course=now * self.course(context))] + taps[self.tap + 1 :]

    def truth(self, contexts):
        c = contexts[0]
        d = self.entry(c)["delay_s"]
        h = self.course(c)[c.window]
        k = db(abs(np.mean(h)) ** 2 / np.var(h))
        settled = self.spread_hz * c.duration > 20 and len(contexts) == 1
        p = {
            "delay_s": par(d, z=False),
            "k_factor_db": par(k, z=settled, also=[-2 * db(self.knob)]),
            "doppler_spread_hz": par(self.spread_hz, z=False),
        }
        return p, {}, {"delay_s": [d, d]}


@dataclass(kw_only=True)
class Tail(Path):
    """Dense echoes of exponentially falling power behind start_s; knob: amplitude of all together."""

    family: str = "diffuse_tail"
    start_s: float = 0.0
    decay_s: float = 0.0
    spacing_s: float = 0.0
    rice: bool = False
    stochastic: bool = True

    def taps(self):
        rng = np.random.default_rng(self.seed)
        n = int(np.ceil(7 * self.decay_s / self.spacing_s))
        t = (np.arange(n) + (rng.uniform(0.2, 0.8, n) if self.rice else 0.5)) * self.spacing_s
        size = np.exp(-t / (2 * self.decay_s))
        if self.rice:
            a = size * np.exp(2j * np.pi * rng.uniform(0, 1, n)) * (1 + 0.25 * rng.standard_normal(n))
        else:
            a = size * (rng.standard_normal(n) + 1j * rng.standard_normal(n)) / np.sqrt(2)
        return self.start_s + t, self.knob * a / np.sqrt(np.sum(np.abs(a) ** 2))

    def act(self, taps, context):
        return taps + [Tap(delay_s=d, gain=g) for d, g in zip(*self.taps(), strict=True)]

    def truth(self, contexts):
        p = {"decay_s": par(self.decay_s, z=False), "power_db": par(2 * db(self.knob), z=False)}
        return p, {}, {"delay_s": [self.start_s, self.start_s + 3 * self.decay_s]}


# ---------------------------------------------------------------- others on the air
@dataclass(kw_only=True)
class Air(Cause):
    """Something that arrives beside the wanted signal: signal(context) → unit amplitude; knob: rms re the wanted rms."""

    level: str = "environment"
    name: str = "environment"
    slot: str = "air"

    def power(self, context):
        return self.knob**2 * context.wanted


@dataclass(kw_only=True)
class SecondTransmitter(Air):
    family: str = "second_transmitter"
    wave: str = ""
    delay: float = 0.0

    def act(self, y, context):
        wave = context.scene.waves[self.wave]
        x = scene.placed(wave, self.delay + 31.7 * context.recording.index, context.length)
        return y + context.recording.gain * self.knob * x

    def truth(self, contexts):
        c = contexts[0]
        p = {"gain_db": par(2 * db(self.knob), z=len(contexts) == 1), "delay_s": par(self.delay / c.rate, z=False)}
        return p, {"code": self.wave}, {}


@dataclass(kw_only=True)
class Tone(Air):
    family: str = "tone_interference"
    frequency_hz: float = 0.0

    def act(self, y, context):
        turn = 2 * np.pi * self.rng(context).uniform()
        w = 2j * np.pi * context.arriving(self.frequency_hz)
        return y + np.sqrt(self.power(context)) * np.exp(w * context.time + 1j * turn)

    def truth(self, contexts):
        f = self.frequency_hz
        p = {"frequency_hz": par(f), "power_dbc": par(2 * db(self.knob), z=len(contexts) == 1)}
        return p, {}, {"frequency_hz": [f, f]}


@dataclass(kw_only=True)
class Narrowband(Air):
    """process(rng, n, rate, bandwidth_hz) → a signal about 0 Hz of mean power 1."""

    family: str = "narrowband_interference"
    frequency_hz: float = 0.0
    bandwidth_hz: float = 0.0
    process: object = None
    noise_like: bool = True
    stochastic: bool = True
    boxed: bool = True  # its band has edges

    def act(self, y, context):
        s = self.process(self.rng(context), len(y), context.rate, self.bandwidth_hz)
        s = s / np.sqrt(np.mean(np.abs(s[context.window]) ** 2))
        w = 2j * np.pi * context.arriving(self.frequency_hz)
        return y + np.sqrt(self.power(context)) * s * np.exp(w * context.time)

    def nats(self, context):
        b, s, p = self.bandwidth_hz / context.rate, context.sigma2, self.power(context)
        return context.count * (np.log(s + p) - b * np.log(s + p / b) - (1 - b) * np.log(s))

    def truth(self, contexts):
        f, half = self.frequency_hz, self.bandwidth_hz / 2
        p = {
            "frequency_hz": par(f, z=False),
            "power_dbc": par(2 * db(self.knob), z=False),
            "bandwidth_hz": par(2 * half, z=False),
        }
        return p, {}, {"frequency_hz": [f - half, f + half]} if self.boxed else {}


@dataclass(kw_only=True)
class Pulsed(Air):
    """burst(rng, n, rate, k) → the k-th pulse of n samples, mean power 1; knob: rms while on re the wanted rms."""

    family: str = "pulsed_interference"
    period_s: float = 0.0
    duty: float = 0.0
    burst: object = None
    start_s: float = 0.0
    frequency_hz: float = 0.0
    stochastic: bool = True

    def act(self, y, context):
        rng = self.rng(context)
        out = np.zeros(len(y), complex)
        length = max(1, int(round(self.duty * self.period_s * context.rate)))
        first = int(np.floor((-MARGIN / context.rate - self.start_s) / self.period_s))
        last = int(np.ceil(len(y) / context.rate / self.period_s)) + first
        for k in range(first, last):
            at = MARGIN + int(round((self.start_s + k * self.period_s) * context.rate))
            s = self.burst(rng, length, context.rate, k)
            lo, hi = max(at, 0), min(at + length, len(y))
            if lo < hi:
                out[lo:hi] = s[lo - at : hi - at]
        w = 2j * np.pi * context.arriving(self.frequency_hz)
        return y + np.sqrt(self.power(context)) * out * np.exp(w * context.time)

    def nats(self, context):
        s, p, d = context.sigma2, self.power(context), self.duty
        return context.count * (np.log(s + d * p) - d * np.log(s + p) - (1 - d) * np.log(s))

    def truth(self, contexts):
        level = 2 * db(self.knob)
        p = {
            "period_s": par(self.period_s, z=False),
            "duty_cycle": par(self.duty, z=False),
            "power_dbc": par(level, z=False, also=[level + db(self.duty)]),
        }
        return p, {}, {}


@dataclass(kw_only=True)
class Impulses(Air):
    """shape(rng, rate) → one impulse, its largest magnitude 1; knob: that magnitude, full scale 1, is drawn about it."""

    family: str = "impulsive_noise"
    rate_hz: float = 0.0
    shape: object = None
    spread_db: float = 0.0
    bunch: int = 1
    noise_like: bool = True
    stochastic: bool = True

    def train(self, context):
        rng = self.rng(context)
        out = np.zeros(context.length, complex)
        groups = max(1, rng.poisson(self.rate_hz / self.bunch * context.duration))
        places = []
        for start in rng.uniform(0, context.count, groups):
            gaps = rng.exponential(40.0, self.bunch)
            gaps[0] = 0
            places += list(start + np.cumsum(gaps))
        for place in places:
            s = self.shape(rng, context.rate) * 10 ** (rng.normal(0, self.spread_db) / 20)
            s = s * np.exp(2j * np.pi * rng.uniform())
            at = MARGIN + int(place)
            out[at : at + len(s)] += s[: len(out) - at]
        return out, np.array(places)

    def act(self, y, context):
        return y + self.knob * self.train(context)[0]

    def nats(self, context):
        v = context.sigma2 + np.abs(self.knob * self.train(context)[0][context.window]) ** 2
        return float(context.count * (np.log(np.mean(v)) - np.mean(np.log(v))))

    def truth(self, contexts):
        c = contexts[0]
        train, places = self.train(c)
        inside = train[c.window]
        count = int(np.sum(places < c.count))
        energy = np.sum(np.abs(inside) ** 2) * self.knob**2 / max(count, 1)
        hit = np.abs(inside) > 0.1 * np.abs(inside).max()
        mean = np.mean(np.abs(inside[hit]) ** 2) * self.knob**2
        p = {
            "rate_hz": par(count / c.duration, z=False, also=[self.rate_hz, self.rate_hz / self.bunch]),
            "power_db": par(2 * db(self.knob), z=False, also=[db(energy), db(mean)]),
        }
        return p, {}, {}


# ---------------------------------------------------------------- noise
@dataclass(kw_only=True)
class NoiseFloor(Cause):
    """knob: dB of change from what the twin says; sign −1: it is quieter."""

    sign: float = 1.0
    family: str = "noise_floor"
    slot: str = "noise"
    level: str = "rx"
    noise_like: bool = True

    def act(self, y, context):
        ratio = 10 ** (self.sign * self.knob / 10)
        if ratio < 1:
            return context.clean + (y - context.clean) * np.sqrt(ratio)
        rng = self.rng(context)
        n = len(y)
        extra = rng.standard_normal(n) + 1j * rng.standard_normal(n)
        return y + np.sqrt((ratio - 1) * context.sigma2 / 2) * extra

    def nats(self, context):
        ratio = 10 ** (self.sign * self.knob / 10)
        return context.count * (ratio - 1 - np.log(ratio))

    def truth(self, contexts):
        return {"change_db": par(self.sign * self.knob)}, {}, {}


@dataclass(kw_only=True)
class SignalNoise(Cause):
    """knob: amplitude of the noise that follows the signal, at mean wanted power, re the floor's."""

    family: str = "signal_dependent_noise"
    slot: str = "noise"
    level: str = "rx"
    smooth: int = 1
    noise_like: bool = True
    stochastic: bool = True

    def envelope(self, signal):
        p = np.abs(signal) ** 2
        if self.smooth > 1:
            steps = np.cumsum(np.concatenate([p, p[: self.smooth]]))
            p = (steps[self.smooth :] - steps[: -self.smooth]) / self.smooth
        return p

    def act(self, y, context):
        rng = self.rng(context)
        n = len(y)
        size = np.sqrt(self.envelope(context.clean) / context.wanted * context.sigma2 / 2) * self.knob
        return y + size * (rng.standard_normal(n) + 1j * rng.standard_normal(n))

    def nats(self, context):
        p = self.envelope(scene.baseline(context.scene, context.recording))[context.window] / context.wanted
        v = 1 + self.knob**2 * p
        return float(context.count * (np.log(np.mean(v)) - np.mean(np.log(v))))

    def truth(self, contexts):
        return {"slope_db": par(2 * db(self.knob), z=False)}, {}, {}


# ---------------------------------------------------------------- converters
@dataclass(kw_only=True)
class Clipping(Cause):
    """knob: the rms of the wanted signal over the level of the rails."""

    family: str = "adc_clipping"
    slot: str = "adc_clip"
    level: str = "rx"

    def rail(self, context):
        s = context.scene
        power = max(_wanted(s, r) for r in s.recordings if r.receiver == self.name)
        return np.sqrt(power) / self.knob

    def act(self, y, context):
        a = self.rail(context)
        return np.clip(y.real, -a, a) + 1j * np.clip(y.imag, -a, a)

    def truth(self, contexts):
        return {"level": par(self.rail(contexts[0]))}, {}, {}


def _wanted(s, recording):
    return scene.Context(s, recording).wanted


@dataclass(kw_only=True)
class Quantizer(Cause):
    """knob: step; rise: no level at zero; dither: 0 none, 1 uniform over a step, 2 triangular over two."""

    family: str = "quantization"
    slot: str = "adc_step"
    level: str = "rx"
    rise: bool = False
    dither: int = 0
    grid: float = 0.0  # the step is a whole number of these

    @property
    def step(self):
        return max(1, round(self.knob / self.grid)) * self.grid if self.grid else self.knob

    def act(self, y, context):
        q, rng = self.step, self.rng(context)
        parts = []
        for part in (y.real, y.imag):
            x = part / q
            for _ in range(self.dither):
                x = x + rng.uniform(-0.5, 0.5, len(x))
            parts.append(q * (np.floor(x) + 0.5 if self.rise else np.rint(x)))
        return parts[0] + 1j * parts[1]

    def truth(self, contexts):
        return {"step": par(self.step)}, {}, {}


@dataclass(kw_only=True)
class SampleLoss(Cause):
    """samples lost (positive) or inserted at a place of the recording."""

    family: str = "sample_loss"
    slot: str = "adc_time"
    level: str = "rx"
    fixed: bool = True
    place: int = 0
    samples: int = 0
    fill: str = "zeros"

    def act(self, y, context):
        at, k = MARGIN + self.place, self.samples
        if k > 0:
            return np.concatenate([y[:at], y[at + k :], y[:k]])
        filler = np.zeros(-k, complex) if self.fill == "zeros" else y[at + k : at]
        return np.concatenate([y[:at], filler, y[at : len(y) + k]])

    def truth(self, contexts):
        t = self.place / contexts[0].rate
        p = {"time_s": par(t, z=False), "samples": par(self.samples, z=False)}
        return p, {}, {"time_s": [t, t]}


@dataclass(kw_only=True)
class Outside(Cause):
    """Physics that no family has: law(y, context, knob) at any slot."""

    law: object = None
    place: list = field(default_factory=list)

    def act(self, y, context):
        return self.law(y, context, self.knob)

    def truth(self, contexts):
        return {}, {}, {"time_s": self.place} if self.place else {}
