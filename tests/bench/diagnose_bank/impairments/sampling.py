# SPDX-License-Identifier: GPL-3.0-or-later
"""Lost and inserted samples, inverted spectrum."""

from gnuradio import blocks

from .. import flow
from .family import Family, draw_nothing, static, value


def _loss_draw(rng, c):
    period = len(c.waveform.samples) if c.waveform.repeat else 400
    lost = int(rng.integers(1, min(200, period // 2 - 2))) * int(rng.choice([-1, 1]))
    return {"at": int(c.count * rng.uniform(0.15, 0.85)), "lost": lost}


def _loss(x, s, d, c):
    """Lost samples by `skiphead`; inserted ones repeat what was just recorded; `stream_mux` joins them."""
    if not s:
        return x
    at = c.first + d["at"]
    rest = flow.through(x, blocks.skiphead(8, at + d["lost"]))
    return flow.combine(blocks.stream_mux(8, [at, len(rest)]), x[:at], rest)


def _loss_truth(s, d, c):
    at = d["at"] / c.rate
    period = len(c.waveform.samples)
    also = (d["lost"] + period, d["lost"] - period) if c.waveform.repeat else ()
    return (
        {"time_s": value(at, z=False), "samples": value(d["lost"], z=False, also=also)},
        {},
        {"time_s": [at, at]},
    )


def _invert(x, s, d, c):
    return flow.same_length(x, blocks.conjugate_cc()) if s else x


FAMILIES = (
    Family(
        name="sample_loss",
        level="rx",
        stage="late",
        draw=_loss_draw,
        act=_loss,
        truth=_loss_truth,
        fixed=True,
        start=1.0,
    ),
    Family(
        name="spectral_inversion",
        level="rx",
        stage="rx",
        draw=draw_nothing,
        act=_invert,
        truth=lambda s, d, c: ({}, {}, {}),
        fixed=True,
        start=1.0,
        fits=lambda c: not c.waveform.real and static(c),
    ),
)
