# SPDX-License-Identifier: GPL-3.0-or-later
"""A diffuse tail behind the first tap: many weak taps whose power falls by e in decay_s. Internal: Re and
Im of the taps."""

from dataclasses import replace

import numpy as np

from ..columns import Lags
from ..scene import Path
from .base import LINK, PROBE, Family, Multiplicity, start

SIZES = (8, 16, 32, 64)


class DiffuseTail(Family):
    name = "diffuse_tail"
    owners = ("link",)
    multiplicity = Multiplicity.ONE
    stage = LINK
    flexible = True
    linear = True
    row_of_taps = True
    least_error = {"decay_s": 0.15, "power_db": 0.3}

    def apply(self, chain, effect):
        taps = effect.p[::2] + 1j * effect.p[1::2]
        first = effect.aux["first"]
        if taps.any():
            chain.paths.append(Path(source=effect.aux["source"], delay=first, gain=1.0, shape=taps))

    def nest(self, scene, effect):
        size = 2 * max(s for s in SIZES if s <= max(scene.count // 12, SIZES[0]))
        return (
            effect.aux["source"],
            replace(effect, p=np.zeros(size), free=np.ones(size, bool), prior=None),
            np.arange(len(effect.p)),
        )

    def columns(self, scene, effect, chain, before, rest):
        one = before.copy()
        one.paths.append(Path(source=effect.aux["source"], delay=effect.aux["first"], gain=PROBE))
        unit = (rest(one, effect).y - chain.y) / PROBE
        return Lags(signals=unit[None], entries=tuple((0, k) for k in range(len(effect.p) // 2)), paired=chain.facing)

    def starts(self, view):
        for i in range(len(view.scene.sources)):
            first = min(t.delay for t in view.scene.taps if t.source == i) + 1.0
            for size in SIZES:
                unknown = not all(s.known.all() for s in view.scene.sources)
                if size > view.scene.count // 12 or (unknown and size > 24):
                    continue
                k = np.repeat(np.arange(size), 2)
                yield start(
                    self,
                    np.zeros(2 * size),
                    prior=np.exp(-3.0 * k / size),
                    aux={"source": i, "first": first},
                    trials=len(SIZES),
                )

    def values(self, scene, effect, p):
        power = p[::2] ** 2 + p[1::2] ** 2
        decay = effect.aux.get("decay", len(power) / 3.0)
        return {"decay_s": decay / scene.sample_rate_hz, "power_db": 10 * np.log10(power.sum() + 1e-30)}

    def parse(self, scene, parameters, model):
        taps = model.get("taps", [0.0, 0.0])
        return start(
            self,
            taps,
            aux={
                "source": model.get("source", 0),
                "first": model.get("first", 1.0),
                "decay": parameters["decay_s"] * scene.sample_rate_hz,
            },
        )

    def model(self, scene, effect):
        return {"first": float(effect.aux["first"]), "taps": [float(v) for v in effect.p]}

    def delays(self, scene, effect):
        return (effect.aux["first"] + len(effect.p) / 2,)

    def where(self, scene, effect, values):
        first = effect.aux["first"] / scene.sample_rate_hz
        return {"delay_s": [first, first + 3 * values["decay_s"]]}

    def describe(self, number):
        return f"A diffuse tail that the twin leaves out: {number('power_db')} in all, falling by e in {number('decay_s')}."
