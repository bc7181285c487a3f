# SPDX-License-Identifier: GPL-3.0-or-later
"""What a street's air does that no family of the contract holds. Each: (rng, scene) → (cause, tolerated families) or None."""

from dataclasses import replace

import numpy as np

from ..rig import numeric, waves
from ..rig import world as w
from ..rig.causes import Outside
from ..rig.scene import MARGIN, Tap
from ..rig.world import log, sign

AIR = ("environment", "environment")
LINK = ("link", "tx1>rx1")


def made(form, slot, law, knob, lo, hi, tolerated, owner=("rx", "rx1"), place=()):
    cause = Outside(
        family=f"outside:{form}",
        slot=slot,
        level=owner[0],
        name=owner[1],
        law=law,
        knob=knob,
        lo=lo,
        hi=hi,
        form=form,
        place=list(place),
    )
    cause.seed = 1
    return cause, tolerated


def co_channel(rng, scene):
    """Another network's data in the same band, of no known code."""
    seed, chip = int(rng.integers(2**31)), rng.uniform(2, 4)

    def law(y, c, knob):
        r = np.random.default_rng([seed, c.recording.index])
        x = waves.shaped(waves.constellation(r, 4, int(len(y) / chip)), len(y), 0.22)
        return y + knob * np.sqrt(c.wanted) * x

    tolerated = ["narrowband_interference", "second_transmitter", "noise_floor", "signal_dependent_noise"]
    return made("co_channel", "air", law, 0.1, 1e-3, 1.5, tolerated, AIR)


def shadowed_path(rng, scene):
    """A lorry stands before one path for a while: it fades out and in again."""
    found = w.some_tap(rng, scene, 2)
    if not found:
        return None
    a = rng.uniform(0.1, 0.5) * scene.duration
    b = a + rng.uniform(0.15, 0.4) * scene.duration
    soft = 0.05 * scene.duration

    def law(taps, c, knob):
        dip = (np.tanh((c.time - a) / soft) - np.tanh((c.time - b) / soft)) / 2
        tap = taps[found[1]]
        return taps[: found[1]] + [replace(tap, course=tap.gain * (1 - knob * dip))] + taps[found[1] + 1 :]

    tolerated = ["tap_fading", "missing_path", "tap_gain_error", "gain_step", "gain_drift"]
    return made("shadowed_path", "paths", law, 0.2, 1e-3, 1.0, tolerated, LINK, (a, b))


def passing_car(rng, scene):
    """A reflection whose Doppler turns from plus to minus as the car passes."""
    lo, longest = w.World.room(None, scene, ("tx1", "rx1"))
    delay = scene.links[("tx1", "rx1")][0]["delay_s"] + log(rng, lo, longest)
    swing, mid = log(rng, 8, 60) / scene.duration, rng.uniform(0.3, 0.7) * scene.duration
    width = rng.uniform(0.08, 0.3) * scene.duration

    def law(taps, c, knob):
        phase = -2 * np.pi * swing * np.sqrt((c.time - mid) ** 2 + width**2)
        return taps + [Tap(delay_s=delay, gain=knob, course=knob * np.exp(1j * phase))]

    return made("passing_car", "paths", law, 0.05, 1e-3, 0.8, ["extra_path", "tap_fading", "tap_doppler", "diffuse_tail"], LINK)


def born_path(rng, scene):
    """An echo that is there for a part of the recording alone."""
    lo, longest = w.World.room(None, scene, ("tx1", "rx1"))
    delay = scene.links[("tx1", "rx1")][0]["delay_s"] + log(rng, lo, longest)
    a = rng.uniform(0.1, 0.6) * scene.duration
    b = a + rng.uniform(0.1, 0.3) * scene.duration
    turn = rng.uniform(0, 6.28)

    def law(taps, c, knob):
        on = (c.time >= a) & (c.time < b)
        return taps + [Tap(delay_s=delay, gain=knob, course=knob * np.exp(1j * turn) * on)]

    return made("born_path", "paths", law, 0.05, 1e-3, 0.8, ["extra_path", "tap_fading"], LINK, (a, b))


def hopper(rng, scene):
    """A frequency hopper: another channel every dwell."""
    seed, dwells = int(rng.integers(2**31)), int(rng.integers(12, 60))
    used = rng.uniform(0.4, 1.0)

    def law(y, c, knob):
        r = np.random.default_rng([seed, c.recording.index])
        dwell = c.count // dwells
        out = np.zeros(len(y), complex)
        for at in range(0, len(y), dwell):
            n = min(int(dwell * used), len(y) - at)
            bits = np.repeat(r.choice([-1.0, 1.0], n // 40 + 1), 40)[:n]
            f = r.uniform(-0.4, 0.4)
            out[at : at + n] = np.exp(2j * np.pi * np.cumsum(f + 0.005 * bits))
        return y + knob * np.sqrt(c.wanted) * out

    tolerated = ["tone_interference", "narrowband_interference", "pulsed_interference", "impulsive_noise", "noise_floor"]
    return made("hopper", "air", law, 0.1, 1e-3, 1.5, tolerated, AIR)


def one_burst(rng, scene):
    """One burst of noise, once."""
    a = rng.uniform(0.1, 0.7) * scene.duration
    b = a + rng.uniform(0.03, 0.2) * scene.duration
    seed = int(rng.integers(2**31))

    def law(y, c, knob):
        r = np.random.default_rng([seed, c.recording.index])
        n = r.standard_normal(len(y)) + 1j * r.standard_normal(len(y))
        return y + knob * np.sqrt(c.wanted / 2) * n * ((c.time >= a) & (c.time < b))

    return made("one_burst", "air", law, 0.2, 1e-3, 2.0, ["pulsed_interference", "impulsive_noise", "noise_floor"], AIR, (a, b))


def desensitised(rng, scene):
    """A blocker outside the band comes on at irregular times: the first stage loses gain while it is on."""
    edges = np.sort(rng.uniform(0.03, 0.97, 2 * int(rng.integers(2, 6)))) * scene.duration

    def law(y, c, knob):
        on = np.searchsorted(edges, c.time) % 2
        return y * 10 ** (-knob * on / 20)

    return made("desensitised", "rx_front", law, 0.2, 1e-3, 8.0, ["gain_step", "power_supply_hum", "gain_drift"])


def swept_carrier(rng, scene):
    """A swept jammer."""
    sweeps, share = rng.uniform(0.7, 8), rng.uniform(0.3, 0.8)

    def law(y, c, knob):
        saw = (np.arange(len(y)) / c.count * sweeps) % 1 - 0.5
        return y + knob * np.sqrt(c.wanted) * np.exp(2j * np.pi * np.cumsum(share * saw))

    tolerated = ["tone_interference", "narrowband_interference", "pulsed_interference", "noise_floor"]
    return made("swept_carrier", "air", law, 0.1, 1e-3, 1.5, tolerated, AIR)


def wandering_clock(rng, scene):
    """A handset follows its base station: its clock hunts about the right rate."""
    f, turn, bend = log(rng, 1.2, 5) / scene.duration, rng.uniform(0, 6.28), rng.uniform(0.1, 0.5)

    def law(x, c, knob):
        u = 2 * np.pi * f * c.time + turn
        return numeric.at(x, np.arange(len(x)) + knob * (np.sin(u) + bend * np.sin(2.7 * u)))

    return made("wandering_clock", "tx_clock", law, 0.02, 1e-4, 2.0, ["sample_clock_offset"], ("tx", "tx1"))


def cycle_slips(rng, scene):
    """The carrier loop slips: whole turns, each within a short time."""
    times = np.sort(rng.uniform(0.05, 0.95, int(rng.integers(1, 5)))) * scene.duration
    signs = rng.choice([-1.0, 1.0], len(times))

    def law(y, c, knob):
        width = knob * c.duration * 0.01
        phase = sum(s * 2 * np.pi * np.clip((c.time - t) / width, 0, 1) for t, s in zip(times, signs, strict=True))
        return y * np.exp(1j * phase)

    return made("cycle_slips", "rx_lo", law, 1.0, 0.05, 6.0, ["phase_noise"])


def migrating_path(rng, scene):
    """An echo whose delay runs through several samples: a train, a satellite's multipath."""
    lo, longest = w.World.room(None, scene, ("tx1", "rx1"))
    delay = scene.links[("tx1", "rx1")][0]["delay_s"] + log(rng, 2 * lo, max(longest, 3 * lo))
    travel = sign(rng) * rng.uniform(1.5, 6.0) / (lo * scene.rate)

    def law(x, c, knob):
        shift = delay * c.rate + travel * np.clip(c.time / c.duration, 0, 1) * lo * c.rate
        return x + knob * numeric.at(x, np.arange(len(x)) - shift)

    tolerated = ["extra_path", "diffuse_tail", "tap_fading", "sample_clock_offset", "second_transmitter"]
    return made("migrating_path", "tx_lo", law, 0.05, 1e-3, 0.7, tolerated, ("tx", "tx1"))


def late_symbols(rng, scene):
    """Timing advance is applied in the midst of the transmission and taken back."""
    a = rng.uniform(0.1, 0.6) * scene.duration
    b = a + rng.uniform(0.08, 0.3) * scene.duration
    early = int(log(rng, 2, 40))

    def law(x, c, knob):
        inside = (c.time >= a) & (c.time < b)
        return np.where(inside, np.roll(x, -early), x)

    got = made("late_symbols", "tx_gain", law, 1.0, 1.0, 1.0, ["sample_loss"], ("tx", "tx1"), (a, b))
    got[0].fixed = True
    return got


def overwritten(rng, scene):
    """A ring buffer overtakes itself: a stretch of the recording is an older one."""
    size = int(rng.uniform(0.02, 0.12) * scene.count)
    at = int(rng.uniform(0.3, 0.8) * scene.count)
    back = int(rng.uniform(0.1, 0.2) * scene.count)
    if scene.wave("tx1").repeat and back % len(scene.wave("tx1").samples) < 5:
        return None

    def law(y, c, knob):
        out = y.copy()
        out[MARGIN + at : MARGIN + at + size] = y[MARGIN + at - back : MARGIN + at - back + size]
        return out

    rate = scene.rate
    got = made("overwritten", "adc_time", law, 1.0, 1.0, 1.0, ["sample_loss"], place=(at / rate, (at + size) / rate))
    got[0].fixed = True
    return got


OUTSIDE = (
    co_channel,
    shadowed_path,
    passing_car,
    born_path,
    hopper,
    one_burst,
    desensitised,
    swept_carrier,
    wandering_clock,
    cycle_slips,
    migrating_path,
    late_symbols,
    overwritten,
)
