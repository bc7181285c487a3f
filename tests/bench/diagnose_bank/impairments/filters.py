# SPDX-License-Identifier: GPL-3.0-or-later
"""Front-end filters: roll-off, one pole, ripple."""

import numpy as np
from gnuradio import filter

from .. import flow
from .family import Family, value


def _filter_draw(rng, c):
    kind = str(rng.choice(["low_pass", "one_pole", "ripple"]))
    return {
        "kind": kind,
        "cut": float(rng.uniform(0.15, 0.3)),
        "alpha": float(rng.uniform(0.3, 0.7)),
        "lag": int(rng.integers(3, 7)),
        "phase": float(rng.uniform(-3, 3)),
    }


def _filter_wet(x, d):
    """The filtered part, delayed like `_FILTER_DELAY` samples of the direct part."""
    if d["kind"] == "low_pass":
        return flow.through(x, filter.fir_filter_ccf(1, filter.firdes.low_pass(1, 1, d["cut"], 0.15)[:]))
    if d["kind"] == "one_pole":
        return flow.through(x, filter.single_pole_iir_filter_cc(d["alpha"], 1))
    taps = np.zeros(2 * d["lag"] + 1, complex)
    taps[0], taps[-1] = np.exp(1j * d["phase"]) / 2, np.exp(-1j * d["phase"]) / 2
    return flow.through(x, filter.fir_filter_ccc(1, taps.tolist()))


def _filter_delay(d):
    if d["kind"] == "low_pass":
        return len(filter.firdes.low_pass(1, 1, d["cut"], 0.15)) // 2
    return d["lag"] if d["kind"] == "ripple" else 0


def _front_end(x, s, d, c):
    dry = np.concatenate([np.zeros(_filter_delay(d)), x])[: len(x)]
    if d["kind"] == "ripple":
        return flow.add(dry, s * _filter_wet(x, d))
    return flow.add((1 - s) * dry, s * _filter_wet(x, d))


def _front_end_truth(s, d, c):
    pulse = np.zeros(4096, complex)
    pulse[256] = 1
    response = 20 * np.log10(np.abs(np.fft.fft(_front_end(pulse, s, d, c))) + 1e-12)
    spectrum = np.abs(np.fft.fft(np.resize(c.waveform.samples, 4096) * np.hanning(4096))) ** 2
    smooth = np.convolve(np.r_[spectrum[-32:], spectrum, spectrum[:32]], np.ones(65) / 65, "valid")
    ripples = [np.ptp(response[smooth > smooth.max() * share]) for share in (0.05, 0.01, 0.25)]
    return {"ripple_db": value(ripples[0], z=False, also=ripples[1:], unsigned=True)}, {}, {}


FAMILIES = (
    Family(
        name="front_end_filter",
        level="either",
        stage="rx",
        draw=_filter_draw,
        act=_front_end,
        truth=_front_end_truth,
        same_as=("extra_path_within_sample",),
    ),
)
