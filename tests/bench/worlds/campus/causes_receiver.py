# SPDX-License-Identifier: GPL-3.0-or-later
"""The receiver's mixer, noise and converter. Each cause: (link, rng, aim of λ) → Found."""

import math

import numpy as np

from . import channel, strength
from .causes_transmitter import place
from .scene import Redraw, db
from .strength import scaled
from .truth import Found, told


def direct_current(link, rng, aim):
    if not link.offset_hz and not link.network:
        raise Redraw("the transmitter's carrier would hide it")
    phase, rms = rng.uniform(-np.pi, np.pi), math.sqrt(link.wanted)
    decay = rng.uniform(0.15, 0.6) * link.duration if rng.random() < 0.35 and not link.network else None

    def make(s):
        course = lambda t: 1.0 if decay is None else np.exp(-np.maximum(t, 0) / decay)  # noqa: E731
        return dict(s=s, signal=lambda t: s * rms * np.exp(1j * phase) * course(t))

    spec, lam = scaled(link, "dc_offset", make, 0.02, 1e-6, 0.6, aim)
    level = 20 * math.log10(spec["s"])
    if decay is None:
        return Found(spec=spec, lam=lam, parameters=dict(level_dbc=told(level, True, link.while_on(level))))
    mean = level + db(decay / 2 / link.duration * -math.expm1(-2 * link.duration / decay))
    return Found(spec=spec, lam=lam, parameters=dict(level_dbc=told(level, also=[mean]), decay_s=told(decay, True, [decay / 2])))


def clipping_energy(link, level):
    return strength.over_noise(link, channel.clipped(link.noisy, level) - link.noisy)


def clipping(link, rng, aim):
    a = np.sort(np.concatenate([np.abs(link.noisy.real), np.abs(link.noisy.imag)]))
    lo, hi = 12 / len(a), 0.5  # shares of the clipped values
    for _ in range(8):
        share = math.sqrt(lo * hi)
        level = float(np.ceil(a[int((1 - share) * (len(a) - 1))] * 32768) / 32768)  # a file's integers hold it
        lam = clipping_energy(link, level)
        if abs(math.log(max(lam, 1e-9) / aim)) < 0.4:
            break
        lo, hi = (share, hi) if lam < aim else (lo, share)
    if lam < strength.LEAST:
        raise Redraw("clipping does not show")
    return Found(spec=dict(level=level), lam=lam, parameters=dict(level=told(level, True)))


def quantizer(link, rng, aim):
    sigma = math.sqrt(link.noise)
    step = min(max(math.sqrt(6 * link.noise * aim / link.n), 0.6 * sigma), 0.5 * math.sqrt(link.wanted))
    if rng.random() < 0.7:  # a whole number of bits
        step = 2.0 / 2 ** round(-math.log2(step / 2))
    if not 0.45 * sigma < step < math.sqrt(link.wanted):
        raise Redraw("step")
    spec = dict(step=step, rise=bool(rng.random() < 0.5))
    y = channel.received(link, {"quantization": spec}, link.unit)
    lam = float(np.sum(np.abs(y - link.noisy)[link.mask] ** 2) / link.noise)
    if lam < strength.LEAST:
        raise Redraw("step does not show")
    link.exact_file = (step / 2 * 32768) % 1 != 0  # a file's own steps would blur its lattice
    return Found(spec=spec, lam=lam, parameters=dict(step=told(step, True)))


# ---------------------------------------------------------------- noise
def envelope(link):
    return (np.abs(link.y) ** 2 / link.wanted)[link.mask]


def nearest(profile, models):
    """The least λ of noise of this profile over those of the models."""
    ratios = [profile / m for m in models]
    return min(float(np.sum(r - 1 - np.log(r))) for r in ratios)


def noise_floor(link, rng, aim, flat=False):
    """flat: an envelope under which noise that follows the signal is the same."""
    if not link.tells_noise:
        raise Redraw("the twin does not tell the noise")
    n, sign = int(link.mask.sum()), rng.choice([-1, 1, 1])
    change = 4.34 * math.sqrt(2 * aim / n) * sign
    for _ in range(6):
        change = float(np.clip(change, -8, 12))
        ratio = 10 ** (change / 10)
        lam = strength.louder(n, ratio)
        if abs(math.log(lam / aim)) < 0.2:
            break
        change *= math.sqrt(aim / lam)
    if lam < strength.LEAST:
        raise Redraw("the floor does not show")
    gap = math.inf
    if ratio > 1:
        e = envelope(link)
        gap = nearest(np.full(len(e), ratio), [1 + (ratio - 1) * c * e for c in (0.3, 0.5, 0.7, 0.85, 1, 1.15, 1.4, 2)])
    if gap > 0.5 if flat else gap < 15:
        raise Redraw("two kinds of noise")
    return Found(spec=dict(change_db=change), lam=lam, parameters=dict(change_db=told(change, True)))


def signal_noise(link, rng, aim):
    e, slope = envelope(link), rng.uniform(-8, 8)
    for _ in range(8):
        v = 1 + 10 ** (slope / 10) * e
        lam = strength.uneven(v)
        if abs(math.log(max(lam, 1e-9) / aim)) < 0.4 or not -15 < slope < 15:
            break
        slope = float(np.clip(slope + 4 * math.log10(aim / max(lam, 1e-9)), -15, 15))
    if lam < strength.LEAST or nearest(v, [np.full(len(v), q * np.mean(v)) for q in (0.8, 0.9, 1, 1.1)]) < 15:
        raise Redraw("the envelope is too even")
    p = dict(slope_db=told(slope, also=[] if link.repeat else [slope + db(link.wanted_on / link.wanted)]))
    return Found(spec=dict(slope_db=slope), lam=lam, parameters=p)


# ---------------------------------------------------------------- discrete events
def sample_loss(link, rng, aim):
    joint, period = place(link, rng), len(link.x)
    k = int(rng.choice([1, 1, 2, 3, 4, 5, 7, 8, 12, 16, 32, 50, 64, 100])) * int(rng.choice([-1, 1, 1]))
    if (link.repeat and k % period == 0) or joint + k < 50:
        raise Redraw("loss")
    spec = dict(joint=joint, samples=k)
    lam = strength.energy(link, {"sample_loss": spec})
    if lam < strength.LEAST:
        raise Redraw("loss does not show")
    when = joint / link.rate
    also = [k - period, k + period] if link.repeat else []
    p = dict(time_s=told(when), samples=told(k, also=also))
    return Found(spec=spec, lam=lam, parameters=p, where=dict(time_s=[when, when]))


def inversion(link, rng, aim):
    if link.traits.get("real") or link.offset_hz or any(t["doppler_hz"] for t in link.taps):
        raise Redraw("inversion")
    lam = strength.energy(link, {"spectral_inversion": {}})
    if lam < 200:
        raise Redraw("inversion does not show")
    return Found(spec={}, lam=lam)
