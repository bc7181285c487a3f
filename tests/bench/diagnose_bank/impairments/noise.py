# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise other than the twin says."""

import numpy as np

from .. import channel, flow
from .environment import plus
from .family import Family, draw_seed, value


def _floor_path(s, d, c, count):
    """More noise than the twin says: power s·noise on top."""
    return flow.gaussian(count, s * c.noise, d["seed"])


def _floor_truth(s, d, c):
    return {"change_db": value(10 * np.log10(1 + s))}, {}, {}


def _signal_noise(x, s, d, c):
    level = np.abs(x) / np.sqrt(c.power)
    return flow.add(x, flow.multiply(flow.gaussian(len(x), s * c.noise, d["seed"]), level))


def _signal_noise_truth(s, d, c):
    return {"slope_db": value(10 * np.log10(s), z=False)}, {}, {}


def level_varies(c):
    """The wanted power moves enough to tell noise that follows it from noise that does not."""
    x = channel.predict(c.waveform, c.taps, rate=c.rate, delay=c.bulk, count=min(c.count, 20_000))
    p = np.abs(x) ** 2
    return p.std() > 0.4 * p.mean()


FAMILIES = (
    Family(
        name="noise_floor",
        level="rx",
        stage="air",
        draw=draw_seed,
        act=plus(_floor_path),
        truth=_floor_truth,
        stochastic=True,
        fits=level_varies,
    ),
    Family(
        name="signal_dependent_noise",
        level="rx",
        stage="air",
        draw=draw_seed,
        act=_signal_noise,
        truth=_signal_noise_truth,
        stochastic=True,
        fits=level_varies,
    ),
)
