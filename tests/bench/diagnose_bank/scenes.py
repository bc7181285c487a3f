# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws scenes: waveform, taps, levels, noise."""

from dataclasses import replace

import numpy as np

from . import channel, waveforms, world
from .impairments import Context

RATES = (1e6, 2e6, 4e6, 5e6, 10e6, 20e6, 25e6, 50e6)
CARRIERS = (433e6, 915e6, 1e9, 2.4e9, 3.5e9, 5.8e9)


class Retry(Exception):
    """This draw makes no fair case; draw again."""


def draw_waveform(rng, kind=None):
    kind = kind or rng.choice(
        ["builtin", "zadoff_chu", "rrc_qpsk", "rrc", "ofdm", "burst", "burst_ofdm"],
        p=[0.22, 0.12, 0.24, 0.14, 0.12, 0.1, 0.06],
    )
    make = {
        "builtin": waveforms.glfsr,
        "zadoff_chu": waveforms.zadoff_chu,
        "rrc_qpsk": waveforms.shaped_qpsk,
        "rrc": waveforms.shaped_bpsk,
        "ofdm": waveforms.ofdm,
    }
    if kind == "burst":
        return waveforms.shaped_qpsk(rng, repeat=False, symbols=int(rng.integers(4000, 8000)))
    if kind == "burst_ofdm":
        return waveforms.ofdm(rng, repeat=False)
    return make[str(kind)](rng)


def draw_taps(rng, waveform, rate, carrier, count, most=5, dopplers=True):
    number = int(rng.choice([1, 2, 3, 4, 5], p=[0.25, 0.15, 0.25, 0.2, 0.15]))
    span = min(0.3 * len(waveform.samples) if waveform.repeat else 300, 150)
    delays = [0.0]
    for _ in range(100):
        if len(delays) >= min(number, most):
            break
        d = float(rng.uniform(3.5, span))
        if min(abs(d - h) for h in delays) >= 3.5:
            delays.append(d)
    one = round(float(rng.uniform(-1, 1) * min(0.002 * carrier / count, 200.0)), 3) if dopplers and rng.random() < 0.2 else 0.0
    return tuple(
        {
            "delay_s": round(d / rate, 14),
            "gain_db": 0.0 if k == 0 else round(float(rng.uniform(-18, -1)), 3),
            "phase_rad": 0.0 if k == 0 else round(float(rng.uniform(-3.1, 3.1)), 4),
            "doppler_hz": one,
        }
        for k, d in enumerate(sorted(delays))
    )


def draw_scene(
    rng,
    *,
    waveform=None,
    taps=None,
    rate=None,
    carrier=None,
    count=None,
    offset_known=None,
    snr_db=None,
    name="recording",
    transmitter="tx1",
    receiver="rx1",
    amplitude=None,
    kind=None,
    gain=None,
):
    waveform = waveform or draw_waveform(rng, kind)
    rate, carrier = rate or float(rng.choice(RATES)), carrier or float(rng.choice(CARRIERS))
    least = 20_000 if waveform.repeat else max(30_000, int(1.15 * len(waveform.samples)))
    count = count or int(np.exp(rng.uniform(np.log(least), np.log(max(150_000, 1.5 * least)))))
    taps = taps or draw_taps(rng, waveform, rate, carrier, count)
    if offset_known is None:
        offset_known = round(float(rng.uniform(4, 14) * rate / count * rng.choice([-1, 1])), 2) if rng.random() < 0.35 else 0.0
    snr_db = float(rng.uniform(8, 33)) if snr_db is None else snr_db
    amplitude = amplitude or float(rng.choice([1.0, 1.0, 0.8, 0.5]))
    bulk = float(rng.uniform(0, len(waveform.samples))) if waveform.repeat else float(rng.uniform(0.02, 0.1) * count)
    spread = sum(abs(channel.amplitude(t)) for t in taps) * np.max(np.abs(waveform.samples))
    level = gain or float(rng.uniform(0.05, 0.8))
    gain = level / spread / amplitude * np.exp(1j * rng.uniform(-np.pi, np.pi))
    lead = (len(waveform.samples) if waveform.repeat else 0) + 6000
    context = Context(
        rate=rate,
        first=lead,
        count=count,
        carrier_hz=carrier,
        waveform=waveform,
        peak=amplitude * float(np.max(np.abs(waveform.samples))),
        taps=taps,
        offset_known_hz=offset_known,
        snr_db=snr_db,
        bulk=bulk,
        gain=complex(gain),
    )
    scene = world.Scene(
        name=name,
        transmitter=transmitter,
        receiver=receiver,
        context=context,
        amplitude=amplitude,
        seed=int(rng.integers(1, 2**31 - 9)),
    )
    return world.measured(scene, snr_db)


def whole_delay(scene):
    context = replace(scene.context, bulk=float(np.floor(scene.context.bulk)))
    return world.measured(replace(scene, context=context), context.snr_db)


def single_wave(scene):
    return {"all": {"w1": scene.context.waveform}, "keys": ["w1"]}


def with_second(rng, scene, always=False):
    """A waveform that the twin believes silent: truth of `second_transmitter`, elsewhere a decoy."""
    if not always and rng.random() > 0.25:
        return scene, single_wave(scene)
    other = waveforms.glfsr(rng, degree=int(rng.choice([8, 9, 10])), per_chip=int(rng.integers(2, 5)))
    mine = scene.context.waveform.code or {}
    if other.code | {"seed": 0} == mine | {"seed": 0}:
        raise Retry("another seed only delays the same code")
    wave = {"all": {"w1": scene.context.waveform, "w9": other}, "keys": ["w1"]}
    lead = max(scene.context.first, len(other.samples) + 6000)
    return replace(scene, second=other, context=replace(scene.context, first=lead)), wave
