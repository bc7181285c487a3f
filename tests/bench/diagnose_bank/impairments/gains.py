# SPDX-License-Identifier: GPL-3.0-or-later
"""Gain over time: steps, drifts, hum."""

import numpy as np
from gnuradio import analog, blocks, filter

from .. import flow
from .family import Family, level_db, repeats, value


def _step_draw(rng, c):
    return {"at": int(c.count * rng.uniform(0.2, 0.8)), "sign": int(rng.choice([-1, 1]))}


def _step(x, s, d, c):
    at = c.first + d["at"]
    mux = blocks.stream_mux(8, [at, len(x) - at])
    return flow.combine(mux, x[:at], flow.through(x[at:], blocks.multiply_const_cc(1 + d["sign"] * s)))


def _step_truth(s, d, c):
    at = d["at"] / c.rate
    return (
        {"time_s": value(at, z=False), "step_db": value(level_db(1 + d["sign"] * s))},
        {},
        {"time_s": [at, at]},
    )


def _drift_draw(rng, c):
    return {"alpha": float(1 / (c.count * rng.uniform(0.12, 0.5))), "sign": int(rng.choice([-1, 1]))}


def _drift_path(s, d, c, count):
    """1 + s·(1 − e^{−t/τ}) from t = 0 by `single_pole_iir_filter_ff`."""
    steps = np.concatenate([np.zeros(c.first), np.ones(count - c.first)])
    return 1 + d["sign"] * s * flow.through_real(steps, filter.single_pole_iir_filter_ff(d["alpha"], 1))


def _drift(x, s, d, c):
    return flow.multiply(x, _drift_path(s, d, c, len(x)))


def _drift_truth(s, d, c):
    total = level_db(_drift_path(s, d, c, c.first + c.count)[-1])
    tau = -1 / np.log1p(-d["alpha"]) / c.rate
    limit = level_db(1 + d["sign"] * s)
    return {"total_db": value(total, also=(limit,)), "time_constant_s": value(tau, z=False)}, {}, {}


def _hum_draw(rng, c):
    lines = [f for f in (50, 60, 100, 120, 300, 360, 400, 800, 1000, 1200, 5000, 20e3, 100e3) if 3 <= f * c.duration <= 200]
    return {"frequency_hz": float(rng.choice(lines)), "phase": float(rng.uniform(0, 6.28))}


def _hum(x, s, d, c):
    phase = d["phase"] - 2 * np.pi * d["frequency_hz"] * c.first / c.rate
    source = analog.sig_source_f(c.rate, analog.GR_COS_WAVE, d["frequency_hz"], s, 1.0, float(phase % (2 * np.pi)))
    return flow.multiply(x, flow.samples_real(source, len(x)))


def _hum_truth(s, d, c):
    return {"frequency_hz": value(d["frequency_hz"]), "depth": value(s)}, {}, {}


FAMILIES = (
    Family(
        name="gain_step",
        level="either",
        stage="tx",
        draw=_step_draw,
        act=_step,
        truth=_step_truth,
        fits=repeats,
    ),
    Family(
        name="gain_drift",
        level="either",
        stage="tx",
        draw=_drift_draw,
        act=_drift,
        truth=_drift_truth,
        fits=repeats,
    ),
    Family(
        name="power_supply_hum",
        level="either",
        stage="tx",
        draw=_hum_draw,
        act=_hum,
        truth=_hum_truth,
        fits=lambda c: repeats(c) and c.duration > 1e-4,
    ),
)
