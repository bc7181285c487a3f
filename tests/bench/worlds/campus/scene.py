# SPDX-License-Identifier: GPL-3.0-or-later
"""A link as the twin believes it: waveform, paths, levels, noise, and what of it the twin does not claim."""

import math
from dataclasses import dataclass, field

import numpy as np

from . import channel, waveforms

RATES = (
    0.25e6, 0.5e6, 1e6, 1.92e6, 2e6, 2.4e6, 4e6, 5e6, 7.68e6, 10e6, 12.5e6, 15.36e6, 20e6, 25e6, 30.72e6, 40e6, 50e6, 56e6, 60e6
)  # fmt: skip
CARRIERS = (
    0.1e9, 0.137e9, 0.1625e9, 0.4339e9, 0.7e9, 0.868e9, 0.915e9, 0.978e9, 1.09e9, 1.575e9, 1.8426e9, 2.437e9, 2.6e9, 3.55e9,
    5.18e9, 5.8e9, 9.4e9, 24.1e9, 28e9
)  # fmt: skip
LENGTHS = (5_000, 100_000)  # samples of a recording
COUNTS, COUNT_SHARES = (1, 1, 2, 3, 4, 6, 9, 12), (0.2, 0.12, 0.14, 0.18, 0.14, 0.12, 0.06, 0.04)


class Redraw(Exception):
    """This draw makes no fair case; another is drawn."""


def db(power):
    return 10 * math.log10(max(power, 1e-300))


def factor(level_db):
    return 10 ** (level_db / 20)


def power(x):
    return float(np.mean(np.abs(x) ** 2))


@dataclass(kw_only=True)
class Link:
    x: np.ndarray
    traits: dict
    repeat: bool
    rate: float
    carrier: float
    n: int
    amplitude: float
    taps: list
    spread_s: float  # of the paths
    unknown: list
    offset_hz: float  # a carrier offset that the twin knows
    delay: float  # samples
    phase: float
    level_db: float
    snr_db: float
    seed: int
    tells_noise: bool
    network: bool = False
    end: str = ""  # where causes of either end are; empty: drawn
    second: object = None  # (samples, traits) of a waveform that is not on the air
    gone: int = -1  # tap that is missing in the world
    exact_file: bool = False  # integers of a file would blur a cause
    spare: int = 128  # samples computed behind the recording's last
    fine: object = field(default=None, repr=False)
    plain: object = field(default=None, repr=False)

    def __post_init__(self):
        self.latest_s = self.spread_s + 40 / self.rate
        self.mask = self.counted()
        self.settle()

    @property
    def duration(self):
        return self.n / self.rate

    @property
    def on_air(self):
        """First and last sample of what is sent."""
        return (0, self.n) if self.repeat else (self.delay, min(self.n, self.delay + len(self.x)))

    def counted(self):
        """Samples for which all that the model reaches is known."""
        mask = np.ones(self.n, bool)
        if "known" in self.traits:
            edges = np.flatnonzero(np.diff(np.concatenate([[0], ~self.traits["known"], [0]]).astype(int)))
            for a, b in edges.reshape(-1, 2):
                lo, hi = int(a + self.delay) - 24, int(b + self.delay + self.latest_s * self.rate) + 24
                mask[max(0, lo) : max(0, min(self.n, hi))] = False
            a, b = self.on_air
            if mask[int(a) : int(b)].mean() < 0.15:
                raise Redraw("too little known")
        return mask

    def settle(self):
        """Gain, noise and the twin's prediction, for the paths as they are."""
        self.fine = self.plain = None
        self.gain = 1.0 + 0j
        y = channel.received(self, {})
        if "gain" in self.unknown:
            self.gain = factor(self.level_db) / math.sqrt(power(y)) * np.exp(1j * self.phase)
            y = self.gain * y
        elif power(y) > 0.05:
            raise Redraw("too loud")
        elif self.phase:
            self.gain = np.exp(1j * self.phase)
            y = self.gain * y
        self.y, self.slope = y, channel.received(self, {}, slope=True)
        self.wanted = power(y)
        a, b = self.on_air
        self.wanted_on = power(y[int(a) : int(b)])
        self.set_noise(10 ** ((db(self.wanted_on) - self.snr_db) / 10))
        rng = np.random.default_rng(self.seed)
        shape = (2, self.n + self.spare + 2 * channel.MARGIN)
        self.unit = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / math.sqrt(2)
        self.noisy = channel.received(self, {}, self.unit)

    def set_noise(self, value):
        self.noise = float(value)

    def while_on(self, level_dbc):
        """The same level re the wanted power while the waveform is on the air."""
        return [] if self.repeat else [level_dbc + db(self.wanted / self.wanted_on)]

    def side(self, rng):
        return self.end or str(rng.choice(["tx", "rx"]))


def paths(rng, count, bw, rate, spread_s, doppler, duration):
    """Apart by more than the waveform resolves, weaker the later; some stand still while the first moves."""
    apart = max(1.6, 1.3 / bw) / rate
    taps = [dict(delay_s=0.0, gain_db=0.0, phase_rad=0.0, doppler_hz=doppler)]
    for _ in range(200):
        if len(taps) >= count:
            break
        d = round(rng.uniform(apart, max(spread_s, 2 * apart)), 13)
        if all(abs(d - t["delay_s"]) > apart for t in taps):
            gain = -rng.uniform(1, 10) - 16 * d / spread_s * rng.uniform(0.3, 1)
            phase = round(float(rng.uniform(-np.pi, np.pi)), 4)
            moving = doppler if rng.random() < 0.7 else 0.0
            taps.append(dict(delay_s=d, gain_db=round(float(gain), 3), phase_rad=phase, doppler_hz=moving))
    return sorted(taps, key=lambda t: t["delay_s"])


def link(
    rng, *, kinds=None, wave=None, rate=None, carrier=None, n=None, taps=None, unknown=None, tells_noise=None, snr_db=None,
    offset=0.3, doppler=0.2, whole=False, amplitude=None, second=None, network=False,
):  # fmt: skip
    """A drawn link; what is given stays. offset, doppler: the shares that have one; whole: a delay of whole samples."""
    rate, carrier = rate or float(rng.choice(RATES)), carrier or float(rng.choice(CARRIERS))
    n = n or int(10 ** rng.uniform(*np.log10(LENGTHS)))
    x, traits, repeat = wave or waveforms.wave(rng, n, kinds)
    n = max(n, int(2.6 * len(x))) if repeat else int(len(x) * rng.uniform(1.08, 1.4)) + 60
    duration, bw = n / rate, traits["bw"]
    spread_s = min(80 * max(1, 1 / bw / 3), len(x) / 3, 40 if "known" in traits else np.inf) / rate
    turning = round(float(rng.uniform(-4, 4) / duration), 3) if rng.random() < doppler else 0.0
    taps = taps or int(rng.choice(COUNTS, p=COUNT_SHARES))
    unknown = list(unknown or ["delay", "phase", "gain"])
    known_hz = 0.0
    if rng.random() < offset and "phase" in unknown:
        known_hz = round(float(rng.choice([-1, 1]) * rng.uniform(25, 120) / duration), 2)
    spare = n - len(x) - int(spread_s * rate / 2)
    if "delay" not in unknown:
        delay = 0.0
    elif repeat:
        delay = float(rng.uniform(0, len(x)))
        delay = float(round(delay)) if whole else delay
    else:
        delay = float(rng.uniform(5, spare - 20)) if spare > 40 else 10.3
    return Link(
        x=x,
        traits=traits,
        repeat=repeat,
        rate=rate,
        carrier=carrier,
        n=n,
        amplitude=float(amplitude or rng.choice([1.0, 1.0, 1.0, 0.8, 0.5])),
        taps=paths(rng, taps, bw, rate, spread_s, turning, duration),
        spread_s=spread_s,
        unknown=unknown,
        offset_hz=known_hz,
        delay=delay,
        phase=float(rng.uniform(-np.pi, np.pi)) if "phase" in unknown else 0.0,
        level_db=float(rng.uniform(-24, -13)),
        snr_db=float(snr_db or rng.uniform(3, 45)),
        seed=int(rng.integers(2**60)),
        tells_noise=bool(rng.random() < 0.68) if tells_noise is None else tells_noise,
        network=network,
        second=second,
    )
