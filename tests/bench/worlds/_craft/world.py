# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of a world: which waveform, which paths, which levels, which file."""

from dataclasses import dataclass, replace

import numpy as np

from . import files
from .causes import CarrierOffset
from .chain import Scene, received
from .waves import Wave


@dataclass(frozen=True, kw_only=True)
class Maker:
    """A waveform's recipe. make(rng) gives a Wave; its traits are known beforehand, so that a cause can ask for them."""

    make: object
    rates: tuple  # samples per second
    carriers: tuple  # Hz
    real: bool = False
    flat: bool = False
    repeat: bool = True
    unique: bool = True


@dataclass(frozen=True, kw_only=True)
class World:
    name: str
    makers: tuple
    menu: dict  # family: forms
    strangers: tuple  # names of foreign physics
    types: dict  # file type: share
    spread: tuple  # of path delays, samples: least and most of the last path's
    decays: tuple = (5.0, 40.0)  # of diffuse tails, samples
    most_taps: int = 4
    snr_db: tuple = (5.0, 35.0)
    lengths: tuple = (20e3, 150e3)

    def maker(self, rng, needs):
        fit = [
            m
            for m in self.makers
            if not (needs.get("complex") and m.real)
            and not (needs.get("envelope") and m.flat)
            and not (needs.get("real") and not m.real)
            and not (needs.get("flat") and not m.flat)
            and not ((needs.get("repeat") or needs.get("same_code")) and not m.repeat)
            and not (needs.get("unique") and not m.unique)
        ]
        return fit[int(rng.integers(len(fit)))]

    def length(self, rng, wave):
        low, high = self.lengths
        n = int(np.exp(rng.uniform(np.log(low), np.log(high))))
        if rng.uniform() < 0.1:
            n = int(rng.uniform(high, 300e3))
        return n if wave.repeat else wave.period + int(rng.uniform(600, 0.15 * wave.period + 2000))

    def paths(self, rng, wave, count, rate):
        """Delays in seconds, apart by more than the waveform resolves."""
        least = max(2.5, 2.0 / wave.band)
        last = max(10 ** rng.uniform(np.log10(self.spread[0]), np.log10(self.spread[1])), least * (count - 1) * 1.5)
        extra = rng.dirichlet(np.ones(count - 1)) * (last - least * (count - 1)) if count > 1 else []
        delays = np.concatenate([[0.0], np.cumsum(np.asarray(extra) + least)]) if count > 1 else np.zeros(1)
        taps = []
        for k, d in enumerate(delays):
            gain = 0.0 if k == 0 else -rng.uniform(1, 6) - 12 * rng.uniform() * k / count
            taps.append(
                {
                    "delay_s": float(f"{d / rate:.9g}"),
                    "gain_db": round(float(gain), 3),
                    "phase_rad": 0.0 if k == 0 else round(float(rng.uniform(-np.pi, np.pi)), 4),
                    "doppler_hz": 0.0,
                }
            )
        return taps

    def scene(self, rng, needs):
        maker = self.maker(rng, needs)
        wave = maker.make(rng)
        rate, carrier = float(rng.choice(maker.rates)), float(rng.choice(maker.carriers))
        n = self.length(rng, wave)
        low = needs.get("taps", 1)
        high = max(low, needs.get("taps_most", self.most_taps))
        count = int(rng.integers(low, high + 1)) if rng.uniform() > 0.35 or low > 1 else 1
        taps = self.paths(rng, wave, count, rate)
        unit = rate / n
        offset = needs.get("offset", rng.uniform() < 0.35)
        known = offset and rng.uniform() < 0.75 and needs.get("known", True)
        if offset:
            hz = float(f"{rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(6), np.log(60))) * unit:.5g}")
            if not known:
                taps = [{**t, "doppler_hz": hz} for t in taps]
        elif needs.get("offset") is None and count > 1 and rng.uniform() < 0.3:
            taps = [t if k == 0 else {**t, "doppler_hz": float(f"{rng.uniform(-8, 8) * unit:.4g}")} for k, t in enumerate(taps)]
        delay = rng.uniform(0, wave.period) if wave.repeat else rng.uniform(100, max(101, n - wave.period - 400))
        scene = Scene(
            rate_hz=rate,
            carrier_hz=carrier,
            wave=wave,
            amplitude=round(float(rng.uniform(0.4, 1.0)), 3),
            taps=taps,
            n=n,
            delay=float(delay),
            gain=1.0 + 0j,
            noise=1e-12,
            datatype="cf32_le",
            states_noise=bool(needs.get("states_noise", rng.uniform() < 0.75)),
        )
        if offset and known:
            scene.known = [known_offset(rng, scene, hz)]
        if needs.get("second"):
            scene.second = replace(self.unlike(rng, wave), name="second")
        elif needs.get("same_code"):
            roll = int(rng.integers(200, wave.period - 200))
            scene.second = replace(wave, samples=np.roll(wave.samples, roll), name="second", extra={"roll": roll})
        elif rng.uniform() < 0.15 and maker.unique:
            scene.second = replace(self.unlike(rng, wave), name="second")
        self.levels(rng, scene)
        return scene

    def levels(self, rng, scene, datatype=None):
        """Gain and noise: the file's type takes the peaks, and its steps are finer than the noise."""
        kinds = list(self.types)
        shares = np.array([self.types[k] for k in kinds]) / sum(self.types.values())
        scene.datatype = datatype or str(rng.choice(kinds, p=shares))
        y = received(scene, scene.known)
        power, peak = np.mean(np.abs(y) ** 2), np.max(np.abs(y))
        snr = 10 ** (rng.uniform(*self.snr_db) / 10)
        step = files.STEP[scene.datatype]
        most = 0.75 / (peak + 4.5 * np.sqrt(power / snr))
        gain = most if step > 1e-3 else most * 10 ** rng.uniform(-0.9, 0)
        noise = max(gain**2 * power / snr, 1.45 * step**2)
        scene.gain = complex(gain * np.exp(1j * rng.uniform(-np.pi, np.pi)))
        scene.noise = float(noise)
        scene.sheets.pop("rms", None)

    def unlike(self, rng, wave):
        """Another waveform of the same recipe."""
        other = wave.extra["again"](rng)
        if wave.extra.get("period"):
            assert other.period == wave.period
        return replace(other, name="other")

    def network(self, rng):
        """Two or three transmitters, each heard by two or three receivers, one link at a time."""
        makers = [m for m in self.makers if m.repeat and m.unique]
        maker = makers[int(rng.integers(len(makers)))]
        rate, carrier = float(rng.choice(maker.rates)), float(rng.choice(maker.carriers))
        senders, receivers = int(rng.integers(2, 4)), int(rng.integers(2, 4))
        n = int(rng.uniform(18e3, 36e3))
        kind = str(rng.choice(["cf32_le", "ci16_le"]))
        first = maker.make(rng)
        waves = [first, *[replace(first.extra["again"](rng), name=f"other{k}") for k in range(senders - 1)]]
        amplitudes = np.round(rng.uniform(0.5, 1.0, senders), 3)
        scenes = []
        for i in range(senders):
            for j in range(receivers):
                count = int(rng.integers(1, 4))
                scene = Scene(
                    rate_hz=rate,
                    carrier_hz=carrier,
                    wave=waves[i],
                    amplitude=float(amplitudes[i]),
                    taps=self.paths(rng, waves[i], count, rate),
                    n=n,
                    delay=float(rng.uniform(0, waves[i].period)),
                    gain=1.0 + 0j,
                    noise=1e-12,
                    datatype=kind,
                    tx=f"tx{i + 1}",
                    rx=f"rx{j + 1}",
                    stem=f"rec_tx{i + 1}_rx{j + 1}",
                )
                self.levels(rng, scene, kind)
                scenes.append(scene)
        for j in range(receivers):  # a receiver has one noise, and one air
            mine = [s for s in scenes if s.rx == f"rx{j + 1}"]
            noise = float(np.exp(np.mean([np.log(s.noise) for s in mine])))
            level = float(np.sqrt(np.mean([s.rms() ** 2 for s in mine])))
            for s in mine:
                s.noise = noise
                s.sheets["air"] = level
        return scenes


def known_offset(rng, scene, hz):
    """A carrier offset that the twin lists."""
    c = CarrierOffset(rng, scene, "still", "rx")
    c.sign, c.size = float(np.sign(hz)), abs(hz) / c.unit
    return c


def recipe(build, **traits):
    """make(rng) that remembers how to make another waveform of the same kind and length."""

    def make(rng):
        length = build.lengths(rng) if hasattr(build, "lengths") else None

        def again(other):
            samples, more = build(other, length)
            own = {"repeat": True, "real": False, "flat": False, "unique": True, **traits, **more}
            return Wave(samples=samples, extra={"again": again}, **own)

        return again(rng)

    return make
