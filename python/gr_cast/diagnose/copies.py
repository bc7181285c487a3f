# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether what is left holds once more what is sent: late, mirrored, or on another carrier. Such a copy hides from every map of
powers, for it is where the signal is: noise that follows the signal, or several effects together, are as strong there."""

import numpy as np
from scipy import fft as sp_fft

from ..twin.effects import is_coarse
from .fit import Fit, within
from .policy import COPY_BESIDE, COPY_LAGS
from .residual import Leftover, bonferroni, normal


def left(fit: Fit, inside: np.ndarray) -> list[Leftover]:
    """The likeliest copy in the samples `inside` (n,) bool; none behind a coarse quantiser, whose error is the signal's own."""
    if any(is_coarse(e) for e in fit.model.effects) or inside.sum() <= 2 * COPY_BESIDE:
        return []
    fit = within(fit, inside)
    data, scene = fit.data, fit.data.scene
    residual, root = scene.spread(normal(fit)), scene.spread(data.root)
    sent = scene.spread(data.even(fit.chain.wanted, np.ones(len(inside), bool)))
    lags = range(-COPY_LAGS, COPY_LAGS + 1)
    found = [(*line(residual, root * np.roll(copy, lag)), lag, copy is sent) for lag in lags for copy in (sent, np.conj(sent))]
    log_p, nats, cycles, lag, upright = min(found)
    p_value = bonferroni(log_p, len(found) * len(residual))
    whose = "what is sent" if upright else "what is sent, mirrored,"
    test = f"{whose} once more, {lag} samples late and {cycles * scene.sample_rate_hz:.6g} Hz beside"
    return [Leftover(test=test, p_value=p_value, nats=nats, where={}, record_next="second_link")]


def line(residual: np.ndarray, copy: np.ndarray) -> tuple[float, float, float]:
    """(ln of the probability that chance has so much at one carrier, nats there, cycles per sample) of the likeliest carrier of a
    copy. Chance is what other carriers beside have: what is left may have a colour, and copies are like each other."""
    size = sp_fft.next_fast_len(len(copy))
    spectrum = sp_fft.fft((residual * np.conj(copy)).astype(np.complex64), size)
    power = spectrum.real**2 + spectrum.imag**2
    around = np.pad(power, COPY_BESIDE, mode="wrap").cumsum(dtype=float)
    count = 2 * COPY_BESIDE
    beside = (around[count:] - np.append(0.0, around[: -count - 1]) - power) / count
    over = power / np.maximum(count * beside, 1e-300)
    k = int(np.argmax(over))
    nats = power[k] / max(float(np.vdot(copy, copy).real), 1e-300)
    return -count * float(np.log1p(over[k])), float(nats), float(sp_fft.fftfreq(size)[k])
