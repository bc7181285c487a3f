# SPDX-License-Identifier: GPL-3.0-or-later
"""Pairs that one recording cannot tell apart: the answer is `ambiguous`, with the experiment that decides."""

import numpy as np

from . import world
from .impairments import FAMILIES
from .record import finish
from .scenes import RATES, Retry, draw_scene, draw_taps, draw_waveform, single_wave, whole_delay
from .tune import owner_of, tune

STATIC_TAP = {"delay_s": 0.0, "gain_db": 0.0, "phase_rad": 0.0, "doppler_hz": 0.0}


def _static(rng, kinds, most):
    """A scene without any offset or Doppler, of at most so many taps."""
    waveform, rate = draw_waveform(rng, str(rng.choice(kinds))), float(rng.choice(RATES))
    taps = draw_taps(rng, waveform, rate, 1e9, 40_000, most=most, dopplers=False)
    count = int(rng.integers(25_000, 60_000))
    return draw_scene(rng, waveform=waveform, rate=rate, carrier=1e9, count=count, taps=taps, offset_known=0.0)


def _cause(rng, key, scene, **draw):
    family = FAMILIES[key]
    drawn = {**family.draw(rng, scene.context), **draw}
    return world.Cause(key=key, owner=owner_of(rng, family, scene), strength=family.start, draw=drawn)


def dc_or_leak(rng):
    """A constant, and nothing turns."""
    scene = _static(rng, ["builtin", "zadoff_chu", "rrc_qpsk", "ofdm"], most=2)
    cause = _cause(rng, str(rng.choice(["dc_offset", "lo_leakage"])), scene)
    return scene, cause, ["dc_offset", "lo_leakage"], ["offset_carrier", "mute_transmitter", "second_link"]


def floor_or_signal_noise(rng):
    """More noise under a wanted power that never changes: held chips, one tap, a whole delay."""
    scene = whole_delay(_static(rng, ["builtin", "zadoff_chu"], most=1))
    experiments = ["second_power", "mute_transmitter", "shaped_waveform", "second_rx_gain"]
    return scene, _cause(rng, "noise_floor", scene), ["noise_floor", "signal_dependent_noise"], experiments


def filter_or_tail(rng):
    """Two or three samples of tail, too weak to show whether the noise went through it as well."""
    scene = draw_scene(rng, kind="rrc_qpsk", offset_known=0.0, snr_db=float(rng.uniform(26, 31)), taps=(STATIC_TAP,))
    cause = _cause(rng, "diffuse_tail", scene, decay=float(rng.uniform(1.0, 1.8)), start=1.0)
    return (
        scene,
        cause,
        ["front_end_filter", "diffuse_tail"],
        ["second_link", "move_carrier", "longer_recording"],
    )


def same_code(rng):
    """An echo, or a second transmitter with the same waveform."""
    scene = draw_scene(rng, offset_known=0.0, kind=str(rng.choice(["builtin", "rrc_qpsk", "zadoff_chu"])))
    cause = _cause(rng, "extra_path", scene, doppler_hz=0.0)
    return scene, cause, ["extra_path", "second_transmitter"], ["mute_transmitter", "other_code_length"]


def one_of_two_taps(rng):
    """A wrong gain of either tap, while the gain of both is unknown."""
    scene = _static(rng, ["rrc_qpsk", "zadoff_chu"], most=2)  # with real samples an image would do as well
    if len(scene.context.taps) != 2:
        raise Retry("one tap")
    return scene, _cause(rng, "tap_gain_error", scene), ["tap_gain_error"], ["absolute_calibration"]


PAIRS = {
    dc_or_leak: 0.32,
    floor_or_signal_noise: 0.32,
    filter_or_tail: 0.14,
    same_code: 0.12,
    one_of_two_taps: 0.1,
}


def ambiguous(rng):
    make = list(PAIRS)[int(rng.choice(len(PAIRS), p=list(PAIRS.values())))]
    target = float(np.exp(rng.uniform(np.log(150), np.log(3000))))
    scene, cause, families, experiments = make(rng)
    if make is filter_or_tail:
        target = min(target, 0.8 * 10 ** (scene.context.snr_db / 10))
    causes = tune([scene], [cause], 0, target)
    wave = single_wave(scene)
    if make is same_code:
        wave["all"]["w9"] = scene.context.waveform
    answer = {"family_sets": [families], "record_next": experiments}
    return finish(
        rng,
        [scene],
        causes,
        kind="ambiguous",
        wave=wave,
        verdicts=["ambiguous"],
        noise=True,
        ambiguous=answer,
    )
