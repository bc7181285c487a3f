# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings without the twin's waveform. Each form: (world, rng, scene) → (name, causes, tolerated) or None."""

from dataclasses import dataclass

import numpy as np

from . import causes as c
from . import scene as s


@dataclass(kw_only=True)
class Foreign(c.Air):
    """Another signal of the same standard, as strong as the wanted one would be."""

    family: str = "outside:foreign"
    wave: object = None
    delay: float = 0.0

    def act(self, y, context):
        x = s.placed(self.wave, self.delay, context.length)
        x = x / np.sqrt(np.mean(np.abs(x[context.window]) ** 2))
        return y + np.sqrt(self.power(context)) * x


def noise_alone(world, rng, scene):
    return "noise", [], []


def other_frame(world, rng, scene):
    again = scene.wave("tx1").family.get("again")
    if again is None:
        return None
    wave = again(rng)
    delay = float(rng.uniform(0, len(wave.samples) if wave.repeat else max(1, scene.count - len(wave.samples))))
    return "other_frame", [Foreign(knob=1.0, wave=wave, delay=delay, seed=1)], []


def too_weak(world, rng, scene):
    """A satellite's signal on a small antenna: all its energy in the recording is below one noise sample's."""
    r = scene.recordings[0]
    scene.present = float(np.sqrt(rng.uniform(0.05, 0.7) * scene.noise["rx1"] / (c._wanted(scene, r) * scene.count)))
    return "too_weak", [], []


def blocker_alone(world, rng, scene):
    family = ["tone_interference", "narrowband_interference", "pulsed_interference"][rng.integers(3)]
    cause = world.cause(rng, family, scene)
    if cause is None:
        return None
    cause.knob = 10 ** (rng.uniform(-10, 5) / 20)
    return "blocker", [cause], [family]
