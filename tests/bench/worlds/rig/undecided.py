# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs that one recording cannot tell apart.

Each form: (world, rng) → (scene, cause, family sets, what to record next) or None.
"""

from dataclasses import dataclass

import numpy as np

from . import causes as c
from .waves import Wave

CARRIER = ["offset_carrier", "mute_transmitter", "second_link"]
NOISE = ["second_power", "mute_transmitter", "shaped_waveform", "second_rx_gain"]
REAL = ["complex_waveform", "offset_carrier"]
SHAPE = ["move_carrier", "second_link"]
SAME = ["mute_transmitter", "second_link", "other_code_length"]


@dataclass(kw_only=True)
class FlatSignalNoise(c.SignalNoise):
    """The envelope is constant: what follows the signal is a louder floor."""

    def nats(self, context):
        r = 1 + self.knob**2
        return context.count * (r - 1 - np.log(r))


def _seeded(rng, cause):
    cause.seed = int(rng.integers(2**31))
    return cause


def carrier_line(world, rng):
    """A line at zero: after the receiver's mixer, or at the transmitter's carrier."""
    scene = world.scene(rng, offset=False, still=True)
    turn = rng.uniform(0, 2 * np.pi)
    if not scene.wave("tx1").repeat:
        return None
    if rng.random() < 0.5:
        cause = c.DirectCurrent(level="rx", name="rx1", knob=0.02, lo=1e-5, hi=0.5, angle=turn, form="steady")
    else:
        cause = c.Leakage(level="tx", name="tx1", knob=0.02, lo=1e-5, hi=0.5, angle=turn, form="carrier")
    return scene, _seeded(rng, cause), [["dc_offset", "lo_leakage"]], CARRIER


def flat_noise(world, rng):
    """More noise than the twin says, under a constant envelope."""
    scene = world.scene(rng, constant=True, taps=1, still=True, tell_noise=True, float_file=True)
    if scene.wave("tx1").variation > 1e-3 or not scene.wave("tx1").repeat:
        return None
    scene.recordings[0].delay = float(np.floor(scene.recordings[0].delay))
    scene.cache.clear()
    if rng.random() < 0.5:
        cause = c.NoiseFloor(name="rx1", knob=0.5, lo=1e-2, hi=10.0, form="louder")
    else:
        cause = FlatSignalNoise(name="rx1", knob=0.5, lo=1e-2, hi=4.0, form="constant envelope")
    return scene, _seeded(rng, cause), [["noise_floor", "signal_dependent_noise"]], NOISE


def _real_pair(world, rng):
    scene = world.scene(rng, real=True, taps=2, still=True, offset=False)
    taps = scene.links[("tx1", "rx1")]
    turn = np.sin(taps[1]["phase_rad"] - taps[0]["phase_rad"])
    return (scene, taps) if scene.wave("tx1").real and len(taps) == 2 and abs(turn) > 0.2 and taps[1]["gain_db"] > -20 else None


def real_inversion(world, rng):
    """The mirror image of a real code is the code: the paths' phases alone change sign."""
    made = _real_pair(world, rng)
    if made is None:
        return None
    scene, taps = made
    if rng.random() < 0.5:
        cause = c.Inversion(level="rx", name="rx1", knob=1.0, form="real code")
    else:
        g = np.exp(-2j * (taps[1]["phase_rad"] - taps[0]["phase_rad"]))
        cause = c.TapError(
            family="tap_gain_error", name="tx1>rx1", tap=1, knob=abs(g - 1), turn=np.angle(g - 1), fixed=True, form="mirrored"
        )
    return scene, _seeded(rng, cause), [["spectral_inversion", "tap_gain_error"]], REAL


def real_imbalance(world, rng):
    """The image of a real code in two paths is one path's wrong gain."""
    made = _real_pair(world, rng)
    if made is None:
        return None
    scene, _ = made
    turn = rng.uniform(0, 2 * np.pi)
    cause = c.Imbalance(slot="rx_iq", level="rx", name="rx1", knob=0.02, lo=1e-3, hi=0.12, turn=turn, form="real code")
    return scene, _seeded(rng, cause), [["iq_imbalance", "tap_gain_error"]], REAL


def short_tail(world, rng):
    """A dense tail of a few samples is a filter, and a filter such a tail."""
    scene = world.scene(rng, taps=1, still=True, offset=False)
    if not scene.wave("tx1").repeat:
        return None
    lo, hi = scene.wave("tx1").band(10)
    chip = 1 / (hi - lo)
    decay = rng.uniform(0.4, 1.2) * chip / scene.rate
    cause = c.Tail(
        name="tx1>rx1",
        knob=0.1,
        lo=1e-3,
        hi=0.6,
        start_s=0.5 / scene.rate,
        decay_s=decay,
        spacing_s=min(1.0, chip / 2) / scene.rate,
        rice=bool(rng.random() < 0.5),
        form="few samples",
    )
    return scene, _seeded(rng, cause), [["front_end_filter", "diffuse_tail"]], SHAPE


def same_code(world, rng):
    """A second transmitter with the first one's code is an echo, and an echo such a transmitter."""
    scene = world.scene(rng, still=True, offset=False)
    wave = scene.wave("tx1")
    if not wave.repeat or wave.known is not None:
        return None
    scene.waves["w9"] = Wave(**wave.__dict__)
    if rng.random() < 0.5:
        delay = scene.recordings[0].delay + rng.uniform(0.1, 0.9) * len(wave.samples)
        cause = c.SecondTransmitter(wave="w9", knob=0.05, lo=1e-4, hi=0.7, delay=delay, form="same code")
    else:
        d = round(rng.uniform(0.1, 0.9) * len(wave.samples) / scene.rate, 12)
        cause = c.ExtraPath(
            name="tx1>rx1", knob=0.05, lo=1e-4, hi=0.7, delay_s=d, phase=rng.uniform(-np.pi, np.pi), form="same code"
        )
    return scene, _seeded(rng, cause), [["second_transmitter", "extra_path"]], SAME
