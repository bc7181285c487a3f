# SPDX-License-Identifier: GPL-3.0-or-later
"""What a family is, what it may know of a recording, and what several of them draw."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Context:
    """What an impairment may know of the recording that it acts on."""

    rate: float
    first: int
    count: int
    carrier_hz: float
    waveform: object
    peak: float  # largest transmitted amplitude
    taps: tuple  # of the twin
    offset_known_hz: float
    snr_db: float
    bulk: float  # samples
    gain: complex
    power: float = 0.0  # mean wanted power in the recording, once known
    rms_peak: float = 0.0  # largest |I| or |Q| wanted in the recording
    noise: float = 0.0  # noise power per complex sample

    @property
    def duration(self):
        return self.count / self.rate


@dataclass(frozen=True, kw_only=True)
class Family:
    """One family; `act` maps (samples, s, d, c) → samples, of stages link and twin (taps, s, d, c) → taps."""

    name: str
    level: str  # tx, rx, either, link, environment
    stage: str  # tx, link, twin, fade, second, clock, air, rx, late
    draw: Callable
    act: Callable
    truth: Callable  # (s, d, c) → parameters, values, where
    fits: Callable = lambda c: True
    start: float = 0.01  # a strength to begin the search at
    same_as: tuple = ()
    stochastic: bool = False  # its realisation cannot be predicted: λ is a divergence, in nats
    fixed: bool = False  # no strength to tune


def value(v, z=True, also=(), unsigned=False):
    return {"value": float(v), "z": z, "also": [float(a) for a in also], "unsigned": unsigned}


def level_db(x):
    return float(20 * np.log10(max(abs(x), 1e-30)))


def grid_hz(f, rate):
    """The frequency that a 32-bit oscillator really makes."""
    return round(f / rate * 2**32) / 2**32 * rate


def draw_nothing(rng, c):
    return {}


def draw_phase(rng, c):
    return {"phase": float(rng.uniform(-np.pi, np.pi))}


def draw_sign(rng, c):
    return {"sign": int(rng.choice([-1, 1]))}


def draw_seed(rng, c):
    return {"seed": int(rng.integers(1, 2**31 - 9))}


def shaped(c):
    return not c.waveform.constant_envelope


def repeats(c):
    return c.waveform.repeat


def static(c):
    return c.offset_known_hz == 0 and all(t["doppler_hz"] == 0 for t in c.taps)


def turns(c):
    """Whole turns of the known carrier offset: they tell transmitter's leakage from receiver's DC."""
    return abs(c.offset_known_hz) * c.duration
