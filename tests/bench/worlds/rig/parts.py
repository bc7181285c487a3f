# SPDX-License-Identifier: GPL-3.0-or-later
"""Builders whose law each world supplies: `physics` with oscillators, amplifiers, filters, fading and interferers."""

import numpy as np

from . import causes as c
from .world import World, ends, log, offset_known, pick, sign, slot, some_tap


class Equipped(World):
    physics = None

    def phase_noise(self, rng, scene):
        level, name = ends(rng, scene)
        process, free, form = self.physics.phase_noise(rng, scene)
        return c.PhaseNoise(
            slot=slot(level, "lo"), level=level, name=name, knob=0.01, lo=1e-5, hi=0.7, process=process, free=free, form=form
        )

    def amplifier(self, rng, scene):
        waves = [scene.wave(tx) for tx in scene.transmitters]
        if any(w.variation < 0.1 or not w.limited for w in waves):
            return None
        _, name = ends(rng, scene, ("tx",))
        curve, echoes, (lo, hi), form = self.physics.amplifier(rng)
        return c.Amplifier(level="tx", name=name, knob=0.3 * hi, lo=lo, hi=hi, curve=curve, echoes=echoes, form=form)

    def filter(self, rng, scene):
        level, name = ends(rng, scene)
        response, knob, (lo, hi), form = self.physics.front_end(rng, scene)
        return c.Filter(slot=slot(level, "filter"), level=level, name=name, knob=knob, lo=lo, hi=hi, response=response, form=form)

    def fadings(self, rng, scene):
        return self.physics.fading(rng, scene)

    def narrowband(self, rng, scene):
        process, boxed, form = self.physics.narrowband(rng, scene)
        bandwidth = scene.rate * log(rng, max(0.003, 60 / scene.count), 0.08)
        f = sign(rng) * rng.uniform(0.02, 0.4) * scene.rate
        return c.Narrowband(
            knob=0.1, lo=1e-3, hi=1.5, frequency_hz=f, bandwidth_hz=bandwidth, process=process, boxed=boxed, form=form
        )

    def pulsed(self, rng, scene):
        burst, coherent, form = self.physics.pulsed(rng)
        period = scene.duration / log(rng, 4, 60)
        duty = log(rng, 0.02, 0.5)
        if period * duty * scene.rate < 12:
            return None
        f = sign(rng) * rng.uniform(0.0, 0.3) * scene.rate
        return c.Pulsed(
            knob=0.2,
            lo=1e-3,
            hi=3.0,
            period_s=period,
            duty=duty,
            burst=burst,
            noise_like=not coherent,
            start_s=rng.uniform(0, period),
            frequency_hz=f if coherent else 0.0,
            form=form,
        )

    def impulses(self, rng, scene):
        shape, spread, bunch, form = self.physics.impulses(rng)
        rate = log(rng, 8, 120) / scene.duration * bunch
        size = np.sqrt(max(scene.noise.values()))
        return c.Impulses(
            knob=12 * size, lo=2 * size, hi=0.6, rate_hz=rate, shape=shape, spread_db=spread, bunch=bunch, form=form
        )

    def offset_free(self, scene):
        return offset_known(scene) == 0.0

    def pick(self, rng, options):
        return pick(rng, options)

    def neighbour(self, rng, scene):
        """Another one's signal, of another period."""
        if scene.network:
            return None
        own = len(scene.wave("tx1").samples)
        for _ in range(20):
            wave = pick(rng, self.neighbours())(rng)
            if wave.repeat and abs(len(wave.samples) - own) > 3:
                return wave
        return None

    def bundle(self, rng, scene):
        """One path that fades, moves and is not where the twin has it."""
        found = some_tap(rng, scene, 3)
        if not found:
            return None
        out = []
        for make in (self.tap_fading, self.tap_delay, self.tap_doppler):
            cause = make(rng, scene)
            if cause is None:
                return None
            cause.name, cause.tap, cause.seed = ">".join(found[0]), found[1], int(rng.integers(2**31))
            out.append(cause)
        return out
