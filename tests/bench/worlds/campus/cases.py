# SPDX-License-Identifier: GPL-3.0-or-later
"""A case of each kind: a link, causes at drawn strengths, the recording, the files and the truth."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from . import channel, menu, network, scene, strangers, strength, truth, undecided, waveforms
from .causes_transmitter import mixed
from .scene import Redraw
from .truth import Found

TRIES, ROUND = 400, 25


def finished(rng, folder, kind, link, causes, effects, verdict, **more):
    y = channel.received(link, causes, link.unit)
    file_kind = truth.datatype(rng, link, y, causes)
    y = truth.stored(y, file_kind)
    truth.write(folder, {("tx1", "rx1"): link}, {"recording": y}, file_kind)
    clean = channel.received(link, {k: v for k, v in causes.items() if k != "quantization"})  # whose steps are noise
    fits = [truth.fit(link, "recording", y, clean)]
    return truth.of(kind, [link], effects, fits, verdict, **more)


def several(rng, folder, kind, families):
    link = scene.link(rng, **menu.needs(rng, families, waveforms.silent))
    causes, founds = {}, {}
    for family in sorted(families, key=lambda f: f != "missing_path"):  # which may change the twin's taps: first
        founds[family] = menu.FAMILIES[family][0](link, rng, strength.target(rng))
        causes[family] = founds[family].spec
    if "missing_path" in causes and (taken(causes, link.gone) or link.gone < 0):
        raise Redraw("two causes of one tap")
    offset = causes.get("carrier_frequency_offset")
    if "dc_offset" in causes and offset and abs(offset["offset_hz"] + link.offset_hz) < 8 / link.duration:
        raise Redraw("the carrier comes to the receiver's zero")
    if len(families) > 1:
        apart(link, causes, founds)
        truth.relevel(link, causes, founds)
    effects = [truth.effect(f, menu.FAMILIES[f][1], found) for f, found in founds.items()]
    return finished(rng, folder, kind, link, causes, effects, "identified")


def taken(causes, tap):
    return any(causes[f]["tap"] == tap for f in channel.TAPS if f in causes)


def apart(link, causes, founds):
    """No cause drowns in another, and no two leave nearly the same signal."""
    if menu.drowned(link, founds):
        raise Redraw("a cause drowns")
    left = []
    for family, spec in causes.items():
        if family in ("noise_floor", "signal_dependent_noise", "quantization"):
            continue
        r = strength.refitted(link, channel.received(link, {family: spec}) - link.y)
        left.append(r / math.sqrt(np.sum(np.abs(r) ** 2) + 1e-300))
    for k, r in enumerate(left):
        if any(abs(np.vdot(r, other)) > 0.9 for other in left[:k]):
            raise Redraw("two causes alike")


def null(rng, folder):
    """Nothing; or something that a real waveform hides, or that is far below the noise."""
    more = menu.unknown(rng, [["phase", "gain"], ["delay", "phase"], ["delay", "phase", "gain"]]) if rng.random() < 0.2 else {}
    if rng.random() < 0.25:
        more["second"] = waveforms.silent(rng)
    hidden = rng.random()
    link = scene.link(rng, kinds=["builtin", "dme"] if hidden < 0.25 else None, **more)
    causes, harmless, never = {}, [], []
    if hidden < 0.25:
        spec = dict(at="tx", **mixed(1 + rng.uniform(0.02, 0.08), rng.uniform(-0.05, 0.05)))
        if "gain" in link.unknown and strength.energy(link, {"iq_imbalance": spec}) < 1e-3:
            causes["iq_imbalance"] = spec
            harmless, never = [dict(family="iq_imbalance", strength=abs(spec["image"] / spec["direct"]))], ["iq_imbalance"]
    elif hidden < 0.6:
        f = 0.02 / link.duration / math.sqrt(link.n * link.wanted / link.noise) * rng.uniform(2, 8)
        spec = dict(at="tx", offset_hz=f, drift=0.0)
        if strength.energy(link, {"carrier_frequency_offset": spec}) < 0.5:
            causes["carrier_frequency_offset"] = spec
            harmless = [dict(family="carrier_frequency_offset", strength=f)]
    return finished(rng, folder, "null", link, causes, [], "no_mismatch", harmless=harmless, never_claim=never)


def outside(rng, folder):
    link = scene.link(rng, snr_db=rng.uniform(12, 40), kinds=[k for k in waveforms.SHARES if k != "dme"])
    if "known" in link.traits:
        raise Redraw("the place may lie where nothing is known")
    form = strangers.KINDS[int(rng.integers(len(strangers.KINDS)))]
    spec, where, tolerated = form(link, rng)
    lam = strength.energy(link, {"outside": spec})
    if lam < 2000:
        raise Redraw("weak")
    level = "environment" if form is strangers.sweep else "rx"
    told_of = truth.effect(f"outside:{form.__name__}", level, Found(spec={}, lam=lam, where=where))
    told_of["owners_ok"] = ["tx1", "rx1", "tx1>rx1", "environment"]
    return finished(rng, folder, "outside", link, {"outside": spec}, [told_of], "unexplained", tolerated=tolerated)


def ambiguous(rng, folder):
    form = undecided.KINDS[int(rng.integers(len(undecided.KINDS)))]
    link, family, level, found, sets, then = form(rng)
    effects = [truth.effect(family, level, found)]
    pair = {"family_sets": sets, "record_next": then}
    return finished(
        rng, folder, "ambiguous", link, {family: found.spec}, effects, "ambiguous", ambiguous=pair, tolerated=[family]
    )


# ---------------------------------------------------------------- the waveform is not there
def nothing(rng, link):
    return np.zeros(link.n), []


def too_weak(rng, link):
    """All its energy in the recording is below one noise sample's."""
    return link.y * math.sqrt(rng.uniform(0.05, 0.7) * link.noise / np.sum(np.abs(link.y) ** 2)), []


def other_message(rng, link):
    """Another waveform of the same make, as strong as the wanted one would be."""
    x, traits, repeat = waveforms.wave(rng, link.n, [link.make])
    if repeat != link.repeat or (not repeat and link.delay + len(x) > link.n - 20):
        raise Redraw("another form")
    other = replace(link, x=x, traits=traits, fine=None, plain=None)
    return other.y * math.sqrt(link.wanted / other.wanted), []


def blocker(rng, link):
    family = ("tone_interference", "narrowband_interference", "pulsed_interference")[int(rng.integers(3))]
    found = menu.FAMILIES[family][0](link, rng, strength.MOST)
    t = np.arange(link.n) / link.rate
    return found.spec["signal"](t), [family]


ABSENT = (nothing, other_message, other_message, too_weak, blocker)


def highest(link, y):
    """The largest correlation with the waveform over all delays, re its mean."""
    x, n = np.where(link.traits.get("known", True), link.x, 0), len(link.x)
    y = y * np.exp(-2j * np.pi * link.offset_hz * np.arange(link.n) / link.rate)
    if link.repeat:
        y = y[: len(y) // n * n].reshape(-1, n).sum(0)
    else:
        n += len(y)
    c = np.abs(np.fft.ifft(np.fft.fft(y, n) * np.fft.fft(x, n).conj())) ** 2
    return float(np.max(c) / np.mean(c))


def absent(rng, folder):
    form = ABSENT[int(rng.integers(len(ABSENT)))]
    kind = str(rng.choice(["ofdm", "qam", "gmsk", "dsss", "zc"]))
    link = scene.link(rng, kinds=[kind], doppler=0.0)
    link.make = kind
    there, tolerated = form(rng, link)
    y = there + math.sqrt(link.noise) * link.unit[0, : link.n]
    if form is not blocker and highest(link, y) > 30:
        raise Redraw("something of the waveform is there")
    file_kind = truth.datatype(rng, link, y, {})
    y = truth.stored(y, file_kind)
    truth.write(folder, {("tx1", "rx1"): link}, {"recording": y}, file_kind)
    found = Found(spec={}, lam=1e6)
    told_of = truth.effect(f"outside:absent_{form.__name__}", "environment", found)
    entry = truth.fit(link, "recording", y, 0 * y) | dict(noise_floor_db=0.0, snr_db=-99.0, delay_samples=0.0, gain=0.0)
    return truth.of("outside", [link], [told_of], [entry], "unexplained", tolerated=tolerated, absent=True)


COUNTS = {"single": 1, "double": 2, "triple": 3}
KINDS = {"null": null, "outside": outside, "ambiguous": ambiguous, "network": network.draw, "absent": absent}


def draw(rng, kind, folder, families=None):
    """Writes one case of this kind into the folder; its truth. families: those that it is to hold."""
    folder = Path(folder)
    if kind not in COUNTS and kind not in KINDS:
        raise ValueError(f"kind: got {kind!r}, expected one of {sorted([*COUNTS, *KINDS])}")
    drawn = None
    for attempt in range(TRIES):
        if kind in COUNTS and attempt % ROUND == 0:  # families that are hard to draw are not given up at once
            drawn = families or menu.families(rng, COUNTS[kind])
        try:
            return several(rng, folder, kind, drawn) if kind in COUNTS else KINDS[kind](rng, folder)
        except Redraw:
            continue
    raise RuntimeError(f"campus: no {kind} case in {TRIES} draws")
