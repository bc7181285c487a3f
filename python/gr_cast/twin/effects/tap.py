# SPDX-License-Identifier: GPL-3.0-or-later
"""What the families of a twin's tap share: one start per tap, and where it is."""

from .base import LINK, Family

NEXT = 3  # strongest taps but one, of which one may be found where that one was looked for


class TapFamily(Family):
    owners = ("link",)
    stage = LINK

    def _tap_of(self, scene, parameters, model) -> int:
        """Index of the twin's tap nearest to delay_s on the link of source model['source']."""
        delay = parameters.get("delay_s", 0.0) * scene.sample_rate_hz
        source = model.get("source", 0)
        return min(
            (k for k, t in enumerate(scene.taps) if t.source == source),
            key=lambda k: abs(scene.taps[k].delay - delay),
        )

    def _others(self, scene):
        """[(index of the strongest tap, samples by which each of the next strongest ones is later)] of one transmitter."""
        if len(scene.sources) == 1:
            k, *others = sorted(range(len(scene.taps)), key=lambda k: -abs(scene.taps[k].gain))
            yield from ((k, scene.taps[other].delay - scene.taps[k].delay) for other in others[:NEXT])

    def _delay_of(self, scene, effect) -> float:
        return scene.taps[effect.aux["tap"]].delay / scene.sample_rate_hz

    def resolution(self, scene, name, value):
        return 0.0 if name == "delay_s" else super().resolution(scene, name, value)  # the tap's own

    def where(self, scene, effect, values):
        return around(scene, self._delay_of(scene, effect))


def around(scene, delay_s: float) -> dict:
    """The cell of one sample to either side of a delay."""
    return {"delay_s": [delay_s - 1 / scene.sample_rate_hz, delay_s + 1 / scene.sample_rate_hz]}
