# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs that one recording cannot tell apart. Each: (rng) → (link, family, level, Found, family sets, what to record next)."""

import math

import numpy as np

from . import causes_receiver as rx
from . import causes_transmitter as tx
from . import scene, strength
from .scene import Redraw
from .truth import Found, told

NOISE = ["second_power", "mute_transmitter", "shaped_waveform", "second_rx_gain"]
CARRIER = ["offset_carrier", "mute_transmitter", "second_link"]


def flat_noise(rng):
    """A louder floor, and noise that follows an envelope that is constant."""
    kinds = ["gmsk", "fmcw", "lora"] if rng.random() < 0.6 else ["builtin"]
    still = dict(taps=1, tells_noise=True, offset=0.0, doppler=0.0, whole=True, snr_db=rng.uniform(10, 30))
    link = scene.link(rng, kinds=kinds, **still)
    if not link.repeat:
        raise Redraw("silence tells")
    found = rx.noise_floor(link, rng, 10 ** rng.uniform(2.5, 4.5), flat=True)
    if found.spec["change_db"] < 0:
        raise Redraw("quieter is the floor")
    return link, "noise_floor", "rx", found, [["noise_floor", "signal_dependent_noise"]], NOISE


def carrier_line(rng):
    """A line at zero, of the transmitter's carrier or of the receiver's mixer."""
    link = scene.link(rng, offset=0.0, doppler=0.0, kinds=["qam", "dsss", "zc", "gmsk", "builtin"])
    if not link.repeat:
        raise Redraw("silence may tell")
    family = str(rng.choice(["dc_offset", "lo_leakage"]))
    link.network = True  # neither asks for an offset then, and nothing decays
    found = (rx.direct_current if family == "dc_offset" else tx.leakage)(link, rng, 10 ** rng.uniform(2.4, 4.6))
    link.network = False
    return link, family, "rx" if family == "dc_offset" else "tx", found, [["dc_offset", "lo_leakage"]], CARRIER


def real_mirror(rng):
    """The mirror image of a real waveform is itself: the paths' phases alone change sign."""
    link = scene.link(rng, kinds=["builtin", "dme"], taps=2, offset=0.0, doppler=0.0)
    if not link.repeat or len(link.taps) != 2:
        raise Redraw("taps")
    phase = link.taps[1]["phase_rad"]
    if abs(math.sin(phase)) < 0.25:
        raise Redraw("one phase")
    if rng.random() < 0.5:
        family, level = "spectral_inversion", "rx"
        found = Found(spec={}, lam=strength.energy(link, {family: {}}))
    else:
        family, level = "tap_gain_error", "link"
        turn = (-2 * phase + np.pi) % (2 * np.pi) - np.pi
        spec, d = dict(tap=1, factor=np.exp(1j * turn)), link.taps[1]["delay_s"]
        p = dict(delay_s=told(d), error_db=told(0.0, True), error_rad=told(turn, True))
        lam = strength.energy(link, {family: spec})
        found = Found(spec=spec, lam=lam, parameters=p, where=dict(delay_s=[d, d]))
    if found.lam < 100:
        raise Redraw("weak")
    return link, family, level, found, [["spectral_inversion", "tap_gain_error"]], ["complex_waveform", "offset_carrier"]


KINDS = (flat_noise, carrier_line, real_mirror)
