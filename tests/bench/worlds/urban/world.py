# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of the city: delay profiles of the standards, moving stations, offsets of handsets."""

import numpy as np

from ..rig import nothing, undecided
from ..rig import world as w
from ..rig.parts import Equipped
from ..rig.world import log, pick, sign
from . import faults, physics, waveforms

RATES = (1.92e6, 3.84e6, 7.68e6, 15.36e6, 30.72e6, 2.0e6, 4.0e6, 10.0e6, 20.0e6)
CARRIERS = (700e6, 806e6, 1.8e9, 2.14e9, 2.437e9, 2.6e9, 3.6e9, 5.18e9, 5.9e9)


def street(rng, wave, rate, carrier, duration, *, count=None, still=False):
    """A standard's delay profile, scaled to this band, its taps at least a resolution cell apart; Rician phases."""
    lo, hi = wave.band(10)
    cell = 1 / ((hi - lo) * rate)
    longest = min(len(wave.samples) / 5 if wave.repeat else 300, 300) / rate
    name = pick(rng, list(physics.NORMALISED) + list(physics.ABSOLUTE_NS))
    if name in physics.NORMALISED:
        delays, powers = (np.array(v) for v in physics.NORMALISED[name])
        delays = delays * log(rng, 2.0 * cell, max(longest / 3, 3 * cell))
    else:
        delays, powers = np.array(physics.ABSOLUTE_NS[name][0]) * 1e-9, np.array(physics.ABSOLUTE_NS[name][1])
        delays = delays * max(1.0, 4 * cell / delays[-1])
    keep = [0]
    for k in range(1, len(delays)):
        if delays[k] - delays[keep[-1]] > 1.4 * cell and delays[k] < longest:
            keep.append(k)
    keep = keep[: count or int(rng.integers(1, 7))]
    if count and len(keep) < count:
        extra = [delays[keep[-1]] + 2 * cell * (k + 1) for k in range(count - len(keep))]
        delays, powers = np.append(delays[keep], extra), np.append(powers[keep], -6.0 - 2 * np.arange(len(extra)))
        keep = list(range(count))
    speed = 0.0
    if not still and rng.random() < 0.35:
        speed = log(rng, 0.2, 12) / duration
        # The delay of a moving path moves too; a twin's does not. Where that would show, the street stands still.
        if speed / carrier * duration * rate > 1e-3:
            speed = 0.0
    taps = []
    for n, k in enumerate(keep):
        doppler = speed * np.cos(rng.uniform(0, np.pi)) if speed and rng.random() < 0.6 else 0.0
        gain = float(powers[k] - powers[0]) + (0 if n == 0 else rng.normal(0, 1.0))
        taps.append(w.round_tap(delays[k], max(min(gain, 12.0), -26.0), 0.0 if n == 0 else rng.uniform(-np.pi, np.pi), doppler))
    return taps


class Urban(Equipped):
    name = "urban"
    physics = physics
    outside = faults.OUTSIDE

    def __init__(self):
        super().__init__()
        u = undecided
        forms = (u.carrier_line, u.flat_noise, u.flat_noise, u.real_inversion, u.short_tail, u.same_code, u.same_code)
        self.ambiguous = [lambda rng, f=f: f(self, rng) for f in forms]
        n = nothing
        forms = (n.noise_alone, n.other_frame, n.too_weak, n.too_weak, n.blocker_alone)
        self.absent = [lambda rng, scene, f=f: f(self, rng, scene) for f in forms]

    def scene(self, rng, *, offset=None, still=False, constant=False, real=False, taps=None, tell_noise=None, float_file=False):
        """still: no Doppler, no physics in the twin besides an offset."""
        pool = waveforms.CONSTANT if constant else waveforms.REAL if real else waveforms.EVERY
        wave = pick(rng, pool)(rng)
        rate, carrier = pick(rng, RATES), pick(rng, CARRIERS)
        count = w.length(rng, wave)
        datatype = "cf32_le" if float_file else pick(rng, ["cf32_le", "cf32_le", "ci16_le", "ci16_le", "ci16_le", "ci8", "cu8"])
        if taps == 1:
            paths = [w.round_tap(0.0, 0.0, 0.0)]
        else:
            paths = street(rng, wave, rate, carrier, count / rate, count=taps, still=still)
        snr = rng.uniform(5, 20) if datatype in ("ci8", "cu8") else rng.uniform(5, 38)
        scene = w.single_link(
            rng,
            wave=wave,
            rate=rate,
            carrier=carrier,
            count=count,
            taps=paths,
            snr_db=snr,
            datatype=datatype,
            tell_noise=tell_noise,
        )
        if offset is not False and (offset or rng.random() < 0.45):
            hz = sign(rng) * min(log(rng, 15 / scene.duration, 5e-3 * rate), 10e-6 * carrier)
            w.know_offset(rng, scene, hz, refined=not still and rng.random() < 0.3, level=pick(rng, ["rx", "rx", "tx"]))
        if not still and rng.random() < 0.16 and wave.repeat and wave.known is None:
            if rng.random() < 0.5:
                w.know_clock(rng, scene, sign(rng) * rng.uniform(0.1, 5), refined=bool(rng.random() < 0.4))
            else:
                lo, longest = self.room(scene, ("tx1", "rx1"))
                delay = paths[-1]["delay_s"] + log(rng, lo, longest)
                w.know_path(rng, scene, delay, float(rng.uniform(-25, -8)), float(rng.uniform(-3, 3)))
        if not still and rng.random() < 0.25:
            decoy = self.neighbour(rng, scene)
            scene.waves |= {"w9": decoy} if decoy is not None else {}
        return scene

    def network(self, rng):
        shape = pick(rng, [(2, 2), (2, 3), (3, 2), (3, 3)])
        rate, carrier = pick(rng, RATES), pick(rng, CARRIERS)
        make = pick(rng, [waveforms.spread_spectrum, waveforms.single_carrier, waveforms.sounder, waveforms.cellular])

        def wave(_):
            while True:
                made = make(rng)
                if made.repeat and made.known is None:
                    return made

        chosen = [wave(k) for k in range(shape[0])]
        count = max(int(log(rng, 20_000, 45_000)), 4 * max(len(x.samples) for x in chosen))
        return w.grid_network(
            rng,
            make_wave=lambda k: chosen[k],
            make_taps=lambda k: street(rng, chosen[k], rate, carrier, count / rate),
            rate=rate,
            carrier=carrier,
            count=count,
            snr_db=rng.uniform(9, 28),
            transmitters=shape[0],
            receivers=shape[1],
            offset_hz=40 * rate / count if rng.random() < 0.5 else 0.0,
            together=bool(rng.random() < 0.25),
        )

    def hums(self, rng, scene):
        """Mains, tramways, an alternator, a converter in a vehicle or a lamp."""
        return [50.0, 100.0, 33.4, 600.0, round(log(rng, 800, 6e3), 1), round(log(rng, 8e3, 3e5), 1)]

    def neighbours(self):
        """Other base stations' signals."""
        return [waveforms.sounder, waveforms.spread_spectrum, waveforms.single_carrier]
