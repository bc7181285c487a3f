# SPDX-License-Identifier: GPL-3.0-or-later
"""Carrier frequency offset, phase noise, sample clock offset."""

import numpy as np
from gnuradio import analog, blocks, channels, filter

from .. import flow
from .family import Family, draw_sign, grid_hz, value


def _cfo_draw(rng, c):
    big = rng.random() < 0.25
    drift = rng.random() < 0.3
    return {
        "sign": int(rng.choice([-1, 1])),
        "turns": float(rng.uniform(3, 60)) if big else 0.0,
        "drift_share": float(rng.uniform(-1.5, 1.5)) if drift else 0.0,
    }


def _cfo_hz(s, d, c):
    return grid_hz(d["sign"] * (s + d["turns"]) / c.duration, c.rate), d["drift_share"] * s / c.duration**2


def _cfo(x, s, d, c):
    offset, drift = _cfo_hz(s, d, c)
    if not drift:
        return flow.multiply(x, flow.oscillator(offset / c.rate, len(x), c.first))
    t = (np.arange(len(x)) - c.first) / c.rate
    phase = np.angle(np.exp(2j * np.pi * (offset * t + drift * t**2 / 2)))
    source = blocks.vector_source_f(phase.astype(np.float32))
    return flow.multiply(x, flow.samples_via(source, analog.phase_modulator_fc(1.0)))


def _cfo_truth(s, d, c):
    offset, drift = _cfo_hz(s, d, c)
    p = {"offset_hz": value(offset, also=(offset + drift * c.duration / 2,) if drift else ())}
    if drift:
        p["drift_hz_per_s"] = value(drift)
    return p, {}, {}


def _phase_noise_draw(rng, c):
    return {"alpha": float(10 ** rng.uniform(-3, -1.3)), "skip": int(rng.integers(0, 500_000))}


def _phase_noise_path(s, d, c, count):
    """The block's own e^{jφ}; its seed is fixed, so `skip` picks the stretch."""
    block = channels.phase_noise_gen(s / np.sqrt(d["alpha"] / (2 - d["alpha"])), d["alpha"])
    return flow.same_length(np.ones(d["skip"] + count), block)[d["skip"] :]


def _phase_noise(x, s, d, c):
    return flow.multiply(x, _phase_noise_path(s, d, c, len(x)))


def _phase_noise_truth(s, d, c):
    phase = np.unwrap(np.angle(_phase_noise_path(s, d, c, c.first + c.count)))[c.first :]
    n = np.arange(c.count)
    rest = phase - np.polyval(np.polyfit(n, phase, 1), n)
    return {"rms_rad": value(rest.std(), z=False)}, {}, {}


def _clock_block(s, d):
    block = filter.mmse_resampler_cc(0, 4 * (1 + d["sign"] * s))
    return block, block.resamp_ratio() / 4 - 1


def _clock(x, s, d, c):
    """Resampled by `mmse_resampler_cc` after a fourfold interpolator; t = 0 stays but for its delay."""
    block, ratio = _clock_block(s, d)
    up = filter.interp_fir_filter_ccf(4, filter.firdes.low_pass_2(4, 4, 0.46, 0.08, 90))
    y = flow.through(x, up, block)
    return np.concatenate([y, np.zeros(max(0, len(x) - len(y)))])[: len(x)]


def _clock_truth(s, d, c):
    return {"offset_ppm": value(_clock_block(s, d)[1] * 1e6, unsigned=True)}, {}, {}


FAMILIES = (
    Family(
        name="carrier_frequency_offset",
        level="either",
        stage="tx",
        draw=_cfo_draw,
        act=_cfo,
        truth=_cfo_truth,
        fits=lambda c: c.offset_known_hz == 0,
        start=0.05,
    ),
    Family(
        name="sample_clock_offset",
        level="rx",
        stage="clock",
        draw=draw_sign,
        act=_clock,
        truth=_clock_truth,
        start=2e-6,
        fits=lambda c: c.offset_known_hz == 0 and c.waveform.name in ("rrc", "rrc_qpsk", "burst") and c.snr_db <= 22,
    ),
    Family(
        name="phase_noise",
        level="either",
        stage="tx",
        draw=_phase_noise_draw,
        act=_phase_noise,
        truth=_phase_noise_truth,
        stochastic=True,
        start=0.01,
    ),
)
