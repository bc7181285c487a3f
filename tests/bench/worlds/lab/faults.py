# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults of equipment that no family of the contract holds. Each: (rng, scene) → (cause, tolerated families) or None."""

import numpy as np

from ..rig import numeric
from ..rig.causes import Outside
from ..rig.scene import MARGIN
from ..rig.world import log, pick, sign


def made(form, slot, law, knob, lo, hi, tolerated, level="rx", place=()):
    name = {"rx": "rx1", "tx": "tx1"}[level]
    cause = Outside(
        family=f"outside:{form}",
        slot=slot,
        level=level,
        name=name,
        law=law,
        knob=knob,
        lo=lo,
        hi=hi,
        form=form,
        place=list(place),
    )
    return cause, tolerated


def stretch(rng, scene, least=0.08, most=0.4):
    a = rng.uniform(0.05, 0.9 - most) * scene.duration
    return a, a + rng.uniform(least, most) * scene.duration


def phase_ramp(rng, scene):
    """The synthesiser loses lock over a stretch: its phase runs away and comes back whole."""
    a, b = stretch(rng, scene)

    def law(y, c, knob):
        return y * np.exp(1j * knob * np.clip((c.time - a) / (b - a), 0, 1))

    return made("lo_glitch", "rx_lo", law, 0.3, 1e-3, 40.0, ["phase_noise"], place=(a, b))


def frequency_hop(rng, scene):
    """A retune in mid-recording: another frequency from there on."""
    a = rng.uniform(0.2, 0.8) * scene.duration

    def law(y, c, knob):
        return y * np.exp(1j * knob * np.maximum(c.time - a, 0) / c.duration)

    return made("frequency_hop", "rx_lo", law, 1.0, 1e-3, 3000.0, ["phase_noise", "carrier_frequency_offset"], place=(a, a))


def clock_wander(rng, scene):
    """The sample clock is slowly modulated."""
    f, turn = log(rng, 1.5, 8) / scene.duration, rng.uniform(0, 6.28)

    def law(y, c, knob):
        n = np.arange(len(y))
        return numeric.at(y, n + knob * np.sin(2 * np.pi * f * c.time + turn))

    return made("clock_wander", "rx_clock", law, 0.02, 1e-4, 2.0, ["sample_clock_offset"])


def gain_pumping(rng, scene):
    """An AGC attacks at irregular times and recovers exponentially."""
    times = np.sort(rng.uniform(0, scene.duration, int(rng.integers(3, 9))))
    tau = scene.duration * log(rng, 0.02, 0.15)

    def law(y, c, knob):
        g = np.zeros(len(y))
        for t in times:
            g += np.where(c.time >= t, np.exp(-np.maximum(c.time - t, 0) / tau), 0)
        return y * np.exp(-knob * g)

    return made("gain_pumping", "rx_gain", law, 0.02, 1e-4, 1.0, ["gain_step", "gain_drift", "power_supply_hum"])


def swapped_buffers(rng, scene):
    """Two buffers of the receiver change places."""
    if not scene.wave("tx1").repeat:
        return None
    size = int(log(rng, 0.03, 0.15) * scene.count)
    at = int(rng.uniform(0.05, 0.95) * (scene.count - 2 * size))
    if size % len(scene.wave("tx1").samples) < 5:
        return None

    def law(y, c, knob):
        i = MARGIN + at
        return np.concatenate([y[:i], y[i + size : i + 2 * size], y[i : i + size], y[i + 2 * size :]])

    rate = scene.rate
    got = made("swapped_buffers", "adc_time", law, 1.0, 1.0, 1.0, ["sample_loss"], place=(at / rate, (at + 2 * size) / rate))
    got[0].fixed = True
    return got


def shifted_stretch(rng, scene):
    """A stretch of the waveform is sent some samples late; what follows is on time."""
    a, b = stretch(rng, scene)
    late = int(log(rng, 2, 60))

    def law(y, c, knob):
        inside = (c.time >= a) & (c.time < b)
        return np.where(inside, np.roll(y, late), y)

    got = made("shifted_stretch", "tx_gain", law, 1.0, 1.0, 1.0, ["sample_loss"], "tx", (a, b))
    got[0].fixed = True
    return got


def converter_glitch(rng, scene):
    """The DAC's major carry: an impulse at every change of sign of I or Q, of the change's direction."""
    fall = rng.uniform(0.4, 1.5)
    if not scene.wave("tx1").limited:
        return None

    def law(x, c, knob):
        out = np.zeros(len(x), complex)
        for part, unit in ((x.real, 1.0), (x.imag, 1j)):
            out += unit * np.diff(np.sign(np.where(np.abs(part) < 1e-9, 1e-9, part)), prepend=part[:1] * 0 + 1) / 2
        ring = np.exp(-np.arange(12) / fall)
        return x + knob * np.convolve(out, ring)[: len(x)]

    return made(
        "converter_glitch", "tx_iq", law, 0.02, 1e-4, 0.5, ["pa_nonlinearity", "impulsive_noise", "front_end_filter"], "tx"
    )


def sliding_filter(rng, scene):
    """A filter whose corner moves through the recording, warming."""
    lo, hi = scene.wave("tx1").band(10)
    half = max(-lo, hi) * scene.rate

    def law(y, c, knob):
        low = numeric.filtered(y, lambda f: 1 / (1 + 1j * f / half * knob), c.rate)
        share = np.clip(c.time / c.duration, 0, 1)
        return y * (1 - share) + low * share

    return made("sliding_filter", "rx_filter", law, 0.2, 1e-3, 2.5, ["front_end_filter", "diffuse_tail", "extra_path"])


def integral_nonlinearity(rng, scene):
    """The ADC's transfer runs in saw-teeth about the line, per I and Q."""
    teeth = rng.uniform(6, 24)

    def law(y, c, knob):
        size = np.sqrt(c.wanted)
        bend = lambda v: v + knob * size * (2 * np.abs(2 * ((v / size * teeth / 8) % 1) - 1) - 1)  # noqa: E731
        return bend(y.real) + 1j * bend(y.imag)

    return made("integral_nonlinearity", "adc_clip", law, 0.02, 1e-4, 0.3, ["quantization", "adc_clipping", "pa_nonlinearity"])


def settling(rng, scene):
    """A synthesiser settles: its phase error dies out exponentially while ringing."""
    tau, f = scene.duration * log(rng, 0.03, 0.2), rng.uniform(0.2, 1.0)

    def law(y, c, knob):
        t = np.maximum(c.time, 0)
        return y * np.exp(1j * knob * np.exp(-t / tau) * np.cos(2 * np.pi * f * t / tau))

    return made("settling", "tx_lo", law, 0.2, 1e-3, 3.0, ["phase_noise", "carrier_frequency_offset"], "tx")


def interleaving(rng, scene):
    """Two cores of an ADC differ in gain: an image half the sample rate away."""

    def law(y, c, knob):
        return y * (1 + knob * np.where(np.arange(len(y)) % 2, -1.0, 1.0))

    return made("interleaving", "adc_clip", law, 0.01, 1e-4, 0.3, ["power_supply_hum", "iq_imbalance"])


def skew(rng, scene):
    """The Q arm is sampled late: an image that grows with frequency."""
    if scene.wave("tx1").real or not scene.wave("tx1").limited:
        return None
    s = sign(rng)

    def law(y, c, knob):
        return y.real + 1j * numeric.delayed(y.imag.astype(complex), s * knob).real

    return made("skew", "rx_iq", law, 0.02, 1e-4, 0.5, ["iq_imbalance", "front_end_filter", "extra_path"])


def phase_hits(rng, scene):
    """The reference jumps between two phases at irregular times."""
    times = np.sort(rng.uniform(0.05, 0.95, int(rng.integers(2, 7)))) * scene.duration

    def law(y, c, knob):
        state = np.searchsorted(times, c.time) % 2
        return y * np.exp(1j * knob * state)

    return made("phase_hits", pick(rng, ["tx_lo"]), law, 0.2, 1e-3, 2.5, ["phase_noise"], "tx")


OUTSIDE = (
    phase_ramp,
    frequency_hop,
    clock_wander,
    gain_pumping,
    swapped_buffers,
    shifted_stretch,
    converter_glitch,
    sliding_filter,
    integral_nonlinearity,
    settling,
    interleaving,
    skew,
    phase_hits,
)
