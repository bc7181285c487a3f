# SPDX-License-Identifier: GPL-3.0-or-later
"""Physics that no family of the contract describes. `tolerated`: families that a reasonable reader would accept beside it."""

import numpy as np

from .causes import Cause, _clear
from .chain import BEFORE


class Foreign(Cause):
    tolerated = ()
    timed = False  # it has a place in time

    def draw(self, rng, scene):
        width = rng.uniform(0.05, 0.25) * scene.n
        self.first = rng.uniform(0.1, 0.9) * scene.n - width / 2
        self.first = float(np.clip(self.first, 0.02 * scene.n, 0.96 * scene.n - width))
        self.last = self.first + width
        self.more(rng, scene)

    def more(self, rng, scene):
        pass

    def inside(self, scene):
        """0 before the stretch, 0 … 1 through it, 1 after it."""
        return np.clip((scene.grid - self.first) / (self.last - self.first), 0, 1)

    def truth(self, scene, wanted):
        where = {"time_s": [self.first / scene.rate_hz, self.last / scene.rate_hz]} if self.timed else {}
        return {}, {}, where


class Glitch(Foreign):
    """The oscillator runs off for a stretch and comes back to another phase."""

    family, stage, tolerated, timed = "outside:lo_glitch", "foreign_gain", ("phase_noise",), True
    low, high, start = 0.02, 60.0, 2.0

    def factor(self, t, scene):
        return np.exp(1j * self.size * self.inside(scene))


class Hop(Foreign):
    """The synthesizer settles on another frequency from one instant on."""

    family, stage, tolerated = "outside:lo_hop", "foreign_gain", ("phase_noise", "carrier_frequency_offset")
    low, high, start = 0.02, 300.0, 2.0

    def factor(self, t, scene):
        return np.exp(1j * self.size * np.maximum(scene.grid - self.first, 0) / scene.n * 2 * np.pi)


class WarmUp(Foreign):
    """A crystal that warms up: its frequency relaxes, neither still nor linear."""

    family, stage, tolerated = "outside:warm_up", "foreign_gain", ("phase_noise", "carrier_frequency_offset")
    low, high, start = 0.2, 600.0, 5.0

    def more(self, rng, scene):
        self.ratio = rng.uniform(0.06, 0.2)

    def factor(self, t, scene):
        x = np.maximum(scene.grid / scene.n, -0.01)
        return np.exp(1j * self.size * self.ratio * (1 - np.exp(-x / self.ratio)) * 2 * np.pi)


class Pumping(Foreign):
    """A gain control that ducks fast and recovers slowly, at irregular moments."""

    family, stage = "outside:agc_pumping", "foreign_gain"
    tolerated = ("gain_step", "gain_drift", "power_supply_hum", "tap_fading")
    low, high, start = 0.02, 14.0, 1.0

    def more(self, rng, scene):
        self.hits = np.sort(rng.uniform(0, scene.n, 6 + rng.poisson(10)))
        self.deep = rng.uniform(0.3, 1.0, len(self.hits))
        self.back = rng.uniform(0.01, 0.05) * scene.n

    def factor(self, t, scene):
        down = np.zeros(len(scene.grid))
        for hit, deep in zip(self.hits, self.deep, strict=True):
            u = (scene.grid - hit) / self.back
            down = np.maximum(down, np.where(u >= 0, deep * np.exp(-np.maximum(u, 0)), 0))
        return 10 ** (-self.size * down / 20)


class Blades(Foreign):
    """A rotor between the antennas: a short flash of amplitude and phase at each blade."""

    family, stage, tolerated = "outside:rotor", "foreign_gain", ("tap_fading", "phase_noise", "power_supply_hum")
    low, high, start = 0.01, 0.9, 0.2

    def more(self, rng, scene):
        self.period = scene.n / rng.uniform(6, 40)
        self.turn = rng.uniform(-np.pi, np.pi)
        self.blade = rng.uniform(0.6, 1.0, 3)

    def factor(self, t, scene):
        u = scene.grid / self.period
        k = np.floor(u).astype(int)
        flash = np.exp(-((((u - k) - 0.5) / 0.06) ** 2)) * self.blade[k % 3]
        return 1 - self.size * np.exp(1j * self.turn) * flash


class Blanking(Foreign):
    """A receiver muted while a transmitter beside it is on the air, at irregular moments."""

    family, stage = "outside:blanking", "foreign_gain"
    tolerated = ("gain_step", "sample_loss", "tap_fading", "pulsed_interference")
    low, high, start = 0.02, 1.0, 0.3

    def more(self, rng, scene):
        self.holes = rng.uniform(0, scene.n, 5 + rng.poisson(8))
        self.width = rng.uniform(0.002, 0.012) * scene.n * rng.uniform(0.5, 1.5, len(self.holes))

    def factor(self, t, scene):
        out = np.ones(len(scene.grid))
        for a, w in zip(self.holes, self.width, strict=True):
            out[(scene.grid >= a) & (scene.grid < a + w)] = 1 - self.size
        return out


class InAir(Foreign):
    stage, levels, additive = "air", ("environment",), True
    low, high, start = 1e-3, 4.0, 0.1

    def air(self, total, scene, rng):
        return self.size * scene.air_rms() * self.wave(scene)


class CoChannel(InAir):
    """Another service on the same channel: its data are random, its band as wide."""

    family, tolerated = "outside:co_channel", ("noise_floor", "narrowband_interference")

    def more(self, rng, scene):
        self.symbol = rng.uniform(2.2, 4.5)
        self.shift = rng.uniform(-0.08, 0.08)

    def wave(self, scene):
        own, n = self.generator(scene), scene.grid
        symbols = own.choice([1, 1j, -1, -1j], int(len(n) / self.symbol) + 2)
        x = symbols[(np.arange(len(n)) / self.symbol).astype(int)] * np.exp(2j * np.pi * self.shift * n)
        return x


class Keyed(InAir):
    """A telegraphy carrier: dots and dashes."""

    family, tolerated = "outside:keyed_carrier", ("tone_interference", "narrowband_interference", "pulsed_interference")

    def more(self, rng, scene):
        self.frequency = _clear(rng, scene)
        self.dot = rng.uniform(0.006, 0.02) * scene.n

    def wave(self, scene):
        own, n = self.generator(scene), scene.grid
        keys = np.concatenate([[1] * int(own.choice([1, 3])) + [0] * int(own.choice([1, 1, 3])) for _ in range(200)])
        on = keys[np.minimum(((n - n[0]) / self.dot).astype(int), len(keys) - 1)]
        return on * np.exp(2j * np.pi * self.frequency * n)


class Sweeper(InAir):
    """A sounder's chirp that crosses the band once."""

    family, tolerated = "outside:sweeper", ("tone_interference", "narrowband_interference", "pulsed_interference")

    def more(self, rng, scene):
        self.slope = rng.choice([-1, 1]) * rng.uniform(0.4, 0.9) / scene.n

    def wave(self, scene):
        u = scene.grid - scene.n / 2
        return np.exp(1j * np.pi * self.slope * u**2)


class Hopper(InAir):
    """Frequency hopping with random channels."""

    family, tolerated = "outside:hopper", ("tone_interference", "narrowband_interference", "pulsed_interference")

    def more(self, rng, scene):
        self.dwell = rng.uniform(0.01, 0.06) * scene.n
        self.rate = rng.uniform(0.005, 0.02)

    def wave(self, scene):
        own, n = self.generator(scene), scene.grid
        k = ((n - n[0]) / self.dwell).astype(int)
        centre = own.uniform(-0.42, 0.42, k[-1] + 1)[k]
        data = own.choice([-1, 1], int(len(n) * self.rate) + 2)[(np.arange(len(n)) * self.rate).astype(int)]
        busy = own.uniform(size=k[-1] + 1)[k] < 0.7
        return busy * np.exp(2j * np.pi * np.cumsum(centre + 0.3 * self.rate * data))


class NoiseBurst(InAir):
    """One stretch in which the noise is higher."""

    family, tolerated, timed = "outside:noise_burst", ("pulsed_interference", "impulsive_noise", "noise_floor"), True
    noisy = True
    low, high, start = 1e-2, 10.0, 0.5

    def wave(self, scene):
        own, n = self.generator(scene), scene.grid
        x = (own.standard_normal(len(n)) + 1j * own.standard_normal(len(n))) / np.sqrt(2)
        return x * ((n >= self.first) & (n < self.last))

    def nats(self, scene):
        ratio, share = (self.size * scene.air_rms()) ** 2 / scene.noise, (self.last - self.first) / scene.n
        return scene.n * (np.log1p(share * ratio) - share * np.log1p(ratio))


class Symbols(Foreign):
    """A stretch of the waveform was sent with other symbols."""

    family, stage, levels, tolerated = "outside:symbols", "tx_iq", ("tx",), ()
    low, high, start = 0.05, 1.0, 1.0

    def more(self, rng, scene):
        self.turn = rng.choice([np.pi, np.pi / 2, -np.pi / 2])
        self.place = rng.uniform(0.2, 0.7), rng.uniform(0.03, 0.12)

    def imbalanced(self, fine):
        out, n = fine.copy(), len(fine)
        a, b = int(self.place[0] * n), int((self.place[0] + self.place[1]) * n)
        ramp = np.clip(np.minimum(np.arange(b - a), np.arange(b - a)[::-1]) / 24.0, 0, 1)
        out[a:b] *= 1 + (np.exp(1j * self.turn) - 1) * self.size * ramp
        return out


class ShiftedStretch(Foreign):
    """A stretch written with samples from elsewhere, after which the stream goes on as if nothing were."""

    family, stage, tolerated, timed = "outside:shifted_stretch", "loss", ("sample_loss",), True
    low = high = start = 1.0

    def more(self, rng, scene):
        self.count = int(rng.choice([-1, 1]) * rng.integers(1, 120))
        self.first, self.last = np.rint(self.first), np.rint(self.last)

    def moved(self, index):
        k = np.arange(len(index))
        return np.where((k >= self.first) & (k < self.last), index + self.count, index)


class RepeatedStretch(ShiftedStretch):
    """A buffer written again in place of the one that should follow."""

    family = "outside:repeated_stretch"

    def moved(self, index):
        k = np.arange(len(index))
        length = int(self.last - self.first)
        back = np.where((k >= self.first) & (k < self.last), index - length, index)
        return np.where(back >= -BEFORE, back, index)


class VaryingFilter(Foreign):
    """A front end whose passband moves as it warms."""

    family, stage = "outside:varying_filter", "foreign_channel"
    tolerated = ("tap_fading", "front_end_filter", "extra_path", "tap_doppler", "diffuse_tail")
    low, high, start = 1e-3, 0.6, 0.05

    def more(self, rng, scene):
        self.lag = int(rng.integers(1, 4))
        self.cycles = rng.uniform(0.6, 3.0)
        self.turn = rng.uniform(-np.pi, np.pi, 2)

    def channel(self, total, sheet, scene):
        x = scene.grid / scene.n
        swing = np.cos(2 * np.pi * self.cycles * x + self.turn[0])
        return total + self.size * swing * np.exp(1j * self.turn[1]) * np.roll(total, self.lag)


class ClockWander(Foreign):
    """A sampling clock that swings to and fro (a bus clock that is steered)."""

    family, stage, tolerated = "outside:clock_wander", "foreign_channel", ("sample_clock_offset", "tap_delay_error")
    low, high, start = 1e-3, 1.5, 0.1

    def more(self, rng, scene):
        self.cycles = rng.uniform(1.2, 6.0)
        self.turn = rng.uniform(-np.pi, np.pi)

    def channel(self, total, sheet, scene):
        t, out = scene.grid / scene.rate_hz, np.zeros(len(total), complex)
        late = self.size * np.sin(2 * np.pi * self.cycles * scene.grid / scene.n + self.turn)
        for p in scene.taps:
            s = sheet.at(scene.grid - p["delay_s"] * scene.rate_hz - scene.delay - late)
            out += 10 ** (p["gain_db"] / 20) * s * np.exp(1j * (p["phase_rad"] + 2 * np.pi * p["doppler_hz"] * t))
        return out


class ColouredImage(Foreign):
    """An image whose strength depends on frequency: the branches' filters differ."""

    family, stage, tolerated = "outside:coloured_image", "rx_iq", ("iq_imbalance",)
    needs = {"complex": True}
    low, high, start = 1e-3, 0.5, 0.05

    def more(self, rng, scene):
        self.lag = int(rng.integers(4, 12))
        self.turn = rng.uniform(-np.pi, np.pi)

    def imbalanced(self, x):
        y = x.conj()
        return x + self.size * np.exp(1j * self.turn) * (y - 0.9 * np.roll(y, self.lag))


class SecondOrder(Foreign):
    """A mixer's second-order product: the envelope's square, at baseband."""

    family, stage, tolerated = "outside:second_order", "rx_iq", ("pa_nonlinearity", "dc_offset")
    needs = {"envelope": True}
    low, high, start = 1e-3, 2.0, 0.1

    def more(self, rng, scene):
        self.turn, self.level_rms = rng.uniform(-np.pi, np.pi), scene.rms()

    def imbalanced(self, x):
        return x + self.size * np.exp(1j * self.turn) * np.abs(x) ** 2 / self.level_rms


KINDS = {
    c.__name__: c
    for c in (
        Glitch,
        Hop,
        WarmUp,
        Pumping,
        Blades,
        Blanking,
        CoChannel,
        Keyed,
        Sweeper,
        Hopper,
        NoiseBurst,
        Symbols,
        ShiftedStretch,
        RepeatedStretch,
        VaryingFilter,
        ClockWander,
        ColouredImage,
        SecondOrder,
    )
}
