# SPDX-License-Identifier: GPL-3.0-or-later
"""Physics that no family has. Each: (link, rng) → (spec, where, families that are tolerated beside it)."""

import math

import numpy as np

from .scene import factor

TURN = 2 * np.pi


def stretch(link, rng):
    """(first, last) sample of a piece of what is on the air."""
    a, b = link.on_air
    length = (b - a) * rng.uniform(0.06, 0.2)
    first = rng.uniform(a + 0.1 * (b - a), b - 0.1 * (b - a) - length)
    return int(first), int(first + length)


def wrong_payload(link, rng):
    """Another message for a stretch, of the same statistics."""
    i, j = stretch(link, rng)
    shift, real = int(rng.integers(97, 400)), link.traits.get("real")

    def wanted(y, t):
        other = np.roll(y[::-1], shift) if real else np.roll(np.conj(y), shift)
        return np.where((t >= i / link.rate) & (t < j / link.rate), other, y)

    return dict(wanted=wanted), dict(time_s=[i / link.rate, j / link.rate]), ["sample_loss", "spectral_inversion"]


def sweep(link, rng):
    """A radar's slow sweep through the band."""
    level, f0 = math.sqrt(link.wanted) * factor(rng.uniform(-16, -4)), -0.42 * link.rate
    rise, phase = 0.84 * link.rate / (link.duration * rng.uniform(0.6, 1.6)), rng.uniform(0, 6)
    beside = lambda t: level * np.exp(1j * (TURN * (f0 * t + 0.5 * rise * t**2) + phase))  # noqa: E731
    return dict(beside=beside), {}, ["narrowband_interference", "pulsed_interference", "tone_interference", "noise_floor"]


GAIN_LIKE = ["gain_step", "gain_drift", "power_supply_hum", "tap_fading"]


def contact(link, rng):
    """A loose connector: attenuation on and off at random moments."""
    times = np.sort(rng.uniform(*link.on_air, int(rng.integers(13, 30)))) / link.rate
    lost = factor(-rng.uniform(1.5, 6))
    return dict(wanted=lambda y, t: y * np.where(np.searchsorted(times, t) % 2, lost, 1)), {}, GAIN_LIKE


def clock_wow(link, rng):
    size, f, phase = rng.uniform(0.25, 0.8), rng.uniform(3, 9) / link.duration, rng.uniform(0, 6)
    wobble = lambda t: size * np.sin(TURN * f * t + phase)  # noqa: E731
    return dict(wobble=wobble), {}, ["sample_clock_offset", "phase_noise", "sample_loss"]


def blanked(link, rng):
    """The receiver is muted for a stretch, its noise too."""
    i, j = stretch(link, rng)
    here = (np.arange(link.n) >= i) & (np.arange(link.n) < j)
    return dict(held=lambda y: np.where(here, 0, y)), dict(time_s=[i / link.rate, j / link.rate]), ["gain_step", "sample_loss"]


def gain_pumping(link, rng):
    """Neighbours that are not heard press the gain; it comes back slowly."""
    hits, deep = np.sort(rng.uniform(*link.on_air, 9)) / link.rate, rng.uniform(0.3, 0.7)

    def wanted(y, t):
        down = sum(np.where(t > q, np.exp(-np.maximum(t - q, 0) / (link.duration * 0.03)), 0) for q in hits)
        return y * (1 - deep * np.minimum(down, 1))

    return dict(wanted=wanted), {}, [*GAIN_LIKE, "pulsed_interference"]


KINDS = (wrong_payload, sweep, contact, clock_wow, blanked, gain_pumping)
