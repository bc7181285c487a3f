# SPDX-License-Identifier: GPL-3.0-or-later
"""Amplifier, clipping, quantisation."""

import numpy as np
from gnuradio import analog, channels

from .. import flow
from .family import Family, draw_nothing, level_db, shaped, value


def _pa_draw(rng, c):
    return {
        "memory": bool(rng.random() < 0.35),
        "angle": float(rng.uniform(-0.6, 0.6)),
        "later": float(rng.uniform(0.5, 0.9) * rng.choice([-1, 1])),
    }


def _pa(x, s, d, c):
    """x + β|x|²x by `distortion_3_gen`, compressing; with memory a second one acts on the sample before."""
    beta = complex(-s / c.peak**2 * np.exp(1j * d["angle"]))
    y = flow.same_length(x, channels.distortion_3_gen(beta))
    if d["memory"]:
        before = np.concatenate([[0], x[:-1]])
        cubic = flow.same_length(before, channels.distortion_3_gen(beta * d["later"])) - before
        y = flow.add(y, cubic)
    return y


def _pa_truth(s, d, c):
    both = 1 + (d["later"] if d["memory"] else 0)
    compression = -level_db(1 - s * np.exp(1j * d["angle"]) * both)
    alone = -level_db(1 - s * np.exp(1j * d["angle"]))
    return (
        {"compression_db": value(compression, z=False, also=(alone,), unsigned=True)},
        {"memory": d["memory"]},
        {},
    )


def _clip_level(s, c):
    return c.rms_peak * np.exp(-s)


def _clip(x, s, d, c):
    level = _clip_level(s, c)
    return flow.on_rails(x, lambda: analog.rail_ff(-level, level))


def _clip_truth(s, d, c):
    return {"level": value(_clip_level(s, c))}, {}, {}


def _bits_draw(rng, c):
    step = np.sqrt(6 * c.noise * 10 ** rng.uniform(-0.3, 1.2))
    return {"bits": int(np.clip(round(1 - np.log2(step)), 3, 12))}


def _quantize(x, s, d, c):
    return flow.on_rails(x, lambda: channels.quantizer(d["bits"])) if s else x


def _quantize_truth(s, d, c):
    return {"step": value(2.0 ** (1 - d["bits"]))}, {}, {}


FAMILIES = (
    Family(
        name="pa_nonlinearity",
        level="tx",
        stage="tx",
        draw=_pa_draw,
        act=_pa,
        truth=_pa_truth,
        fits=shaped,
    ),
    Family(
        name="adc_clipping",
        level="rx",
        stage="late",
        draw=draw_nothing,
        act=_clip,
        truth=_clip_truth,
        start=0.1,
        fits=lambda c: shaped(c) and c.snr_db >= 12,
    ),
    Family(
        name="quantization",
        level="rx",
        stage="late",
        draw=_bits_draw,
        act=_quantize,
        truth=_quantize_truth,
        fixed=True,
        fits=lambda c: c.snr_db >= 12,
        start=1.0,
    ),
)
