# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of the laboratory: devices with their rates and file formats, cables, splitters and channel emulators."""

import numpy as np

from ..rig import nothing, undecided
from ..rig import world as w
from ..rig.parts import Equipped
from ..rig.world import log, pick
from . import faults, physics, waveforms

# name, rates in Hz, file formats
DEVICES = (
    ("vector generator and analyser", (2e6, 5e6, 10e6, 20e6, 50e6), ("cf32_le",)),
    ("USRP B210", (1e6, 2e6, 4e6, 5e6, 8e6, 16e6), ("ci16_le", "cf32_le")),
    ("USRP X310", (6.25e6, 12.5e6, 25e6), ("ci16_le", "cf32_le")),
    ("PlutoSDR", (2.5e6, 3e6, 4e6), ("ci16_le",)),
    ("HackRF", (8e6, 10e6, 20e6), ("ci8",)),
    ("RTL-SDR", (1.024e6, 2.048e6, 2.4e6), ("cu8",)),
)
CARRIERS = (433.92e6, 868.3e6, 915e6, 1.0e9, 1.57542e9, 2.44e9, 3.5e9, 5.8e9)


def cable(rng, wave, rate, count):
    """One path; a mismatch's echo; or a channel emulator's three to five paths."""
    lo, hi = wave.band(10)
    cell = 1 / ((hi - lo) * rate)
    longest = min(len(wave.samples) / 4 if wave.repeat else 300, 300) / rate
    taps = [w.round_tap(0.0, 0.0, 0.0)]
    delay = 0.0
    for k in range(1, count):
        room = longest - delay
        delay += log(rng, 1.6 * cell, max(room / (count - k + 1), 2.5 * cell))
        gain = rng.uniform(-22, -3) if count == 2 else rng.uniform(-15, -1)
        taps.append(w.round_tap(delay, gain, rng.uniform(-np.pi, np.pi)))
    return taps


class Lab(Equipped):
    name = "lab"
    physics = physics
    outside = faults.OUTSIDE

    def __init__(self):
        super().__init__()
        u = undecided
        forms = (u.carrier_line, u.carrier_line, u.flat_noise, u.real_inversion, u.real_imbalance, u.short_tail, u.same_code)
        self.ambiguous = [lambda rng, f=f: f(self, rng) for f in forms]
        n = nothing
        forms = (n.noise_alone, n.other_frame, n.other_frame, n.too_weak, n.blocker_alone)
        self.absent = [lambda rng, scene, f=f: f(self, rng, scene) for f in forms]

    def scene(self, rng, *, offset=None, still=False, constant=False, real=False, taps=None, tell_noise=None, float_file=False):
        """still: no Doppler, no physics in the twin besides an offset."""
        pool = waveforms.CONSTANT if constant else waveforms.REAL if real else waveforms.EVERY
        wave = pick(rng, pool)(rng)
        _, rates, formats = pick(rng, DEVICES if not float_file else DEVICES[:1])
        rate, datatype = pick(rng, rates), pick(rng, formats)
        carrier = pick(rng, CARRIERS)
        count = w.length(rng, wave)
        paths = cable(rng, wave, rate, taps or pick(rng, [1, 1, 2, 2, 3, 3, 4, 5]))
        snr = rng.uniform(8, 21) if datatype in ("ci8", "cu8") else rng.uniform(8, 45)
        scene = w.single_link(
            rng,
            wave=wave,
            rate=rate,
            carrier=carrier,
            count=count,
            taps=paths,
            snr_db=snr,
            datatype=datatype,
            amplitude=pick(rng, [1.0, 1.0, 0.8, 0.5]),
            tell_noise=tell_noise,
        )
        if offset is not False and (offset or rng.random() < 0.35):
            hz = w.sign(rng) * log(rng, 12 / scene.duration, 2e-3 * rate)
            w.know_offset(rng, scene, hz, refined=not still and rng.random() < 0.3, level=pick(rng, ["rx", "tx"]))
        if not still and rng.random() < 0.18 and wave.repeat and wave.known is None:
            kind = int(rng.integers(3))
            if kind == 0:
                w.know_clock(rng, scene, w.sign(rng) * rng.uniform(0.5, 20), refined=bool(rng.random() < 0.4))
            elif kind == 1:
                w.know_step(rng, scene, round(float(rng.uniform(-3, 3)), 3))
            else:
                lo, longest = self.room(scene, ("tx1", "rx1"))
                delay = paths[-1]["delay_s"] + log(rng, lo, longest)
                w.know_path(rng, scene, delay, float(rng.uniform(-25, -8)), float(rng.uniform(-3, 3)))
        if not still and rng.random() < 0.25:
            decoy = self.neighbour(rng, scene)
            scene.waves |= {"w9": decoy} if decoy is not None else {}
        return scene

    def network(self, rng):
        shape = pick(rng, [(2, 2), (2, 2), (3, 2), (2, 3), (3, 3)])
        rate = pick(rng, [2e6, 5e6, 10e6, 25e6])
        make = pick(rng, [waveforms.qpsk, waveforms.qam, waveforms.code, waveforms.zadoff_chu])

        def wave(_):
            while True:
                made = make(rng)
                if made.repeat and made.known is None:
                    return made

        first = wave(0)
        chosen = [first] + [wave(k) for k in range(1, shape[0])]
        count = max(int(log(rng, 20_000, 45_000)), 4 * max(len(x.samples) for x in chosen))
        return w.grid_network(
            rng,
            make_wave=lambda k: chosen[k],
            make_taps=lambda k: cable(rng, chosen[k], rate, pick(rng, [1, 2, 3])),
            rate=rate,
            carrier=pick(rng, CARRIERS),
            count=count,
            snr_db=rng.uniform(10, 32),
            transmitters=shape[0],
            receivers=shape[1],
            offset_hz=30 * rate / count if rng.random() < 0.5 else 0.0,
            together=bool(rng.random() < 0.25),
        )

    def hums(self, rng, scene):
        """Mains, aircraft supplies, and a switching regulator's ripple."""
        return [50.0, 60.0, 100.0, 120.0, 300.0, 400.0, round(log(rng, 2e3, 2e5), 1)]

    def neighbours(self):
        """Other codes."""
        return [waveforms.code, waveforms.zadoff_chu, waveforms.qpsk]
