# SPDX-License-Identifier: GPL-3.0-or-later
"""What is left after a fit: maps of the residual over time × frequency, delay × time, amplitude and place
in the code, and
whether any cell of them holds more than noise. Cells are normalised to unit mean under noise alone.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft as sp_fft
from scipy import stats

from ..core.tails import log_gamma_tail
from ..twin.effects import FAMILIES, is_coarse
from ..twin.effects.base import around_circle, at_half_the_rate
from .fit import within
from .policy import (
    CROWDED_P,
    FEWEST_TRAINS,
    FOREIGN,
    FOREIGN_CELLS,
    HEARD,
    LARGEST_TRAIN,
    LEAST_CELL,
    LEAST_COLOUR,
    LEAST_IMPULSES,
    LEAST_WINDOW,
    LONGEST_IMPULSE,
    LONGEST_SPARK,
    MOST_SPARKS,
    SURELY_COLOURED,
    TOGETHER,
    TWIN_FITS,
    WINDOWS,
)
from .view import View


@dataclass(frozen=True, kw_only=True)
class Leftover:
    """`p_value` of the worst cell after the number of cells, `nats` it holds, `where` it is (axis → interval), what to record
    next to learn more of it: most of all whether it is there without the signal; whether it is `apart`, in samples that took no
    part in any fit."""

    test: str
    p_value: float
    nats: float
    where: dict
    record_next: str = "mute_transmitter"
    apart: bool = False


def _gamma_cells(energy: np.ndarray, count: np.ndarray):
    """ln of the probability that noise alone gives a cell of `count` samples this much or more, and its
    nats of excess."""
    count = np.maximum(count, 1e-9)
    mean = energy / count
    log_p = log_gamma_tail(energy, count)
    nats = np.where(mean > 1, count * (mean - 1 - np.log(np.maximum(mean, 1e-12))), 0.0)
    return log_p, nats


def time_frequency(fit, rows: int = 48, bins: int = 32):
    """(rows, bins) energy over expectation of the normalised residual, samples behind each cell, and (rows + 1,) edges of
    the rows in samples; the last block of `bins` samples may be short, and every sample is in one."""
    used, n = fit.data.use > 0, fit.data.scene.count
    blocks = -(-n // bins)
    rows = min(rows, blocks)
    r, used = (np.pad(x, (0, blocks * bins - n)).reshape(blocks, bins) for x in (normal(fit), used))
    first = np.arange(rows) * blocks // rows
    power = np.abs(sp_fft.fft(r, axis=1)) ** 2 / bins
    count = np.add.reduceat(used.mean(1), first)
    return np.add.reduceat(power, first), np.repeat(count[:, None], bins, 1), np.append(first * bins, n)


def told_cells(fit):
    """`time_frequency` with what is not told as even as noise is: bands, and the colours of what comes and goes."""
    energy, count, edges = time_frequency(fit)
    level, few = of_pulses(fit, energy, count, edges)
    energy, count = few * energy / level, few * count
    untold = bands_not_told(fit, np.fft.fftfreq(energy.shape[1]), energy.shape[1])
    energy[:, untold] = count[:, untold]
    return energy, count, edges


def of_pulses(fit, energy: np.ndarray, count: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(rows, bins) what cells of rows between `edges` (rows + 1,) hold over what they should, for what comes and goes has its own
    colour: that, and the colour without, are those of least squares, as far as rows differ enough to tell. And of a cell's
    samples, whose levels differ, the share as which it spreads."""
    level, few, used = np.ones_like(energy), np.ones_like(energy), fit.data.use > 0
    for e in fit.model.found:
        if (gate := FAMILIES[e.family].gate(fit.data.scene, e)) is None:
            continue
        on, all_ = (np.add.reduceat(x.astype(float), edges[:-1]) for x in ((gate & used)[: edges[-1]], used[: edges[-1]]))
        on = (on / np.maximum(all_, 1))[:, None]
        more, spread = _coloured(energy / level, count, on, fit.data.spectrum is not None)
        level, few = level * more, few * spread
    return level, few


def _coloured(energy: np.ndarray, count: np.ndarray, on: np.ndarray, is_white: bool) -> tuple[np.ndarray, np.ndarray]:
    """The same of one that is on for a share `on` (rows, 1) of each row; ones where no colour of its own shows. `is_white`: all
    rows together are, else what they hold is measured by what is there while it is off."""
    total, bins = np.maximum(count.sum(0), 1e-300), energy.shape[1]
    mean, middle = energy.sum(0) / total, (count * on).sum(0) / total
    told = (count * (on - middle) ** 2).sum(0)  # samples that tell on from off
    slope = ((on - middle) * (energy - count * mean)).sum(0) / (told + 1) / np.maximum(mean, 1e-300)
    if (slope**2 * told).sum() < bins + SURELY_COLOURED * np.sqrt(2 * bins):
        return np.ones_like(energy), np.ones_like(energy)
    off, own = (np.maximum(1 + slope * (at - middle), LEAST_COLOUR) for at in (0, 1))
    colour = np.clip(own / off, LEAST_COLOUR, 1 / LEAST_COLOUR)
    level = 1 + on * (colour - 1)
    few = level**2 / (1 + on * (colour**2 - 1))
    if is_white:
        return level * total / np.maximum((count * level).sum(0), 1e-300), few
    return level, few * told / (told + total * middle**2)  # the level while off is no better known


def leftovers(fit, inside) -> list[Leftover]:
    """The worst cell of every map of the samples `inside` (n,) bool, worst first."""
    fit, scene, out = within(fit, inside), fit.data.scene, []
    if not inside.any():
        return []
    energy, count, edges = told_cells(fit)
    if coarse := any(is_coarse(e) for e in fit.model.effects):
        # Rare steps instead of noise: as many Gaussian samples as would make energies spread as much.
        power = np.abs(normal(fit)[inside]) ** 2
        spread = max(1.0, float(np.var(power) / np.mean(power) ** 2))
        energy, count = energy / spread, count / spread
    rows, bins = energy.shape
    t = np.append(scene.index, scene.index[-1] + 1)[edges] / scene.sample_rate_hz
    for name, e, c in (
        ("time × frequency", energy, count),
        ("time", energy.sum(1, keepdims=True), count.sum(1, keepdims=True)),
        ("frequency", energy.sum(0, keepdims=True), count.sum(0, keepdims=True)),
    ):
        log_p, nats = _gamma_cells(e, c)
        i, j = np.unravel_index(int(np.argmin(log_p)), log_p.shape)
        where = {}
        if e.shape[0] > 1:
            where["time_s"] = [float(t[i]), float(t[i + 1])]
        if e.shape[1] > 1:
            f = np.fft.fftfreq(bins)[j] * scene.sample_rate_hz
            where["frequency_hz"] = [
                float(f - scene.sample_rate_hz / bins / 2),
                float(f + scene.sample_rate_hz / bins / 2),
            ]
        out.append(
            Leftover(
                test=name,
                p_value=bonferroni(log_p[i, j], e.size),
                nats=float(nats.sum() if e.size < 100 else nats[i, j]),
                where=where,
            )
        )
    if not coarse:
        out.append(_place_in_code(fit))
        out.append(_amplitude(fit, inside))
    return sorted((o for o in out if o is not None), key=lambda o: o.p_value)


def bands_not_told(fit, f: np.ndarray, bins: int) -> np.ndarray:
    """Of bands around `f` (k,), 1/`bins` of the rate wide, (k,) bool: what a found narrowband interference reaches, with skirts
    of half its width, for how its density falls off there is not part of its law; and half the sample rate."""
    untold = at_half_the_rate(f)
    for e in fit.model.found:
        if band := FAMILIES[e.family].band(e):
            middle, width = band
            untold |= around_circle(f, middle) < width + 0.5 / bins
    return untold


def bonferroni(log_p: float, cells: int) -> float:
    """The p-value of the rarest of so many cells, none of which chance has with more than `log_p` (its ln)."""
    return float(min(1.0, np.exp(min(0.0, log_p + np.log(cells)))))


def normal(fit) -> np.ndarray:
    """(n,) the residual as recorded, made white and of unit power."""
    return fit.data.whitened(fit.residual) / np.sqrt(fit.sigma2)


def _place_in_code(fit) -> Leftover | None:
    """A residual that repeats with the code: energy of its mean over periods."""
    source = fit.data.scene.sources[0]
    period = len(source.samples)
    if not source.repeat or fit.data.scene.count < 4 * period:
        return None
    lo = View(fit).carrier
    turned = fit.came(normal(fit)) * np.conj(lo) / np.abs(lo)
    index = fit.data.scene.wrap(period)
    total = np.bincount(index, turned.real, period) + 1j * np.bincount(index, turned.imag, period)
    hits = np.bincount(index, fit.data.use > 0, period)
    energy = np.abs(total) ** 2 / np.maximum(hits, 1)
    size = max(1, period // 64)
    cells = np.add.reduceat(energy, np.arange(0, period, size))
    count = np.add.reduceat((hits > 0).astype(float), np.arange(0, period, size))
    both = [(energy.sum(), float((hits > 0).sum()), 1), (cells, count, len(cells))]
    log_p = [float(np.min(_gamma_cells(np.atleast_1d(e), np.atleast_1d(c))[0])) + np.log(m) for e, c, m in both]
    excess = max(0.0, float(energy.sum() - (hits > 0).sum()))
    return Leftover(
        test="place in the code", p_value=bonferroni(min(log_p), 1), nats=excess, where={}, record_next="other_code_length"
    )


def _amplitude(fit, inside) -> Leftover | None:
    """Mean residual along and across the prediction, and power, in bins of predicted amplitude."""
    use = inside
    z, w = normal(fit)[use], fit.chain.wanted[use]
    level = np.abs(w)
    if np.std(level) < 1e-6 * np.mean(level) + 1e-30:
        return None
    edges = np.quantile(level, np.linspace(0, 1, 17))
    k = np.clip(np.searchsorted(edges, level) - 1, 0, 15)
    along = z * np.conj(w) / np.maximum(level, 1e-30)
    hits = np.maximum(np.bincount(k, minlength=16), 1)
    mean = (np.bincount(k, along.real, 16) + 1j * np.bincount(k, along.imag, 16)) / np.sqrt(hits)
    energy = np.abs(mean) ** 2
    log_p = float(stats.gamma.logsf(energy.sum(), 16))
    power = np.bincount(k, np.abs(z) ** 2, 16)
    log_q = float(np.min(stats.gamma.logsf(power, hits)) + np.log(16))
    return Leftover(
        test="amplitude",
        p_value=bonferroni(min(log_p, log_q) + np.log(2), 1),
        nats=float(max(0, energy.sum() - 16)),
        where={"amplitude": [float(edges[-2]), float(edges[-1])]},
        record_next="second_power",
    )


def jumps(fit) -> list[Leftover]:
    """Random courses, of a phase or of a tap, that move far more in one moment than in all others: none that is Gaussian
    does."""
    scene, out = fit.data.scene, []
    for e in fit.model.found:
        if not FAMILIES[e.family].wanders:
            continue
        course = FAMILIES[e.family].course(scene, e, e.p)
        orders = len(e.p) // (2 if np.iscomplexobj(course) else 1)
        at = np.linspace(0, scene.count - 1, 2 * orders).astype(int)[4:-4]  # the ends of a course are held by little
        if len(at) < 16:
            continue
        level = np.add.reduceat(np.abs(fit.chain.wanted) ** 2, at) / np.diff(np.append(at, scene.count))
        heard = level > HEARD * np.mean(level)  # where nothing is sent a course goes anywhere
        moves = np.where(heard[1:] & heard[:-1], np.abs(np.diff(course[at])) ** 2, 0.0)
        k = int(np.argmax(moves))
        height = float(moves[k] / max(float(np.sum(moves)) / max(1, np.count_nonzero(moves)), 1e-300))
        log_p = -height if np.iscomplexobj(course) else float(stats.chi2.logsf(height, 1))
        out.append(
            Leftover(
                test=f"jump in the course of {e.family}",
                p_value=bonferroni(log_p, len(moves)),
                nats=height / (1 if np.iscomplexobj(course) else 2),
                where={"time_s": (scene.index[at[k : k + 2]] / scene.sample_rate_hz).tolist()},
                record_next="longer_recording",
            )
        )
    return out


def foreign(fit) -> tuple[np.ndarray, Leftover] | None:
    """((n,) bool, what is left) of the one stretch, a quarter of the recording at most, that has nothing of what the twin
    says, while before and behind it the twin fits: a waveform that is wrong there. None without such a stretch."""
    data, scene = fit.data, fit.data.scene
    used = np.flatnonzero((data.use > 0) | data.vault)
    edges = np.linspace(0, len(used), min(FOREIGN_CELLS, len(used) // LEAST_CELL) + 1).astype(int)
    if len(edges) < 17:
        return None

    def cells(x):
        return np.add.reduceat(x[used], edges[:-1])

    y, wanted = data.y, fit.chain.wanted
    sent, heard, both = cells(np.abs(wanted) ** 2), cells(np.abs(y) ** 2), np.abs(cells(y * np.conj(wanted))) ** 2
    energy = cells(np.abs(fit.residual) ** 2)
    if not sent.any():
        return None
    missed = energy / np.diff(edges) / (sent.sum() / len(used))
    typical, alien = np.median(missed), both < 0.5 * heard * sent  # with a gain of its own it would fit no better
    wrong = np.flatnonzero(alien & (missed > max(FOREIGN, 3 * typical)))
    if typical > TWIN_FITS or not len(wrong):
        return None
    first, last = wrong[0], wrong[-1]
    long, beside = last - first + 1, min(sent[:first].sum(), sent[last + 1 :].sum())
    if not 2 <= long <= len(sent) / 4 or len(wrong) < 0.6 * long or beside < 0.05 * sent.sum():
        return None
    stretch = np.zeros(scene.count, bool)
    stretch[used[edges[first - 1]] : used[edges[min(last + 2, len(sent))] - 1] + 1] = True  # and what it reaches on either side
    count, over = edges[last + 1] - edges[first], energy[first : last + 1].sum() / max(typical * sent.sum() / len(used), 1e-300)
    time_s = [float(scene.index[used[edges[k]]] / scene.sample_rate_hz) for k in (first, min(last + 1, len(sent) - 1))]
    p_value = bonferroni(float(stats.gamma.logsf(over, count)), len(sent) ** 2)
    return stretch, Leftover(test="time", p_value=p_value, nats=float(over - count), where={"time_s": time_s}, apart=True)


def crowded_impulses(fit) -> float:
    """p-value of impulses, or of the trains that they come in, under such as come at random; 1 without impulses."""
    effect = next((e for e in fit.model.found if FAMILIES[e.family].scattered), None)
    used = np.flatnonzero(fit.data.use > 0)
    if effect is None:
        return 1.0
    energy = np.abs(normal(replace(fit, data=replace(fit.data, variance=None)))[used]) ** 2
    return crowded(np.flatnonzero(FAMILIES[effect.family].shares(effect, energy * fit.sigma2) > 0.5), len(used))


def crowded(at: np.ndarray, count: int) -> float:
    """p-value of strong samples `at` (k,) of `count` as impulses that come at random, or in trains that do."""
    alone = _crowding(_beginnings(at), count)
    return alone if alone > CROWDED_P else max(alone, _crowding(_trains(at), count))


def _crowding(at: np.ndarray, count: int) -> float:
    """p-value of the fullest of many windows of time, half over each other, or of all of them together, under events `at` (k,)
    samples of `count` that come at random (Poisson); 1 of none."""
    windows = min(WINDOWS, count // LEAST_WINDOW)
    if not len(at) or windows < 4:
        return 1.0
    halves = np.bincount(at * 2 * windows // count, minlength=2 * windows)
    fullest = (halves[1:] + halves[:-1]).max()
    one = bonferroni(float(stats.poisson.logsf(fullest - 1, len(at) / windows)), 2 * windows)
    return min(1.0, 2 * min(one, _in_several(at / count)))


def _trains(at: np.ndarray) -> np.ndarray:
    """The first samples of the trains in which strong samples `at` (k,) come, as sparks and flashes do: gaps within a train and
    between two are of two kinds, each exponential, and most likely as they are split here. `at` itself where these are no
    trains: few, one of much of it all, or of bursts."""
    begins = np.flatnonzero(np.diff(at, prepend=-np.inf) > TOGETHER)
    gaps, runs = np.diff(at[begins]), np.diff(np.append(begins, len(at)))
    if len(gaps) < FEWEST_TRAINS or np.quantile(runs, MOST_SPARKS) > LONGEST_SPARK:
        return at
    ordered, k = np.sort(gaps), np.arange(1, len(gaps))
    short = np.cumsum(ordered)[:-1]
    kinds = ((k, short), (len(gaps) - k, gaps.sum() - short))
    split = int(np.argmax(sum(hits * (2 * np.log(hits) - np.log(total)) for hits, total in kinds)))
    first = np.flatnonzero(np.append(True, gaps > ordered[split]))
    sizes = np.diff(np.append(first, len(begins)))
    return at[begins[first]] if len(first) >= FEWEST_TRAINS and sizes.max() <= LARGEST_TRAIN * len(begins) else at


def _beginnings(at: np.ndarray) -> np.ndarray:
    """Of strong samples `at` (k,) those that count as impulses: the first of some that a receiver's band or a filter draws out,
    but each of a burst that lasts longer than an impulse may."""
    group = np.cumsum(np.diff(at, prepend=at[0]) > TOGETHER)
    first, last = np.searchsorted(group, group), np.searchsorted(group, group, side="right") - 1
    return at[(at == at[first]) | (at[last] - at[first] >= LONGEST_IMPULSE)]


def _in_several(at: np.ndarray) -> float:
    """p-value of impulses at the times `at` (k,), shares of the recording, crowding in several windows: their
    counts spread wider than those that come at random (the index of dispersion, Fisher 1925)."""
    windows = min(WINDOWS, len(at) // LEAST_IMPULSES)
    if windows < 4:
        return 1.0
    counts = np.bincount((at * windows).astype(int), minlength=windows)
    return float(stats.chi2.sf(np.sum((counts - counts.mean()) ** 2) / counts.mean(), windows - 1))


def delay_time(fit, segments: int = 24, longest: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """(delays in s on the taps' scale, (segments, delays)): energy with which the residual holds the waveform once more, over
    what noise alone would give, NaN where nothing is known; `longest` is a delay in samples that is to be seen."""
    view, scene = View(fit), fit.data.scene
    segments = max(1, min(segments, scene.count // 64))
    source = scene.sources[0]
    turned = view.residual * np.conj(view.carrier)
    c, lags = view.correlations(0, turned, segments)
    span = int(min(len(lags), max(64, 2 * max(p.delay for p in scene.taps) + 32, 1.3 * longest + 32)))
    if source.repeat:
        first = int(round(fit.model.base[0])) - span // 6
        c = np.roll(c, -first, axis=1)[:, :span]
        delays = np.arange(span) - span // 6
    else:
        c, delays = c[:, :span], lags[:span]
    share = np.diff(view.stretches(segments))[:, None] / scene.count
    expected = fit.sigma2 * np.mean(np.abs(view.carrier) ** 2) * source.power * fit.data.count * share
    return delays / scene.sample_rate_hz, np.where(share, np.abs(c) ** 2, np.nan) / np.maximum(expected, 1e-300)
