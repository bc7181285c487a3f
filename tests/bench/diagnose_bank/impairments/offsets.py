# SPDX-License-Identifier: GPL-3.0-or-later
"""I/Q imbalance, DC offset, LO leakage."""

import numpy as np
from gnuradio import blocks, channels

from .. import flow
from .family import Family, draw_phase, level_db, repeats, turns, value


def _iq_draw(rng, c):
    angle = rng.uniform(0, 2 * np.pi)
    return {"gain": float(np.cos(angle)), "phase": float(np.sin(angle))}


def _iq_settings(s, d):
    return float(20 * np.log10(1 + s * d["gain"])), float(np.degrees(s * d["phase"]))


def _iq(mode):
    def act(x, s, d, c):
        magnitude_db, degrees = _iq_settings(s, d)
        return flow.same_length(x, channels.iqbal_gen(magnitude_db, degrees, mode))

    return act


def _iq_truth(s, d, c):
    magnitude_db, degrees = _iq_settings(s, d)
    r = 10 ** (magnitude_db / 20) * np.exp(1j * np.radians(degrees))
    return (
        {
            "image_rejection_db": value(-level_db((r - 1) / (r + 1))),
            "gain_imbalance_db": value(magnitude_db, z=False, unsigned=True),
            "phase_imbalance_rad": value(np.radians(degrees), z=False, unsigned=True),
        },
        {},
        {},
    )


def _dc(x, s, d, c):
    return flow.through(x, blocks.add_const_cc(complex(s * np.sqrt(c.power) * np.exp(1j * d["phase"]))))


def _leak_level(s, c):
    return s * np.sqrt(np.mean(np.abs(c.waveform.samples) ** 2)) * c.peak / np.max(np.abs(c.waveform.samples))


def _leak(x, s, d, c):
    return flow.through(x, blocks.add_const_cc(complex(_leak_level(s, c) * np.exp(1j * d["phase"]))))


def _level_truth(s, d, c):
    return {"level_dbc": value(level_db(s))}, {}, {}


FAMILIES = (
    Family(
        name="iq_imbalance",
        level="tx",
        stage="tx",
        draw=_iq_draw,
        act=_iq(0),
        truth=_iq_truth,
        fits=lambda c: not c.waveform.real,
    ),
    Family(
        name="iq_imbalance",
        level="rx",
        stage="rx",
        draw=_iq_draw,
        act=_iq(1),
        truth=_iq_truth,
        fits=lambda c: not c.waveform.real or turns(c) > 3,
    ),
    Family(
        name="dc_offset",
        level="rx",
        stage="rx",
        draw=draw_phase,
        act=_dc,
        truth=_level_truth,
        fits=lambda c: turns(c) > 3,
    ),
    Family(
        name="lo_leakage",
        level="tx",
        stage="tx",
        draw=draw_phase,
        act=_leak,
        truth=_level_truth,
        fits=lambda c: turns(c) > 3 and repeats(c),
    ),
)
