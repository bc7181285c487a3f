# SPDX-License-Identifier: GPL-3.0-or-later
"""Pulses: on for a share of each period. Internal: ln of power while on over the floor; period and start in samples,
duty."""

import numpy as np
from scipy import fft as sp_fft

from ...core.tails import log_gamma_tail
from ..interpolate import within_turn
from .base import peaks, start
from .noise_family import REMEMBERED, NoiseFamily, two_levels
from .pulsed_carrier import PulsedCarrier

_TRIALS = 2e4  # periods, starts and lengths that differ
_FINEST, _COARSE = 2048, 256  # parts of a period by which edges are placed, and by which they are sought
_NEXT = 0.15  # of a duty, to the next one that is sought
_EDGE_NATS = 2.5  # of what tells a pulse from the noise, to which an edge is placed (Hinkley 1970)


class PulsedInterference(NoiseFamily):
    name = "pulsed_interference"
    parameters = PulsedCarrier.parameters
    remembered = REMEMBERED | PulsedCarrier.remembered
    owners = ("environment",)
    lasting = False
    _strengths = 4

    def gate(self, scene, effect):
        _, period, first, duty = effect.p
        return within_turn((scene.index - first) / period) < duty

    def variance(self, scene, effect, wanted):
        return 1 + np.exp(effect.p[0]) * self.gate(scene, effect)

    def in_time(self, scene, effect, later, longer):
        strength, period, first, duty = effect.p
        return effect.moved(np.array([strength, period, (first - later * scene.span) % period, duty]))

    def values(self, scene, effect, p):
        floor = effect.aux["_floor"]
        return {
            "period_s": p[1] / scene.sample_rate_hz,
            "duty_cycle": p[3],
            "power_dbc": 10 * np.log10(np.exp(p[0]) * floor / scene.wanted_rms**2),
        }

    def parse(self, scene, parameters, model):
        return (PulsedCarrier() if "carrier_hz" in model else super()).parse(scene, parameters, model)

    def _levels(self, scene, parameters, model, floor, rms):
        rate = scene.sample_rate_hz
        strength = np.log(10 ** (parameters["power_dbc"] / 10) * rms**2 / floor)
        return [strength, parameters["period_s"] * rate, model.get("first_s", 0.0) * rate, parameters["duty_cycle"]]

    def model(self, scene, effect):
        return {**super().model(scene, effect), "first_s": effect.p[2] / scene.sample_rate_hz}

    def describe(self, number):
        return f"Pulses every {number('period_s')}, on for {number('duty_cycle')} of it, {number('power_dbc')} while on."

    def find(self, view, near=None):
        use, n = view.use, len(view.use)
        e = np.where(use, view.energy, 0.0)
        total, count = e.sum(), use.sum()
        mean, held = total / count, {}
        if n < 2000:
            return 0.0, None
        if near is not None:
            gain, p = _fold(e, use, held, near.p[1], n, total, count, scales=(0.5, 0.1))
            return (0.0, None) if p is None else (gain, self._found(_edged(e, use, p), n))
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
                surprise = -log_gamma_tail(comb, h)  # of so much power in h harmonics of white noise
                periods += [(surprise[i], pad * n / f[i]) for i in peaks(surprise, 2, 3) if surprise[i] > np.log(len(f)) + 4]
        periods = [p for _, p in sorted(periods, reverse=True)[:4]]
        top = (0.0, None)
        for period in periods:
            for divisor in (1, 2, 3, 4, 5, 6):
                found = _fold(e, use, held, period / divisor, n, total, count)
                if found[0] > top[0] * 1.001 and _repeats(e, use, found[1]):
                    top = found
        if top[1] is None:
            return 0.0, None
        # Of a few slow pulses only harmonics stand out.
        slower = (
            _fold(e, use, held, top[1][1] * multiple, n, total, count) for multiple in (2, 3) if top[1][1] * multiple < n / 2
        )
        gain, p = max([top, *(found for found in slower if _repeats(e, use, found[1]))], key=lambda found: found[0])
        return gain, self._found(_edged(e, use, p), n)

    def _found(self, p, n):
        """The effect with the standard deviations of its numbers: of the level from the count of samples, of the period from the
        steps of the search, of the edges from what tells a pulse from the noise."""
        ratio, period, duty = np.exp(p[0]), p[1], p[3]
        edge = max(1.0, _EDGE_NATS / (ratio - np.log1p(ratio)) * period / n, period / _FINEST)  # of all pulses together
        edge = min(edge, period / np.sqrt(2))
        spread = [(1 + ratio) / ratio / np.sqrt(max(duty * n, 1.0)), period**2 / n / 128, edge, np.sqrt(2) * edge / period]
        return start(self, p, free=[False] * 4, trials=_TRIALS, aux={"_std": spread})


def _repeats(e, use, p) -> bool:
    """Whether pulses stand out without the strongest of them: one burst is no train."""
    if p is None:
        return False
    turn = (np.arange(len(e)) - p[2]) / p[1]
    on = use & (within_turn(turn) < p[3])
    pulse = np.floor(turn[on]).astype(int) + 1
    strongest = np.zeros_like(on)
    strongest[on] = pulse == np.bincount(pulse, e[on]).argmax()
    on, rest = on & ~strongest, use & ~strongest
    return two_levels(on.sum(), e[on].sum(), rest.sum(), e[rest].sum()) > np.log(_TRIALS)


def _fold(e, use, held, period, n, total, count, scales=(1.0, 0.15)):
    """Best two-level window of the energy folded at periods near `period`: (gain, [ln ratio, period, first,
    duty]); `held`: where `_blocks` keeps its own."""
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
            middle, energy, used = _blocks(e, use, int(p / (4 * bins)), held)
            at = (within_turn(middle / p) * bins).astype(int)
            folded, hits = np.bincount(at, energy, bins), np.bincount(at, used, bins)
            e2, h2 = (np.cumsum(np.concatenate([[0], x, x])) for x in (folded, hits))
            lengths = np.unique(np.geomspace(1, bins // 2, 24).astype(int)) if bins > 64 else np.arange(1, bins // 2 + 1)
            ends = lengths[:, None] + np.arange(bins)
            e_on, n_on = e2[ends] - e2[:bins], h2[ends] - h2[:bins]
            gain = two_levels(n_on, e_on, count, total)
            m, i = np.unravel_index(int(np.argmax(gain)), gain.shape)
            if gain[m, i] > best[0]:
                best = (float(gain[m, i]), [_ln_ratio(e_on[m, i], n_on[m, i], total, count), p, i / bins * p, lengths[m] / bins])
    return best


def _edged(e, use, p) -> list[float]:
    """The gate `p` with its edges where energy changes: the best two near where a search has them."""
    _, period, first, duty = p
    bins = int(np.clip(period, 8, _FINEST))
    at = np.minimum((within_turn((np.arange(len(e)) - first) / period) * bins).astype(int), bins - 1)
    folded, hits = (np.tile(np.bincount(at, x, bins), 3) for x in (e, use.astype(float)))
    e2, h2 = (np.cumsum(np.append(0.0, x)) for x in (folded, hits))
    reach = int(np.ceil(bins * (_NEXT * duty + 2 / _COARSE)))
    near = np.arange(-reach, reach + 1)
    begin, end = np.meshgrid(bins + near, bins + round(duty * bins) + near, indexing="ij")
    end = np.clip(end, begin + 1, begin + bins - 1)
    e_on, n_on = (x[end] - x[begin] for x in (e2, h2))
    total, count = folded.sum() / 3, hits.sum() / 3
    i, j = np.unravel_index(np.argmax(two_levels(n_on, e_on, count, total)), e_on.shape)
    first = (first + (begin[i, j] - bins) / bins * period) % period
    return [_ln_ratio(e_on[i, j], n_on[i, j], total, count), period, float(first), float(end[i, j] - begin[i, j]) / bins]


def _ln_ratio(e_on: float, n_on: float, total: float, count: float) -> float:
    """ln of the power while on over that while off."""
    off = (total - e_on) / (count - n_on)
    return float(np.log(max(e_on / n_on / off - 1, 1e-3)))


def _blocks(e, use, size, held):
    """(middles, energies, used samples) of blocks of about `size`, kept in `held`."""
    size = 1 << max(0, size.bit_length() - 1)
    if size not in held:
        first = np.arange(0, len(e), size)
        held[size] = first + 0.5 * (size - 1), np.add.reduceat(e, first), np.add.reduceat(use.astype(float), first)
    return held[size]
