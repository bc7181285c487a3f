# SPDX-License-Identifier: GPL-3.0-or-later
"""The law of the noise: maximum-likelihood strengths of the noise families on a residual.

With e = |r|²/σ² of circular Gaussian noise every test compares −Σ ln v − Σ e/v for a shape v against v = 1.
"""

import numpy as np
from scipy import fft as sp_fft
from scipy.optimize import minimize_scalar
from scipy.stats import gamma

from ..effects import FAMILIES
from ..effects.base import start
from .fit import shape_of_receiver
from .view import _peaks


def _profile(energy: np.ndarray, shape: np.ndarray) -> float:
    """ln L of a variance shape with the level at its best."""
    return float(-np.log(shape).sum() - len(energy) * (np.log(np.mean(energy / shape)) + 1))


def _two_levels(n_on, e_on, n, e):
    """Gain in ln L of two levels over one, for `n_on` samples of energy `e_on` out of all; arrays."""
    n_off, e_off = n - n_on, e - e_on
    ok = (n_on > 0) & (n_off > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = n * np.log(e / n) - n_on * np.log(e_on / n_on) - n_off * np.log(e_off / n_off)
    return np.where(ok & (e_on * n_off > e_off * n_on), gain, 0.0)


def _energy(fit) -> np.ndarray:
    """(n,) energy of the residual over what the receiver's gain and quantiser make of even noise."""
    shape = shape_of_receiver(fit, fit.model)
    return np.abs(fit.residual) ** 2 / (1.0 if shape is None else shape)


def signal_dependent(fit):
    """(gain in nats, effect) of noise that follows the wanted power."""
    use = fit.data.use > 0
    energy = _energy(fit)[use]
    w = np.abs(fit.chain.wanted[use]) ** 2
    w = w / max(w.mean(), 1e-300)
    flat = _profile(energy, np.ones_like(energy))
    best = minimize_scalar(
        lambda k: -_profile(energy, 1 + np.exp(k) * w),
        bounds=(-7, 7),
        method="bounded",
        options={"xatol": 1e-3},
    )
    family = FAMILIES["signal_dependent_noise"]
    return -best.fun - flat, start(family, [best.x], free=[False])


def told_floor(energy: np.ndarray, power: np.ndarray) -> tuple[float, float]:
    """(ln strength, ln L) of noise 1 + k·power, `energy` and `power` relative to a floor that is known and
    to their mean."""

    def cost(k):
        v = 1 + np.exp(k) * power
        return float(np.log(v).sum() + (energy / v).sum())

    best = minimize_scalar(cost, bounds=(-9, 7), method="bounded", options={"xatol": 1e-3})
    return float(best.x), -float(best.fun)


def impulsive(fit):
    """(gain, effect) of a mixture: a share p of samples with 1 + k times the power."""
    use = fit.data.use > 0
    e = _energy(fit)[use]
    core = np.median(e) / np.log(2)
    e = e / core
    p, k = 0.01, 30.0
    if (e > 9).sum() < 3:
        return 0.0, None
    for _ in range(60):
        heavy = p / (1 + k) * np.exp(np.clip(-e / (1 + k), -700, 0))
        light = (1 - p) * np.exp(np.clip(-e, -700, 0))
        share = heavy / (heavy + light + 1e-300)
        p = float(np.clip(share.mean(), 1e-7, 0.5))
        level = (e * (1 - share)).sum() / (1 - share).sum()
        e, k = e / level, max(float((share * e / level).sum() / share.sum()) - 1, 0.5)
    mixture = np.log((1 - p) * np.exp(-e) + p / (1 + k) * np.exp(-e / (1 + k))).sum()
    gain = mixture + len(e) * (np.log(e.mean()) + 1)
    if p > 0.2:
        return 0.0, None
    return gain, start(FAMILIES["impulsive_noise"], [np.log(k), np.log(p)], free=[False] * 2)


def pulsed(fit, near: float | None = None):
    """(gain, effect) of two levels of noise that alternate periodically; `near`: a period in samples that
    is known."""
    scene, use = fit.data.scene, fit.data.use > 0
    n = scene.count
    e = np.where(use, _energy(fit), 0.0)
    total, count = e.sum(), use.sum()
    mean = total / count
    if n < 2000:
        return 0.0, None
    if near is not None:
        gain, p = _fold(e, use, near, n, total, count, scales=(0.5, 0.1))
        return (0.0, None) if p is None else (gain, start(FAMILIES["pulsed_interference"], p, free=[False] * 4, trials=2e4))
    q = np.where(use, np.minimum(e / mean, 8.0), 0.0)
    q = np.where(use, q - q.sum() / count, 0.0)
    pad = 4
    spectrum = np.abs(sp_fft.rfft(q, pad * n)) ** 2
    spectrum /= np.median(spectrum[1:]) / np.log(2)
    f = np.arange(6 * pad, min(n // 8, 4000) * pad)
    periods, comb = [], np.zeros(len(f))
    for h in range(1, 17):
        at = f * h
        ok = at < len(spectrum)
        comb[ok] += spectrum[at[ok]]
        if h in (1, 2, 4, 8, 16):
            surprise = -gamma.logsf(comb, h)  # of so much power in h harmonics of white noise
            periods += [(surprise[i], pad * n / f[i]) for i in _peaks(surprise, 2, 3) if surprise[i] > np.log(len(f)) + 4]
    periods = [p for _, p in sorted(periods, reverse=True)[:4]]
    top = (0.0, None)
    for period in periods:
        for divisor in (1, 2, 3, 4, 5, 6):
            found = _fold(e, use, period / divisor, n, total, count)
            if found[0] > top[0] * 1.001:
                top = found
    gain, p = top
    if p is None:
        return 0.0, None
    return gain, start(FAMILIES["pulsed_interference"], p, free=[False] * 4, trials=2e4)


def _fold(e, use, period, n, total, count, scales=(1.0, 0.15)):
    """Best two-level window of the energy folded at periods near `period`: (gain, [ln ratio, period, first,
    duty])."""
    best = (0.0, None)
    width = 64
    step = period * period / n / width
    for scale in scales:
        centre = period if best[1] is None else best[1][1]
        for k in range(-8, 9):
            p = centre + k * step * scale
            if p < 4:
                continue
            bins = int(min(width if scale == 1.0 else 256, max(8, p)))
            at = ((np.arange(n) / p) % 1.0 * bins).astype(int)
            folded, hits = np.bincount(at, e, bins), np.bincount(at, use, bins)
            e2, h2 = (
                np.cumsum(np.concatenate([[0], folded, folded])),
                np.cumsum(np.concatenate([[0], hits, hits])),
            )
            lengths = np.unique(np.geomspace(1, bins // 2, 24).astype(int)) if bins > 64 else np.arange(1, bins // 2 + 1)
            for length in lengths:
                e_on, n_on = e2[length : length + bins] - e2[:bins], h2[length : length + bins] - h2[:bins]
                gain = _two_levels(n_on, e_on, count, total)
                i = int(np.argmax(gain))
                if gain[i] > best[0]:
                    off = (total - e_on[i]) / (count - n_on[i])
                    ratio = e_on[i] / n_on[i] / off - 1
                    best = (float(gain[i]), [np.log(max(ratio, 1e-3)), p, i / bins * p, length / bins])
    return best


def narrowband(fit):
    """(gain, effect) of noise that is stronger in one band."""
    data = fit.data
    r = fit.residual * data.root**2
    power = np.abs(sp_fft.fft(r)) ** 2
    n = len(power)
    cells = int(min(256, n // 16))
    edges = np.linspace(0, n, cells + 1).astype(int)
    energy = np.add.reduceat(power, edges[:-1])
    size = np.diff(edges)
    e2, n2 = np.cumsum(np.concatenate([[0], energy, energy])), np.cumsum(np.concatenate([[0], size, size]))
    best = (0.0, 0, 1)
    for length in range(1, cells // 2):
        gain = _two_levels(
            n2[length : length + cells] - n2[:cells],
            e2[length : length + cells] - e2[:cells],
            n,
            energy.sum(),
        )
        i = int(np.argmax(gain))
        if gain[i] > best[0]:
            best = (float(gain[i]), i, length)
    gain, i, length = best
    share = data.count / n
    if gain * share < 20:
        return 0.0, None
    on_e, on_n = e2[i + length] - e2[i], n2[i + length] - n2[i]
    ratio = on_e / on_n / ((energy.sum() - on_e) / (n - on_n)) - 1
    low = edges[i % cells] / n
    width = on_n / n
    centre = (low + width / 2 + 0.5) % 1.0 - 0.5
    effect = start(
        FAMILIES["narrowband_interference"],
        [np.log(max(ratio, 1e-3)), centre, width],
        free=[False] * 3,
        trials=cells**2 / 2,
    )
    return gain * share, effect


FINDERS = {
    "signal_dependent_noise": signal_dependent,
    "impulsive_noise": impulsive,
    "pulsed_interference": pulsed,
    "narrowband_interference": narrowband,
}
HIDDEN = {
    "signal_dependent_noise": 1,
    "impulsive_noise": 2,
    "pulsed_interference": 4,
    "narrowband_interference": 3,
}


def starts(fit):
    """[(net gain in nats, effect)] of every noise family that is not in the model yet."""
    have = {e.family for e in fit.model.effects}
    if any(e.family == "quantization" and e.p[2] < 0.7 for e in fit.model.effects):
        return []  # behind a coarse quantiser the noise has no law of its own
    out = []
    for name, finder in FINDERS.items():
        if name in have or (have & set(FINDERS)):
            continue
        gain, effect = finder(fit)
        if effect is not None:
            cost = 0.5 * HIDDEN[name] * np.log(fit.data.count) + np.log(effect.trials)
            out.append((gain - cost, effect))
    return out
