# SPDX-License-Identifier: GPL-3.0-or-later
"""The families of the contract, each in several forms. A cause is drawn once; `size` scales it (a power's root, mostly)."""

import copy

import numpy as np
from scipy import signal

from .chain import AFTER, BEFORE, Path, received
from .waves import FINE


def about(value, sure=True, also=(), unsigned=False):
    """One parameter of a truth."""
    return {"value": float(value), "z": bool(sure), "also": [float(a) for a in also], "unsigned": bool(unsigned)}


def db(power):
    return 10 * np.log10(power)


class Cause:
    family = stage = None
    levels = ("rx",)
    additive = noisy = random = False
    low, high, start = 1e-5, 10.0, 0.01  # of `size`
    floor = 1.0  # factor on the noise's power
    known_turn = 0.0
    same_as = ()
    needs = {}  # of the scene: taps (least number), offset, complex, envelope, flat, wide …

    def __init__(self, rng, scene, form, level=None, name=None):
        self.form, self.size = form, self.start
        self.level = level or str(rng.choice(self.levels))
        self.name = name
        self.seed = int(rng.integers(2**62))
        self.draw(rng, scene)

    def draw(self, rng, scene):
        pass

    def sized(self, size):
        out = copy.copy(self)
        out.size = float(size)
        return out

    def generator(self, scene=None):
        """The same numbers at each call, others for each recording of a network."""
        words = [] if scene is None or scene.stem == "recording" else [sum(scene.stem.encode())]
        return np.random.default_rng([self.seed, *words])

    def paths(self, paths, scene):
        return paths

    def nats(self, scene):
        """Information, for causes that are noise; None where the residual's energy counts."""
        return None

    def truth(self, scene, wanted):
        """-> parameters, values, where; wanted: mean power of the wanted signal in the recording."""
        return {}, {}, {}


# ---------------------------------------------------------------- oscillators and clocks
class CarrierOffset(Cause):
    """forms: still, drift, both, far (to a tenth of the sample rate)."""

    family, stage, levels = "carrier_frequency_offset", "oscillator", ("tx", "rx")
    low, high, start = 1e-3, 1e9, 1.0

    def draw(self, rng, scene):
        self.unit = 1 / scene.duration_s
        self.sign = rng.choice([-1, 1])
        self.ratio = {"still": 0.0, "drift": rng.choice([-1, 1]) * 50.0, "both": rng.uniform(-2, 2), "far": 0.0}[self.form]
        self.phase = rng.uniform(-np.pi, np.pi)
        if self.form == "far":
            room = max(0.002, min(0.1, 0.5 - scene.wave.band / 2 - 0.01))
            self.size = room * scene.rate_hz / self.unit * 10 ** rng.uniform(-1.2, 0)
            self.low = self.high = self.size
        else:
            self.high = 0.02 * scene.rate_hz / self.unit
        late = max(t["delay_s"] for t in scene.taps)
        if self.level == "tx" and late > 0:  # a transmitter's offset turns late paths too: kept unseen
            limit = 0.003 / (2 * np.pi * late) / self.unit
            if self.name is None and (limit < self.high or self.form == "far"):
                self.level = "rx"
            elif self.form != "far":
                self.high = min(self.high, limit)

    @property
    def offset_hz(self):
        return float(self.sign * self.size * self.unit * (0.02 if self.form == "drift" else 1.0))

    @property
    def drift(self):
        return float(self.offset_hz * self.ratio * self.unit)

    @property
    def known_turn(self):
        return self.offset_hz if self.level == "rx" else 0.0

    def factor(self, t, scene):
        return np.exp(2j * np.pi * (self.offset_hz * t + self.drift / 2 * t * t))

    def truth(self, scene, wanted):
        sure = self.form != "drift"
        return {"offset_hz": about(self.offset_hz, sure), "drift_hz_per_s": about(self.drift)}, {}, {}


class SampleClock(Cause):
    """forms: fine, coarse (a cheap crystal: 5 to 200 ppm)."""

    family, stage, levels = "sample_clock_offset", "clock", ("tx", "rx")
    low, high, start = 1e-3, 200.0, 1.0

    def draw(self, rng, scene):
        self.sign = rng.choice([-1, 1])
        if self.form == "coarse":
            self.size = self.low = self.high = 10 ** rng.uniform(np.log10(5), np.log10(200))

    @property
    def ppm(self):
        return float(self.sign * self.size)

    def truth(self, scene, wanted):
        return {"offset_ppm": about(self.ppm)}, {}, {}


class PhaseNoise(Cause):
    """forms: wiener, flicker (1/f³), pll (flat inside the loop), hump (white inside, a peak at the loop's edge)."""

    family, stage, levels, random = "phase_noise", "oscillator", ("tx", "rx"), True
    low, high, start = 1e-4, 0.8, 0.02

    def draw(self, rng, scene):
        self.loop = 10 ** rng.uniform(1.0, np.log10(scene.n / 60)) / scene.n  # cycles per sample
        self.cache = {}

    def shape(self, scene):
        if scene.stem not in self.cache:
            rng, n = self.generator(scene), scene.n + BEFORE + AFTER
            if self.form == "wiener":
                phase = np.cumsum(rng.standard_normal(n))
            else:
                f = np.abs(np.fft.rfftfreq(2 * n))
                f[0] = f[1]
                low = np.maximum(f, 0.3 / scene.n)
                power = {
                    "flicker": low**-3.0,
                    "pll": 1 / (1 + (f / self.loop) ** 4),
                    "hump": (1 + 4 * np.exp(-(((f / self.loop - 1) / 0.3) ** 2))) / (1 + (f / self.loop) ** 6),
                }[self.form]
                spectrum = np.sqrt(power) * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
                phase = np.fft.irfft(spectrum)[:n]
            inside = phase[BEFORE : BEFORE + scene.n]
            line = np.polyfit(np.arange(scene.n), inside, 1)
            rest = inside - np.polyval(line, np.arange(scene.n))
            scale = 1 / np.sqrt(np.mean(rest**2))
            phase = phase - inside[0]
            if self.form != "wiener":  # a loop has no offset of its own
                phase = phase - np.polyval(line - [0, inside[0]], np.arange(-BEFORE, scene.n + AFTER))
            self.cache[scene.stem] = phase * scale, scale
        return self.cache[scene.stem]

    def factor(self, t, scene):
        phase, _ = self.shape(scene)
        return np.exp(1j * self.size * np.interp(t, scene.grid / scene.rate_hz, phase))

    def truth(self, scene, wanted):
        out = {"rms_rad": about(self.size, scene.stem == "recording")}
        if self.form == "wiener":
            _, scale = self.shape(scene)
            width = (self.size * scale) ** 2 * scene.rate_hz / (2 * np.pi)  # increments' variance 2π·linewidth/rate
            out["linewidth_hz"] = about(width, False, [width / 2, width * 2])
        return out, {}, {}


# ---------------------------------------------------------------- modulators and converters
class Imbalance(Cause):
    """forms: gain, phase, mixed."""

    family, levels = "iq_imbalance", ("tx", "rx")
    needs = {"complex": True}
    low, high, start = 10 ** (-70 / 20), 0.18, 0.01

    def draw(self, rng, scene):
        side = {"gain": 0.0, "phase": np.pi / 2, "mixed": rng.uniform(0.2, 1.3)}[self.form]
        self.angle = side * rng.choice([-1, 1]) + rng.choice([0, np.pi])

    @property
    def stage(self):
        return f"{self.level}_iq"

    def mix(self):
        """y = a·x + b·x*, from the gain g of Q and the phase φ between the branches."""
        g, phi = 1 + 2 * self.size * np.cos(self.angle), 2 * self.size * np.sin(self.angle)
        return (1 + g * np.exp(-1j * phi)) / 2, (1 - g * np.exp(1j * phi)) / 2, 20 * np.log10(g), phi

    def imbalanced(self, x):
        a, b, _, _ = self.mix()
        return a * x + b * x.conj()

    def truth(self, scene, wanted):
        a, b, g, phi = self.mix()
        return (
            {
                "image_rejection_db": about(-20 * np.log10(abs(b / a)), unsigned=True),
                "gain_imbalance_db": about(g, False, unsigned=True),
                "phase_imbalance_rad": about(phi, False, unsigned=True),
            },
            {},
            {},
        )


class Constant(Cause):
    """forms: steady, decaying (a high-pass that settles)."""

    family, stage, additive = "dc_offset", "dc", True
    needs = {"offset": True}
    low, high, start = 1e-4, 1.5, 0.01

    def draw(self, rng, scene):
        self.phase = rng.uniform(-np.pi, np.pi)
        self.decay_s = scene.duration_s * 10 ** rng.uniform(-1.3, -0.3)

    def constant(self, t, scene):
        level = self.size * scene.rms() * np.exp(1j * self.phase)
        return level * np.exp(-np.maximum(t, -0.01 * self.decay_s) / self.decay_s) if self.form == "decaying" else level

    def truth(self, scene, wanted):
        first = db((self.size * scene.rms()) ** 2 / wanted)
        if self.form == "steady":
            return {"level_dbc": about(first)}, {}, {}
        x = scene.duration_s / self.decay_s
        mean = first + db((1 - np.exp(-2 * x)) / (2 * x))
        return {"level_dbc": about(first, False, [mean]), "decay_s": about(self.decay_s)}, {}, {}


class Leak(Cause):
    """forms: steady."""

    family, stage, levels = "lo_leakage", "tx_leak", ("tx",)
    needs = {"offset": True}
    low, high, start = 1e-4, 1.0, 0.01

    def draw(self, rng, scene):
        self.phase = rng.uniform(-np.pi, np.pi)

    def leak(self, scene):
        return self.size * np.sqrt(np.mean(np.abs(scene.wave.samples) ** 2)) * np.exp(1j * self.phase)

    def truth(self, scene, wanted):
        x = np.abs(scene.wave.samples)
        on = x > 0.02 * x.max()
        more = db(np.mean(on)) if np.mean(on) < 0.95 else 0.0
        return {"level_dbc": about(20 * np.log10(self.size), abs(more) < 0.1, [20 * np.log10(self.size) + more])}, {}, {}


class Amplifier(Cause):
    """forms: rapp, saleh, cubic (complex third order), fifth, memory (a delayed cubic)."""

    family, stage, levels = "pa_nonlinearity", "pa", ("tx",)
    needs = {"envelope": True}
    low, high, start = 1e-3, 1.2, 0.1

    def draw(self, rng, scene):
        self.sharp = rng.uniform(1.0, 3.0)
        self.bend = rng.uniform(0.0, 0.6) * rng.choice([-1, 1])
        self.lag = int(rng.choice([2, 4, 6, 8]))  # fine samples
        self.top = float(np.max(np.abs(scene.wave.samples)))
        if self.form == "memory":
            self.share = rng.uniform(0.3, 0.7) * np.exp(1j * rng.uniform(-np.pi, np.pi))

    def gain(self, r):
        """Complex gain at envelope r, re the largest sample of the waveform; size² is of the order of the compression."""
        if self.form == "rapp":
            return (1 + (self.size * 1.4 * r) ** (2 * self.sharp)) ** (-1 / (2 * self.sharp)) + 0j
        if self.form == "saleh":
            b = (self.size * r) ** 2
            return 1 / (1 + b) * np.exp(1j * self.bend * 2 * b / (1 + b))
        weak = np.minimum(self.size**2, 0.33)
        if self.form == "fifth":
            return 1 - weak * (0.4 * r**2 + 0.5 * np.exp(1j * self.bend) * r**4) * (r < 1.6) - 0.5 * weak * (r >= 1.6)
        return 1 - weak * np.exp(1j * self.bend) * np.minimum(r, 1.3) ** 2

    def amplified(self, x):
        r = np.abs(x) / self.top
        out = x * self.gain(r)
        if self.form == "memory":
            weak = np.minimum(self.size**2, 0.33)
            out = out - np.roll(x * np.minimum(r, 1.3) ** 2, self.lag) * weak * self.share
        return out

    def truth(self, scene, wanted):
        def lost(r):
            return 20 * np.log10(abs(self.gain(np.array([1e-6]))[0]) / abs(self.gain(np.array([r]))[0]))

        peak = float(np.max(np.abs(scene.sheet().fine))) / self.top
        return (
            {"compression_db": about(lost(1.0), False, [lost(peak), -lost(1.0)], unsigned=True)},
            {"memory": self.form == "memory"},
            {},
        )


class Clipping(Cause):
    """forms: rails. size: the largest of I and Q over the rail, less 1."""

    family, stage = "adc_clipping", "clip"
    low, high, start = 1e-3, 1.6, 0.1

    def draw(self, rng, scene):
        y = received(scene, scene.known)
        self.top = float(max(np.max(np.abs(y.real)), np.max(np.abs(y.imag))))

    @property
    def rail(self):
        return self.top / (1 + self.size)

    def converted(self, x):
        return np.clip(x.real, -self.rail, self.rail) + 1j * np.clip(x.imag, -self.rail, self.rail)

    def clipped_away(self, scene):
        """What the rails take from signal and noise together, added to the signal alone."""
        y, own = received(scene, scene.known), self.generator(scene)
        noisy = y + np.sqrt(scene.noise / 2) * (own.standard_normal(scene.n) + 1j * own.standard_normal(scene.n))
        return y + self.converted(noisy) - noisy

    def truth(self, scene, wanted):
        return {"level": about(self.rail)}, {}, {}


class Steps(Cause):
    """forms: tread (a level at 0), rise (none at 0)."""

    family, stage = "quantization", "steps"
    low, high, start = 1e-3, 0.5, 0.02

    def draw(self, rng, scene):
        self.bits = rng.uniform() < 0.5

    @property
    def step(self):
        return float(2.0 ** np.rint(np.log2(self.size))) if self.bits else self.size

    def converted(self, x):
        q = self.step
        if self.form == "rise":
            return (np.floor(x.real / q) + 0.5) * q + 1j * (np.floor(x.imag / q) + 0.5) * q
        return np.rint(x.real / q) * q + 1j * np.rint(x.imag / q) * q

    def nats(self, scene):
        return scene.n * self.step**2 / 6 / scene.noise

    def truth(self, scene, wanted):
        return {"step": about(self.step)}, {}, {}


# ---------------------------------------------------------------- gain over time
class GainStep(Cause):
    """forms: inside, end (in the first or last hundredth)."""

    family, stage, levels = "gain_step", "gain", ("tx", "rx")
    low, high, start = 1e-3, 12.0, 0.3

    def draw(self, rng, scene):
        ends = [rng.uniform(0.002, 0.01), rng.uniform(0.99, 0.998)]
        where = rng.uniform(0.03, 0.97) if self.form == "inside" else rng.choice(ends)
        self.time_s = np.rint(where * scene.n) / scene.rate_hz
        self.sign = rng.choice([-1, 1])

    def factor(self, t, scene):
        return np.where(t >= self.time_s - 1e-12, 10 ** (self.sign * self.size / 20), 1.0)

    def truth(self, scene, wanted):
        return (
            {"time_s": about(self.time_s, False), "step_db": about(self.sign * self.size)},
            {},
            {"time_s": [self.time_s, self.time_s]},
        )


class GainDrift(Cause):
    """forms: decibels (linear in dB), linear (in amplitude), warming (a relaxation)."""

    family, stage, levels = "gain_drift", "gain", ("tx", "rx")
    low, high, start = 1e-3, 10.0, 0.3

    def draw(self, rng, scene):
        self.sign = rng.choice([-1, 1])
        self.constant_s = scene.duration_s * rng.uniform(0.1, 0.5)

    def factor(self, t, scene):
        x = np.clip(t / scene.duration_s, -0.02, 1.05)
        total = self.sign * self.size
        if self.form == "linear":
            return 1 + (10 ** (total / 20) - 1) * x
        if self.form == "warming":
            r = scene.duration_s / self.constant_s
            x = (1 - np.exp(-x * r)) / (1 - np.exp(-r))
        return 10 ** (total * x / 20)

    def truth(self, scene, wanted):
        total = self.sign * self.size
        if self.form != "warming":
            return {"total_db": about(total)}, {}, {}
        final = total / (1 - np.exp(-scene.duration_s / self.constant_s))
        return {"total_db": about(total, True, [final]), "time_constant_s": about(self.constant_s)}, {}, {}


class Hum(Cause):
    """forms: pure, harmonics (second and third, as a rectifier leaves them)."""

    family, stage, levels = "power_supply_hum", "gain", ("tx", "rx")
    low, high, start = 1e-4, 0.35, 0.01
    lines = (50.0, 60.0, 100.0, 120.0, 150.0, 300.0, 400.0, 1200.0)
    switchers = (2e3, 4e3, 8e3, 16e3, 20e3, 33e3, 65e3, 100e3)

    def draw(self, rng, scene):
        low, high = 4 / scene.duration_s, min(0.02 * scene.rate_hz, 500 / scene.duration_s)
        fits = [f for f in self.lines + self.switchers if low < f < high]
        self.frequency = float(rng.choice(fits[:6])) if fits else 20 / scene.duration_s
        if self.frequency >= 2e3:
            self.frequency *= rng.uniform(0.9, 1.1)
        self.phase = rng.uniform(-np.pi, np.pi, 3)
        self.more = rng.uniform(0.1, 0.45, 2) if self.form == "harmonics" else np.zeros(2)

    def factor(self, t, scene):
        w = 2 * np.pi * self.frequency * t
        wave = np.cos(w + self.phase[0])
        for k in (0, 1):
            wave = wave + self.more[k] * np.cos((k + 2) * w + self.phase[k + 1])
        return 1 + self.size * wave

    def truth(self, scene, wanted):
        return {"frequency_hz": about(self.frequency), "depth": about(self.size, True, [2 * self.size])}, {}, {}


# ---------------------------------------------------------------- filters
class FrontEnd(Cause):
    """forms: butterworth, chebyshev, bessel (roll-offs at the band's edge), saw (triple transit), tilt, delay (all-pass)."""

    family, stage, levels = "front_end_filter", "tx_filter", ("tx", "rx")
    same_as = ("extra_path_within_sample",)
    low, high, start = 1e-3, 1.5, 0.1

    def draw(self, rng, scene):
        edge = scene.wave.band / 2
        self.edge = edge * rng.uniform(0.85, 1.3)
        self.order = int(rng.integers(2, 6))
        self.turn = rng.uniform(-np.pi, np.pi)
        self.echo = rng.uniform(2.0, 9.0)  # samples between the transits
        self.slope = rng.choice([-1, 1])

    def log_response(self, f):
        if self.form == "saw":  # 1 + a·e^{−jωT} with a of 0.1 at size 1
            return np.log(1 + 0.12 * np.exp(-2j * np.pi * f * self.echo + 1j * self.turn))
        if self.form == "tilt":
            x = np.clip(f / self.edge, -1.5, 1.5)
            return self.slope * 0.12 * x - 0.06 * x * x + 0.15j * np.sin(self.turn) * x**3
        if self.form == "delay":
            x = np.clip(f / self.edge, -1.5, 1.5)
            return 1j * (0.5 * np.sin(self.turn) * x**2 + 0.3 * np.cos(self.turn) * np.sin(2.2 * x))
        if self.form == "butterworth":
            _, poles, _ = signal.buttap(self.order)
        elif self.form == "chebyshev":
            _, poles, _ = signal.cheb1ap(self.order, 0.5)
        else:
            _, poles, _ = signal.besselap(self.order, norm="mag")
        s = 1j * np.clip(f / self.edge, -8, 8)
        return -sum(np.log((s - p) / -p) for p in poles)

    def response(self, f, scene):
        size = min(self.size, 6.0 if self.form == "saw" else 1.5)
        return np.exp(size * self.log_response(f))

    def truth(self, scene, wanted):
        spectrum = np.abs(np.fft.fft(scene.wave.samples)) ** 2
        f = np.fft.fftfreq(len(spectrum))
        order = np.argsort(np.abs(f), kind="stable")
        share = np.cumsum(spectrum[order]) / np.sum(spectrum)
        band = np.abs(f[order][np.searchsorted(share, 0.99)])
        level = 20 * np.log10(np.abs(self.response(np.linspace(-band, band, 801), scene)))
        ripple = float(np.max(level) - np.min(level))
        return {"ripple_db": about(ripple, False, [ripple / 2], unsigned=True)}, {}, {}


# ---------------------------------------------------------------- the channel
class ExtraPath(Cause):
    """forms: still, moving (a Doppler that moves its delay too), late (far behind)."""

    family, stage, levels = "extra_path", "path", ("link",)
    low, high, start = 1e-4, 0.9, 0.05

    def draw(self, rng, scene):
        own = np.array([t["delay_s"] for t in scene.taps]) * scene.rate_hz
        reach = 60 if self.form != "late" else min(600, 0.3 * scene.wave.period)
        for _ in range(200):
            d = rng.uniform(2.0, reach) if self.form != "late" else rng.uniform(60, max(61, reach))
            if np.min(np.abs(own - d)) > 2.0:
                break
        self.delay_s = d / scene.rate_hz
        self.phase = rng.uniform(-np.pi, np.pi)
        self.moving = rng.choice([-1, 1]) * 10 ** rng.uniform(0.3, 1.8) / scene.duration_s if self.form == "moving" else 0.0
        limit = 0.3 / scene.n * scene.carrier_hz  # a path that slides by less than a third of a sample
        self.moving = float(np.clip(self.moving, -limit, limit))

    def paths(self, paths, scene):
        return [*paths, Path(self.delay_s, self.size * np.exp(1j * self.phase), 0.0, self.moving)]

    def truth(self, scene, wanted):
        return (
            {
                "delay_s": about(self.delay_s),
                "gain_db": about(20 * np.log10(self.size)),
                "phase_rad": about(self.phase, self.moving == 0),
                "doppler_hz": about(self.moving, self.moving != 0),
            },
            {},
            {"delay_s": [self.delay_s, self.delay_s]},
        )


class OfTap(Cause):
    levels, stage = ("link",), "path"
    needs = {"taps": 3}

    def draw(self, rng, scene):
        self.tap = int(rng.integers(len(scene.taps)))
        self.delay_s = scene.taps[self.tap]["delay_s"]
        self.more(rng, scene)

    def more(self, rng, scene):
        pass

    def paths(self, paths, scene):
        out = []
        for p in paths:
            out += self.changed(copy.copy(p), scene) if p.tap == self.tap else [p]
        return out

    def place(self):
        return {"delay_s": [self.delay_s, self.delay_s]}


class MissingPath(OfTap):
    """forms: gone."""

    family = "missing_path"
    low = high = start = 1.0

    def more(self, rng, scene):
        self.tap = int(rng.integers(1, len(scene.taps)))
        self.delay_s = scene.taps[self.tap]["delay_s"]

    def changed(self, p, scene):
        return []

    def truth(self, scene, wanted):
        return {"delay_s": about(self.delay_s, False)}, {}, self.place()


class TapGain(OfTap):
    """forms: gain, phase, both."""

    family = "tap_gain_error"
    low, high, start = 1e-4, 0.7, 0.05

    def more(self, rng, scene):
        turn = {"gain": rng.choice([0.0, np.pi]), "phase": rng.choice([-1, 1]) * np.pi / 2, "both": rng.uniform(-np.pi, np.pi)}
        self.turn = turn[self.form]

    def error(self):
        return 1 + self.size * np.exp(1j * self.turn)

    def changed(self, p, scene):
        p.gain = p.gain * self.error()
        return [p]

    def truth(self, scene, wanted):
        e = self.error()
        return (
            {"delay_s": about(self.delay_s, False), "error_db": about(20 * np.log10(abs(e))), "error_rad": about(np.angle(e))},
            {},
            self.place(),
        )


class TapDelay(OfTap):
    """forms: early, late. size in samples."""

    family = "tap_delay_error"
    low, high, start = 1e-4, 1.2, 0.05

    def error_s(self, scene):
        return self.size / scene.rate_hz * (1 if self.form == "late" else -1)

    def changed(self, p, scene):
        p.delay_s += self.error_s(scene)
        return [p]

    def truth(self, scene, wanted):
        return {"delay_s": about(self.delay_s, False), "error_s": about(self.error_s(scene))}, {}, self.place()


class TapDoppler(OfTap):
    """forms: moves (the delay too)."""

    family, same_as = "tap_doppler", ("extra_path_at_tap",)
    low, high, start = 1e-3, 80.0, 0.1
    needs = {"taps": 2}

    def more(self, rng, scene):
        self.tap = int(rng.integers(1, len(scene.taps)))
        self.delay_s = scene.taps[self.tap]["delay_s"]
        self.unit = rng.choice([-1, 1]) / scene.duration_s
        self.high = float(np.clip(0.2 / scene.n * scene.carrier_hz * scene.duration_s, 0.05, 80.0))

    def changed(self, p, scene):
        p.moving_hz += self.size * self.unit
        return [p]

    def truth(self, scene, wanted):
        own = scene.taps[self.tap]["doppler_hz"]
        value = self.size * self.unit
        return ({"delay_s": about(self.delay_s, False), "doppler_hz": about(value, True, [value + own])}, {}, self.place())


class TapFading(OfTap):
    """forms: ring (Jakes), gaussian (Watterson), even (flat spectrum), few (three rays). size: scattered over steady."""

    family, random = "tap_fading", True
    low, high, start = 1e-3, 3.0, 0.1
    needs = {"taps": 1}

    def more(self, rng, scene):
        self.spread = 10 ** rng.uniform(0.3, np.log10(60)) / scene.duration_s
        self.spread = min(self.spread, 0.01 * scene.rate_hz)
        self.cache = {}

    def scattered(self, scene):
        if scene.stem not in self.cache:
            rng, t = self.generator(scene), scene.grid / scene.rate_hz
            rays = 3 if self.form == "few" else 48
            if self.form == "ring":
                f = self.spread * np.cos(2 * np.pi * (np.arange(rays) + rng.uniform()) / rays)
            elif self.form == "gaussian":
                f = self.spread / 2 * np.clip(rng.standard_normal(rays), -2, 2)  # the largest: two standard deviations
            else:
                f = self.spread * rng.uniform(-1, 1, rays)
                f[0] = self.spread * rng.choice([-1, 1])
            a = (rng.standard_normal(rays) + 1j * rng.standard_normal(rays)) / np.sqrt(2 * rays)
            if self.form == "few":
                a = np.exp(2j * np.pi * rng.uniform(size=rays)) / np.sqrt(rays)
            total = np.zeros(len(t), complex)
            for k in range(rays):
                total += a[k] * np.exp(2j * np.pi * f[k] * t)
            self.cache[scene.stem] = total
        return self.cache[scene.stem]

    def changed(self, p, scene):
        steady = 1 / np.sqrt(1 + self.size**2)
        factor = steady * (1 + self.size * self.scattered(scene))
        p.fading = factor if p.fading is None else p.fading * factor
        return [p]

    def truth(self, scene, wanted):
        g = 1 + self.size * self.scattered(scene)[BEFORE : BEFORE + scene.n]
        mean = np.mean(g)
        seen = db(abs(mean) ** 2 / np.mean(np.abs(g - mean) ** 2))
        k = -20 * np.log10(self.size)
        many = self.spread * scene.duration_s > 8 and self.form != "few" and k > -3
        return (
            {
                "delay_s": about(self.delay_s, False),
                "k_factor_db": about(k, many, [seen]),
                "doppler_spread_hz": about(self.spread, False, [self.spread / 2, self.spread / np.sqrt(2), 2 * self.spread]),
            },
            {},
            self.place(),
        )


class Tail(Cause):
    """forms: gaussian (a tap on every half sample), clusters (Poisson), two (a second cluster that starts later)."""

    family, stage, levels, random = "diffuse_tail", "tail", ("link",), True
    low, high, start = 1e-4, 0.9, 0.05
    decays = (5.0, 40.0)  # samples

    def draw(self, rng, scene):
        longest = min(self.decays[1], scene.wave.period / 8)
        self.decay = 10 ** rng.uniform(np.log10(self.decays[0]), np.log10(max(longest, self.decays[0] * 1.2)))
        self.first = rng.uniform(1.0, 3.0)
        self.cache = {}

    def rays(self, scene):
        if scene.stem not in self.cache:
            rng, last = self.generator(scene), 6.5 * self.decay
            if self.form == "clusters":
                starts = np.sort(rng.uniform(0, 4 * self.decay, 1 + rng.poisson(6)))
                starts[0] = 0.0
                delay = np.concatenate([s + np.cumsum(rng.exponential(0.4, 25)) for s in starts])
                inside = np.concatenate([np.arange(25.0) * 0.4 for _ in starts])
                power = np.exp(-delay / self.decay) * np.exp(-inside / (0.25 * self.decay))
            else:
                delay = np.arange(0, last, 0.5)
                power = np.exp(-delay / self.decay)
                if self.form == "two":
                    late = rng.uniform(1.0, 2.0) * self.decay
                    power = power + np.where(delay > late, 0.4 * np.exp(-(delay - late) / self.decay), 0)
            gain = np.sqrt(power / 2) * (rng.standard_normal(len(delay)) + 1j * rng.standard_normal(len(delay)))
            gain /= np.sqrt(np.sum(np.abs(gain) ** 2))
            self.cache[scene.stem] = delay + self.first, gain
        return self.cache[scene.stem]

    def response(self, f, scene):
        delay, gain = self.rays(scene)
        taps = np.zeros(len(f), complex)
        np.add.at(taps, np.rint(delay * FINE).astype(int) % len(f), gain)
        return self.size * np.fft.fft(taps)

    def truth(self, scene, wanted):
        decay_s, first = self.decay / scene.rate_hz, self.first / scene.rate_hz
        return (
            {"decay_s": about(decay_s, False, [2 * decay_s]), "power_db": about(20 * np.log10(self.size), False)},
            {},
            {"delay_s": [first, first + 3 * decay_s]},
        )


class SecondTransmitter(Cause):
    """forms: listed (a waveform of the twin that it believes silent)."""

    family, stage, levels = "second_transmitter", "second", ("environment",)
    needs = {"second": True}
    low, high, start = 1e-4, 1.2, 0.05

    def draw(self, rng, scene):
        self.delay = rng.uniform(0, scene.second.period if scene.second and scene.second.repeat else 100)
        self.phase = rng.uniform(-np.pi, np.pi)

    def second(self, scene):
        s = scene.sheet(scene.second).on_lattice(scene.grid, scene.delay + self.delay)
        return self.size * np.exp(1j * self.phase) * s

    def truth(self, scene, wanted):
        gain = 20 * np.log10(self.size)
        return (
            {
                "gain_db": about(gain, True, [gain - 20 * np.log10(scene.amplitude)]),
                "delay_s": about(self.delay / scene.rate_hz, False),
            },
            {"code": "w9"},
            {},
        )


# ---------------------------------------------------------------- the air
def _clear(rng, scene, width=0.0):
    """A frequency inside the recorded band and away from the middle, cycles per sample."""
    for _ in range(100):
        f = rng.uniform(-0.44, 0.44)
        if abs(f) > 0.004 + width + 20 / scene.n:
            return f
    return 0.2


class Tone(Cause):
    """forms: carrier."""

    family, stage, levels, additive = "tone_interference", "air", ("environment",), True
    low, high, start = 1e-4, 3.0, 0.03

    def draw(self, rng, scene):
        self.frequency = _clear(rng, scene) * scene.rate_hz
        self.phase = rng.uniform(-np.pi, np.pi)

    def air(self, total, scene, rng):
        t = scene.grid / scene.rate_hz
        return self.size * scene.air_rms() * np.exp(1j * (2 * np.pi * self.frequency * t + self.phase))

    def truth(self, scene, wanted):
        power = db((self.size * scene.air_rms()) ** 2 / wanted)
        return (
            {"frequency_hz": about(self.frequency), "power_dbc": about(power)},
            {},
            {"frequency_hz": [self.frequency, self.frequency]},
        )


class Narrowband(Cause):
    """forms: noise, fm (a carrier swung by a voice-like noise), keyed (slow BPSK)."""

    family, stage, levels = "narrowband_interference", "air", ("environment",)
    additive = noisy = random = True
    low, high, start = 1e-4, 5.0, 0.05

    def draw(self, rng, scene):
        self.width = 10 ** rng.uniform(np.log10(max(0.003, 200 / scene.n)), np.log10(0.05))
        self.frequency = _clear(rng, scene, self.width) * scene.rate_hz
        self.cache = {}

    def envelope(self, scene):
        if scene.stem not in self.cache:
            rng, n = self.generator(scene), len(scene.grid)
            f = np.fft.fftfreq(n)
            if self.form == "noise":
                x = np.fft.fft(rng.standard_normal(n) + 1j * rng.standard_normal(n)) * (np.abs(f) < self.width / 2)
                x = np.fft.ifft(x)
            elif self.form == "fm":
                swing = np.fft.ifft(np.fft.fft(rng.standard_normal(n)) * (np.abs(f) < self.width / 10)).real
                swing = np.clip(swing / np.std(swing), -2.5, 2.5) * self.width / 5
                x = np.exp(2j * np.pi * np.cumsum(swing))
            else:
                rate = self.width / 1.3
                symbols = rng.choice([-1.0, 1.0], int(n * rate) + 3)
                x = symbols[(np.arange(n) * rate).astype(int)]
                x = np.fft.ifft(np.fft.fft(x) * (np.abs(f) < self.width / 2))
            self.cache[scene.stem] = x / np.sqrt(np.mean(np.abs(x) ** 2))
        return self.cache[scene.stem]

    def air(self, total, scene, rng):
        t = scene.grid / scene.rate_hz
        return self.size * scene.air_rms() * self.envelope(scene) * np.exp(2j * np.pi * self.frequency * t)

    def nats(self, scene):
        ratio = (self.size * scene.air_rms()) ** 2 / scene.noise
        return scene.n * (np.log1p(ratio) - self.width * np.log1p(ratio / self.width))

    def truth(self, scene, wanted):
        half, power = self.width * scene.rate_hz / 2, db((self.size * scene.air_rms()) ** 2 / wanted)
        return (
            {
                "frequency_hz": about(self.frequency, False),
                "power_dbc": about(power, False),
                "bandwidth_hz": about(2 * half, False),
            },
            {},
            {"frequency_hz": [self.frequency - half, self.frequency + half]},
        )


class Pulses(Cause):
    """forms: noise (bursts of it), carrier (a pulsed coherent tone), sweep (chirped pulses)."""

    family, stage, levels = "pulsed_interference", "air", ("environment",)
    additive = noisy = random = True
    low, high, start = 1e-3, 10.0, 0.3

    def draw(self, rng, scene):
        self.period = scene.n / 10 ** rng.uniform(np.log10(5), np.log10(60))
        self.duty = float(np.exp(rng.uniform(np.log(0.02), np.log(0.5))))
        self.offset = rng.uniform(0, self.period)
        self.frequency = _clear(rng, scene)
        self.reach = rng.uniform(0.05, 0.3)

    def on(self, scene):
        return ((scene.grid - self.offset) / self.period) % 1.0 < self.duty

    def air(self, total, scene, rng):
        own, n = self.generator(scene), scene.grid
        if self.form == "noise":
            x = (own.standard_normal(len(n)) + 1j * own.standard_normal(len(n))) / np.sqrt(2)
        else:
            inside = ((n - self.offset) / self.period) % 1.0 * self.period
            sweep = self.reach / (2 * self.duty * self.period) if self.form == "sweep" else 0.0
            start = self.frequency - (self.reach / 2 if self.form == "sweep" else 0.0)
            x = np.exp(2j * np.pi * (start * inside + sweep * inside**2))
        return self.size * scene.air_rms() * x * self.on(scene)

    def nats(self, scene):
        ratio = (self.size * scene.air_rms()) ** 2 / scene.noise
        return scene.n * (np.log1p(self.duty * ratio) - self.duty * np.log1p(ratio))

    def truth(self, scene, wanted):
        power = db((self.size * scene.air_rms()) ** 2 / wanted)
        return (
            {
                "period_s": about(self.period / scene.rate_hz, False),
                "duty_cycle": about(self.duty, False),
                "power_dbc": about(power, False, [power + db(self.duty)]),
            },
            {},
            {},
        )


class Impulses(Cause):
    """forms: single (one sample each), motor (band-limited by the receiver), lightning (decaying, in strokes), gaussian."""

    family, stage, levels = "impulsive_noise", "air", ("environment",)
    additive = noisy = random = True
    low, high, start = 1e-2, 300.0, 3.0  # an impulse's amplitude over the noise's

    def draw(self, rng, scene):
        self.rate = 10 ** rng.uniform(np.log10(20), np.log10(0.004 * scene.n)) / scene.n  # per sample
        self.length = rng.uniform(2.0, 8.0)
        self.cache = {}

    def shape(self, scene):
        """Impulses of unit amplitude."""
        if scene.stem not in self.cache:
            rng, n = self.generator(scene), len(scene.grid)
            count = max(8, rng.poisson(self.rate * n))
            place = rng.uniform(0, n, count)
            if self.form == "lightning":  # a flash is a few strokes
                first = rng.uniform(0, n, max(4, count // 3))
                place = np.concatenate([first + k * rng.uniform(30, 0.003 * n + 60, len(first)) for k in range(3)]) % n
            gain = np.exp(2j * np.pi * rng.uniform(size=len(place)))
            if self.form == "gaussian":
                gain = (rng.standard_normal(len(place)) + 1j * rng.standard_normal(len(place))) / np.sqrt(2)
            x = np.zeros(n, complex)
            if self.form in ("single", "gaussian"):
                np.add.at(x, place.astype(int), gain)
            else:
                reach = np.arange(-12, 60)
                for p, g in zip(place, gain, strict=True):
                    k = int(p)
                    u = reach - (p - k)
                    if self.form == "motor":
                        h = np.sinc(0.8 * u) * np.exp(-((u / 9) ** 2))
                    else:
                        h = np.where(u >= 0, np.exp(-u / self.length) * np.cos(0.9 * u), 0)
                    inside = (k + reach >= 0) & (k + reach < n)
                    x[(k + reach)[inside]] += g * h[inside]
            self.cache[scene.stem] = x, len(place)
        return self.cache[scene.stem]

    def air(self, total, scene, rng):
        return self.size * np.sqrt(scene.noise) * self.shape(scene)[0]

    def nats(self, scene):
        x = self.size * self.shape(scene)[0][BEFORE : BEFORE + scene.n]
        busy = np.abs(x) ** 2 > 0.3
        share = np.mean(busy)
        if share == 0:
            return 0.0
        own = np.random.default_rng(self.seed + 1)
        w = np.abs(x + (own.standard_normal(len(x)) + 1j * own.standard_normal(len(x))) / np.sqrt(2)) ** 2
        wide, flat = 1 + np.mean(np.abs(x[busy]) ** 2), np.mean(w)
        mixed = np.logaddexp(np.log1p(-share) - w, np.log(share / wide) - w / wide)
        return float(np.sum(mixed + np.log(flat) + w / flat))

    def truth(self, scene, wanted):
        x, count = self.shape(scene)
        power = db(self.size**2 * scene.noise)
        energy = db(np.sum(np.abs(x) ** 2) / count)
        rate = count / len(x) * scene.rate_hz
        also = [power + energy, power - db(scene.noise)]
        return {"rate_hz": about(rate, False), "power_db": about(power, False, also)}, {}, {}


# ---------------------------------------------------------------- the floor
class Floor(Cause):
    """forms: up, down. size: the natural logarithm of the ratio, or less it."""

    family, stage, noisy = "noise_floor", "floor", True
    needs = {"states_noise": True}
    low, high, start = 2e-3, 4.0, 0.1

    @property
    def floor(self):
        return float(np.exp(self.size if self.form == "up" else -self.size))

    def nats(self, scene):
        return scene.n * (self.floor - 1 - np.log(self.floor))

    def truth(self, scene, wanted):
        return {"change_db": about(db((scene.white * self.floor + scene.noise - scene.white) / scene.noise))}, {}, {}


class SignalNoise(Cause):
    """forms: sparkle (a multiplicative noise that follows the received envelope)."""

    family, stage, noisy, random = "signal_dependent_noise", "air", True, True
    needs = {"envelope": True}
    low, high, start = 1e-2, 10.0, 0.3

    def ratio(self):
        return self.size**2

    def air(self, total, scene, rng):
        if rng is None:
            return 0.0
        own, n = self.generator(scene), len(total)
        w = (own.standard_normal(n) + 1j * own.standard_normal(n)) / np.sqrt(2)
        return total / scene.rms() * w * np.sqrt(self.ratio() * scene.noise)

    def nats(self, scene):
        e = np.abs(received(scene, scene.known)) ** 2
        v = 1 + self.ratio() * e / np.mean(e)
        return float(scene.n * np.log(np.mean(v)) - np.sum(np.log(v)))

    def truth(self, scene, wanted):
        return {"slope_db": about(db(self.ratio()))}, {}, {}


# ---------------------------------------------------------------- discrete events
class Loss(Cause):
    """forms: lost, repeated (samples written twice), end (in the first or last hundredth)."""

    family, stage = "sample_loss", "loss"
    low = high = start = 1.0

    def draw(self, rng, scene):
        inside = self.form != "end"
        where = rng.uniform(0.03, 0.97) if inside else rng.choice([rng.uniform(0.002, 0.0095), rng.uniform(0.9905, 0.998)])
        self.joint = int(where * scene.n)
        self.count = int(np.rint(10 ** rng.uniform(0, 2.6)))
        if self.form == "repeated":
            self.count = -int(np.rint(10 ** rng.uniform(0, 1.8)))
        if self.count % scene.wave.period == 0:
            self.count += 1

    def moved(self, index):
        return np.where(np.arange(len(index)) >= self.joint, index + self.count, index)

    def truth(self, scene, wanted):
        time_s, period = self.joint / scene.rate_hz, scene.wave.period
        also = [self.count % period, self.count % period - period] if scene.wave.repeat else []
        return ({"time_s": about(time_s, False), "samples": about(self.count, False, also)}, {}, {"time_s": [time_s, time_s]})


class Inversion(Cause):
    """forms: mirrored."""

    family, stage = "spectral_inversion", "inversion"
    needs = {"complex": True, "offset": False}
    low = high = start = 1.0


ORDER = [
    "tx_iq",
    "tx_leak",
    "tx_filter",
    "pa",
    "clock",
    "oscillator",
    "gain",
    "path",
    "tail",
    "second",
    "air",
    "floor",
    "inversion",
    "rx_iq",
    "dc",
    "clip",
    "steps",
    "loss",
    "foreign_channel",
    "foreign_gain",
]
FAMILIES = {
    c.family: c
    for c in (
        CarrierOffset,
        SampleClock,
        PhaseNoise,
        Imbalance,
        Constant,
        Leak,
        Amplifier,
        Clipping,
        Steps,
        GainStep,
        GainDrift,
        Hum,
        FrontEnd,
        ExtraPath,
        MissingPath,
        TapGain,
        TapDelay,
        TapDoppler,
        TapFading,
        Tail,
        SecondTransmitter,
        Tone,
        Narrowband,
        Pulses,
        Impulses,
        Floor,
        SignalNoise,
        Loss,
        Inversion,
    )
}


def in_order(causes):
    """In the chain's order; the joints from the last to the first, each on the axis of the recording."""
    return sorted(causes, key=lambda c: (ORDER.index(c.stage), -getattr(c, "joint", 0)))
