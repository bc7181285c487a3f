# SPDX-License-Identifier: GPL-3.0-or-later
"""At which whole-sample delay a recording holds what was sent, whatever the carrier offset: segments are correlated and added
without phase, of several lengths that which explains most."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import fft as sp_fft
from scipy import ndimage

from ..twin.columns import some_at_once
from ..twin.interpolate import TAU, phasor
from ..twin.scene import Source
from .policy import (
    BEHIND,
    CHIRP_BEST,
    CHIRP_CLEAR,
    CHIRP_FEW,
    CHIRP_FINE,
    CHIRP_MOST,
    CHIRP_PIECE,
    CHIRP_PLACES,
    CHIRP_REACH,
    CHIRP_STEP,
    CHIRP_STRIDE,
    DELAY_ALIKE,
    DELAY_CLEAR,
    DELAY_GROWTH,
    DELAY_LEAST_PIECE,
    DELAY_LONGER,
    DELAY_SEGMENTS,
    DELAY_SHORT,
    DELAY_SHORTEST,
    DELAY_SILENT,
    DELAY_SURE_NATS,
    DELAYS_AT_ONCE,
    LEAST_WITHOUT_LINES,
    LIKE_ITSELF,
    LINE_BINS,
    LINE_DECILE,
    MOST_DELAYS,
    PIECES,
    PRODUCT_LAGS,
    SHORT_FACTOR,
    TABLE,
    WORK,
)


def response(taps, length: int, rate: float) -> np.ndarray:
    """(length,) complex response of a link's taps at the frequencies of an FFT."""
    f = sp_fft.fftfreq(length) * rate
    return sum(t.amplitude * phasor(-TAU * f * t.delay_s) for t in taps)


def heard_spectrum(source: Source, taps, rate: float) -> np.ndarray:
    """(period,) of what a link makes of a waveform that repeats."""
    return sp_fft.fft(source.samples) * response(taps, len(source.samples), rate)


def without_lines(samples: np.ndarray) -> np.ndarray:
    """What is sent with no line of its own above what random bins reach around it: a line is the same at every delay. As it is
    where all but nothing would be left of it."""
    spectrum = sp_fft.fft(samples)
    power, n = np.abs(spectrum) ** 2, len(samples)
    blocks = np.array_split(power, max(1, n // LINE_BINS))
    around = ndimage.maximum_filter1d([np.quantile(b, LINE_DECILE) for b in blocks], 3, mode="wrap")
    most = np.log(n + 1) * np.repeat(around, [len(b) for b in blocks])  # the largest of n random bins has half of it
    kept = np.minimum(1.0, np.sqrt(most / np.maximum(power, 1e-300)))
    if np.all(kept == 1.0) or np.sum(power * kept**2) < LEAST_WITHOUT_LINES * power.sum():
        return samples
    return sp_fft.ifft(spectrum * kept)


def comes_again(samples: np.ndarray) -> bool:
    """Whether what is sent, but for its mean, is like itself at another delay, so that only where it begins and ends tells the
    delay."""
    power = np.abs(sp_fft.fft(samples - samples.mean(), sp_fft.next_fast_len(2 * len(samples)))) ** 2
    alike = np.abs(sp_fft.ifft(power)[: len(samples)])
    return bool((alike[np.argmax(alike < LIKE_ITSELF * alike[0]) :] > LIKE_ITSELF * alike[0]).any())


def of_repeated(y: np.ndarray, sources: list[Source], taps: list[tuple], rate: float) -> int:
    """Delay within the period of the twin's prediction in `y`: with a carrier and a gain for stretches of several lengths, that
    of the longest that holds as much as shorter ones."""
    templates = [heard_spectrum(s, link, rate) for s, link in zip(sources, taps, strict=True)]
    tried, piece, n = [], DELAY_SHORTEST, 0
    while n < len(y):  # the longer the stretches, the more samples
        n = min(len(y), max(piece, TABLE * piece // max(len(t) for t in templates)))
        tried += _tried(y[:n], templates, min(piece, n))
        piece *= DELAY_LONGER
    sure = [t for t in tried if t.nats > DELAY_SURE_NATS] or [max(tried, key=lambda t: t.nats)]
    best = None
    for t in sorted(sure, key=lambda t: -t.length):
        if best is None or t.gain > best.gain * (SHORT_FACTOR if t.length < DELAY_SHORT and best.gain > 0 else 1.0):
            best = t
    return best.delay


@dataclass(frozen=True, kw_only=True)
class _Try:
    """A delay at which stretches of a length hold most: share of the energy over three times what others do, and the nats by
    which chance would not."""

    length: int
    gain: float
    nats: float
    delay: int


def _tried(y: np.ndarray, templates: list[np.ndarray], piece: int) -> list[_Try]:
    """The best delay for stretches of several lengths, each of them with the carrier that suits all, or with one for each
    transmitter."""
    count = len(y) // piece
    n, delays = count * piece, _delays([len(t) for t in templates])
    folded = {period: _folded(y[:n], piece, period) for period in {len(t) for t in templates}}
    tables = [sp_fft.ifft(folded[len(t)] * np.conj(t).astype(np.complex64), axis=1) for t in templates]
    energy = float(np.vdot(y[:n], y[:n]).real) * sum(np.vdot(t, t).real / len(t) ** 2 for t in templates)
    tried, together = [], 1
    while True:
        groups = -(-count // together)
        size = sp_fft.next_fast_len(2 * together) if together > 1 else 1
        powers = []
        for table in tables:
            rows = np.pad(table, ((0, groups * together - count), (0, 0))).reshape(groups, together, -1)
            sums = sp_fft.fft(rows, size, axis=1) if size > 1 else rows
            powers.append((sums.real**2 + sums.imag**2).sum(0))
        at, most, mean = _most(powers, delays)
        most, mean = (np.maximum(held / max(energy * together * piece, 1e-300), 1e-300) for held in (most, mean))
        ratio, gains = most / mean, groups * len(templates)
        nats = gains * (ratio - 1 - np.log(ratio)) - np.log(size * delays)
        # Of equals the smallest carrier: a chirp's are many.
        near = np.abs(sp_fft.fftfreq(size)) + (nats < DELAY_ALIKE * nats.max())
        k = int(np.argmin(near))
        tried.append(_Try(length=together * piece, gain=float(most[k] - 3 * mean[k]), nats=float(nats[k]), delay=int(at[k])))
        if len(powers) > 1 and size > 1:  # each transmitter may have a carrier of its own
            (at,), most, mean = _most([power.max(0)[None] for power in powers], delays)
            most, mean = (max(float(held[0]) / max(energy * together * piece, 1e-300), 1e-300) for held in (most, mean))
            own = gains * (most / mean - 1 - np.log(most / mean)) - np.log(size) * len(powers) - np.log(delays)
            tried.append(_Try(length=together * piece, gain=most - 3 * mean, nats=own, delay=int(at)))
        if together >= count:
            return tried
        together = min(together * DELAY_GROWTH, count)


def _most(powers: list[np.ndarray], delays: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """At each carrier (carriers,) the delay at which tables (carriers, period), which repeat, hold most together, what they hold
    there, and what they do in the mean."""
    size = len(powers[0])
    at, most = np.empty(size, int), np.empty(size)
    for some in some_at_once(np.arange(size), delays, DELAYS_AT_ONCE):
        held = sum(np.tile(power[some], -(-delays // power.shape[1]))[:, :delays] for power in powers)
        at[some] = np.argmax(held, axis=1)
        most[some] = held[np.arange(len(some)), at[some]]
    return at, most, sum(power @ np.bincount(np.arange(delays) % power.shape[1]).astype(np.float32) for power in powers) / delays


def _delays(periods: list[int]) -> int:
    """Delays that waveforms repeated with these periods tell apart together, no more than a table holds."""
    return min(math.lcm(*periods), max(MOST_DELAYS, *periods))


def _folded(y: np.ndarray, piece: int, period: int) -> np.ndarray:
    """(stretches, period) spectra of stretches of `piece` samples, each folded into one period."""
    index = np.arange(len(y)) % period + np.arange(len(y)) // piece * period
    size = len(y) // piece * period
    folded = np.bincount(index, y.real, size) + 1j * np.bincount(index, y.imag, size)
    return sp_fft.fft(folded.reshape(-1, period).astype(np.complex64), axis=1)


def of_sent_once(y: np.ndarray, sources: list[Source], taps: list[tuple], rate: float) -> int:
    """Delay of what is sent once in `y`, anywhere: where noise is least likely to reach what it explains.

    Of n samples, M pieces with a gain each explain a share s > q = M/n with a probability of
    exp(−n·(q·ln(q/s) + (1 − q)·ln((1 − q)/(1 − s)))) at most (Chernoff); a few loud samples count as few."""
    sent = np.flatnonzero(np.any([s.samples != 0 for s in sources], axis=0))
    if not len(sent):
        return 0
    first, last = sent[0], sent[-1] + 1
    known = np.all([s.known[first:last] for s in sources], axis=0)
    templates = [_filtered(s.samples[first:last] * known, link, rate) for s, link in zip(sources, taps, strict=True)]
    size = max(len(t) for t in templates)
    count = int(np.clip(WORK // (len(y) + size), 1, min(PIECES, -(-size // DELAY_LEAST_PIECE))))
    piece = -(-size // count)
    templates = [np.pad(t, (0, count * piece - len(t))) for t in templates]
    known = np.pad(known, (0, count * piece - len(known)), constant_values=True)  # what late paths bring
    energy, samples = _sliding(np.abs(y) ** 2, known), np.rint(_sliding(np.ones(len(y)), known))
    energy = np.maximum(energy, 1e-12 * energy.max())
    samples = np.clip(2 * energy**2 / np.maximum(_sliding(np.abs(y) ** 4, known), 1e-300), 2.0, np.maximum(samples, 2.0))
    gains = sum(np.count_nonzero(_audible(t, piece)) for t in templates) / max(1, np.count_nonzero(known))
    alike = _alike(templates)
    best = (-np.inf, 0)
    for k, level in enumerate(zip(*(_explained(y, t, piece) for t in templates), strict=True)):
        q = np.clip(gains / DELAY_GROWTH**k, 1 / samples, 0.5)
        s = np.clip(sum(level) / alike / energy, q, 1 - 1e-6)
        nats = samples * (q * np.log(q / s) + (1 - q) * np.log((1 - q) / (1 - s)))
        d = int(np.argmax(nats))
        best = max(best, (float(nats[d]), d - (count * piece - 1) - int(first)))
    return best[1]


def _audible(template: np.ndarray, piece: int) -> np.ndarray:
    """(pieces,) bool: which pieces of a template are no silence."""
    energy = np.sum(np.abs(template.reshape(-1, piece)) ** 2, axis=1)
    return energy > DELAY_SILENT * energy.mean()


def _alike(templates: list[np.ndarray]) -> float:
    """How often the same energy is explained at most: 1 for templates that are not alike, their number for equal ones."""
    unit = np.array([t / max(np.linalg.norm(t), 1e-300) for t in templates])
    return max(1.0, float(np.linalg.eigvalsh(unit.conj() @ unit.T).max()))


def _filtered(sent: np.ndarray, taps, rate: float) -> np.ndarray:
    """What a link makes of a waveform that is sent once, from its first sample to the last path's last."""
    last = max(0, int(np.ceil(max(t.delay_s for t in taps) * rate)))
    length = len(sent) + last + BEHIND
    size = sp_fft.next_fast_len(length + BEHIND)
    return sp_fft.ifft(sp_fft.fft(sent, size) * response(taps, size, rate))[:length]


def _explained(y: np.ndarray, template: np.ndarray, piece: int) -> list[np.ndarray]:
    """[(lags,) energy of `y` that pieces of a template explain, each with a gain of its own], pieces of `piece` samples first
    and then ever longer ones; lags from 1 − the template's length on."""
    count = len(template) // piece
    block = sp_fft.next_fast_len(max(1024, 4 * piece))
    step = block - piece + 1
    blocks = -(-(len(y) + piece - 1) // step)
    padded = np.concatenate([np.zeros(piece - 1), y, np.zeros(blocks * step + block - len(y) - piece + 1)]).astype(np.complex64)
    frames = np.lib.stride_tricks.sliding_window_view(padded, block)[::step][:blocks]
    spectra = sp_fft.fft(frames, axis=1)
    lengths = [1]
    while lengths[-1] < count:
        lengths.append(lengths[-1] * DELAY_GROWTH)
    lags, audible = len(y) + len(template) - 1, _audible(template, piece)
    totals = [np.zeros(lags, np.float32) for _ in lengths]
    sums, energies = [np.zeros(lags, np.complex64) for _ in lengths], [0.0] * len(lengths)
    for m in range(count):
        part = template[m * piece : (m + 1) * piece].astype(np.complex64)
        at = slice((count - 1 - m) * piece, (count - 1 - m) * piece + len(y) + piece - 1)
        energy, c = float(np.vdot(part, part).real), None
        if audible[m]:
            both = sp_fft.ifft(spectra * np.conj(sp_fft.fft(part, block)), axis=1)[:, :step]
            c = both.reshape(-1)[: len(y) + piece - 1]
        for k, length in enumerate(lengths):
            if c is not None:
                sums[k][at] += c
                energies[k] += energy
            if ((m + 1) % length == 0 or m == count - 1) and energies[k]:
                first = (count - 1 - m) * piece
                near = slice(first, first + len(y) + min(length, m + 1) * piece - 1)
                totals[k][near] += (sums[k][near].real ** 2 + sums[k][near].imag ** 2) / energies[k]
                sums[k][near], energies[k] = 0.0, 0.0
    return totals


def _sliding(x: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(lags,) sum of x (n,) where what is `known` (m,) of a waveform falls; lags from 1 − m on."""
    size = sp_fft.next_fast_len(len(x) + len(known) - 1, real=True)
    both = sp_fft.irfft(sp_fft.rfft(x, size) * sp_fft.rfft(known[::-1].astype(float), size), size)
    return both[: len(x) + len(known) - 1]


@dataclass(frozen=True, kw_only=True)
class Carried:
    """A delay, and the share of a recording of `count` samples that what is sent explains there with one carrier throughout."""

    delay: int
    share: float
    count: int

    def is_clearer(self, other: "Carried") -> bool:
        nats = self.count * np.log1p((self.share - other.share) / (1 - self.share))
        return self.share > CHIRP_CLEAR * other.share and nats > DELAY_SURE_NATS


def of_one_carrier(signals: list[np.ndarray], sources: list[Source], taps: list[tuple], rate: float, delays: list[int]):
    """[Carried] of each recording (n,) the delay around one at which what is sent explains clearly more of it with one carrier
    throughout; None where it does not look there like itself with another carrier, as a chirp does: else short pieces know."""
    if len({len(s.samples) for s in sources}) > 1:
        return None  # of several periods
    repeats, sent = all(s.repeat for s in sources), [*zip(sources, taps, strict=True)]
    if repeats:
        heard = sp_fft.ifft(sum(heard_spectrum(s, link, rate) for s, link in sent))
    else:
        heard = sum(_filtered(s.samples * s.known, link, rate) for s, link in sent)
    loudest = int(np.argmax(ndimage.uniform_filter1d(np.abs(heard) ** 2, CHIRP_PIECE)))
    piece, lags = heard[max(0, loudest - CHIRP_PIECE // 2) :][:CHIRP_PIECE], range(-CHIRP_REACH, CHIRP_REACH + 1)
    alone = (_shares(piece, piece, d, False) for d in lags)
    if not any(still < LIKE_ITSELF**2 and turned > LIKE_ITSELF for still, turned in alone):
        return None

    def sharpened(y, delay: int) -> Carried:
        def best_of(some) -> Carried:
            share, best = max((_shares(y, heard, d, repeats)[1], d) for d in some)
            return Carried(delay=best, share=share, count=min(len(y), CHIRP_MOST))

        half = min(len(heard), len(y)) // 2  # that must fall on the recording: of a few samples all is explained
        far = range(0, len(heard)) if repeats else range(half - len(heard), len(y) - half)
        here, apart = best_of([delay]), max(CHIRP_STRIDE, len(far) // CHIRP_PLACES)
        near = best_of(best_of(delay + d for d in lags[::CHIRP_FINE]).delay + d for d in range(-CHIRP_FINE, CHIRP_FINE))
        best = near if near.is_clearer(here) else here
        # A slow chirp is like itself a sweep later too, and so is each of its neighbours.
        shares = np.array([0.0, *(_shares(y, heard, d, repeats, CHIRP_FEW)[1] for d in far[::apart]), 0.0])
        peaks = np.flatnonzero((shares[1:-1] >= shares[:-2]) & (shares[1:-1] >= shares[2:]))
        places = [far[::apart][k] for k in sorted(peaks, key=lambda k: -shares[k + 1])[:CHIRP_BEST]]
        steps = {d + step for d in places for step in range(-apart // 2, apart // 2 + 1, CHIRP_STEP)}
        other = best_of(best_of(steps).delay + d for d in range(-CHIRP_STEP, CHIRP_STEP))
        return other if other.is_clearer(best) else best

    return [sharpened(y, delay) for y, delay in zip(signals, delays, strict=True)]


def _shares(y: np.ndarray, sent: np.ndarray, delay: int, repeats: bool, most: int = CHIRP_MOST) -> tuple[float, float]:
    """Share of the energy of `y` that `sent` explains from sample `delay` on, of the `most` first, and with the carrier that
    suits it best."""
    first, last = (0, len(y)) if repeats else (max(0, delay), min(len(y), delay + len(sent)))
    last = min(last, first + most)
    if last <= first:
        return 0.0, 0.0
    there = np.take(sent, np.arange(first - delay, last - delay), mode="wrap").astype(np.complex64)
    here = y[first:last].astype(np.complex64)
    product = here * np.conj(there)
    both = sp_fft.fft(product, sp_fft.next_fast_len(2 * (last - first)))
    power = (both.real**2 + both.imag**2) / max(float(np.vdot(there, there).real * np.vdot(here, here).real), 1e-300)
    k = int(np.argmax(power))
    below, peak, above = np.log(np.maximum(power[[k - 1, k, (k + 1) % len(power)]], 1e-30))
    between = 0.5 * (above - below) / max(2 * peak - above - below, 1e-9)  # two bins: a line may lie there
    turned = phasor(-TAU * (k + np.clip(between, -0.5, 0.5)) / len(power) * np.arange(len(product)))
    share = float(abs(np.dot(product, turned)) ** 2 / np.abs(both[k]) ** 2 * power[k]) if power[k] > 0 else 0.0
    return float(power[0]), min(max(share, float(power[k])), 1 - 1e-6)


@dataclass(frozen=True, kw_only=True)
class Turning:
    """A delay, the carrier in cycles per sample that goes with it, and the nats by which chance would not hold as much there."""

    delay: int
    carrier: float
    nats: float


def of_products(y: np.ndarray, source: Source, taps: tuple, rate: float) -> Turning:
    """Where `y` (n,) holds what one transmitter sends once, whatever the carrier: each sample times an earlier one's conjugate is
    turned by one angle alone (differential detection: Proakis, Digital Communications, ch. 5). Both as roots of their size, for
    a few loud samples are no waveform, and that of what is sent without its mean, which all signals of a band have in common."""
    sent = np.flatnonzero(source.samples)
    template = _filtered(source.samples[sent[0] : sent[-1] + 1] * source.known[sent[0] : sent[-1] + 1], taps, rate)
    best = Turning(delay=0, carrier=0.0, nats=-np.inf)
    for lag in PRODUCT_LAGS:
        told, heard = (_as_root(x[lag:] * np.conj(x[:-lag])) for x in (template, y))
        told = told - told.mean()
        size = sp_fft.next_fast_len(len(told) + len(heard))
        common = sp_fft.ifft(sp_fft.fft(heard, size) * np.conj(sp_fft.fft(told, size)))
        delays = np.arange(-(len(told) // 2), len(heard) - len(told) // 2)  # half of it must fall on the recording
        ends = np.clip(np.stack([delays, delays + len(told)]), 0, len(heard))
        energy = np.concatenate([[0.0], np.cumsum(np.abs(heard) ** 2)])[ends]
        share = np.abs(common[delays]) ** 2 / np.maximum((energy[1] - energy[0]) * np.vdot(told, told).real, 1e-300)
        k = int(np.argmax(share))
        independent = np.log(2) / np.median(share)  # numbers that so many products are worth: of those the shares are exponential
        nats = float(-independent * np.log1p(-min(share[k], 1 - 1e-9)) - np.log(len(PRODUCT_LAGS) * len(share)))
        if nats > best.nats:
            first = max(0, int(delays[k]))
            there = template[first - int(delays[k]) :][: len(y) - first]
            turned = y[first:][: len(there)] * np.conj(there)
            carrier = float(np.angle(np.vdot(turned[:-1], turned[1:])) / TAU)
            best = Turning(delay=int(delays[k]) - int(sent[0]), carrier=carrier, nats=nats)
    return best


def _as_root(x: np.ndarray) -> np.ndarray:
    """With the phases of `x` and the roots of its magnitudes."""
    return x / np.sqrt(np.maximum(np.abs(x), 1e-300))


def near(y: np.ndarray, sources: list[Source], centre: int, reach: int):
    """`of_sent_once` by short segments within `reach` of a delay, for waveforms sent once and any carrier offset; and
    whether the delay stands out clearly."""
    long = _near(y, sources, centre, reach, DELAY_SEGMENTS[0])
    if long[2]:
        return long
    short = _near(y, sources, centre, reach, DELAY_SEGMENTS[1])
    return short if short[1] > SHORT_FACTOR * long[1] else long


def _near(y: np.ndarray, sources: list[Source], centre: int, reach: int, segment: int):
    n = len(y)
    total, energy = np.zeros(2 * reach), 0.0
    size = sp_fft.next_fast_len(segment + 2 * reach)
    firsts = np.arange(0, n - segment, segment)
    sent = np.concatenate([[0.0], np.cumsum(np.abs(sources[0].samples))])
    inside = np.clip(np.stack([firsts, firsts + segment]) - centre, 0, len(sent) - 1)
    firsts = firsts[sent[inside[1]] > sent[inside[0]]]  # where something that is known was sent
    for first in firsts[:: len(firsts) // 400 + 1]:
        piece = y[first : first + segment]
        begin = first - centre - reach + 1
        for source in sources:
            template = source.samples[max(begin, 0) : max(begin + segment + 2 * reach - 1, 0)]
            if not template.any():
                continue
            template = np.concatenate([np.zeros(max(-begin, 0)), template])
            both = sp_fft.ifft(sp_fft.fft(template, size) * np.conj(sp_fft.fft(piece, size)))[: 2 * reach]
            total += np.abs(both[::-1]) ** 2 / (segment * source.power)
        energy += float(np.vdot(piece, piece).real)
    d = int(np.argmax(total))
    height = float(total[d] - np.median(total))
    others = np.delete(total, np.arange(max(0, d - reach // 32), min(len(total), d + reach // 32)))
    return centre + d - reach, height / max(energy, 1e-300), height > DELAY_CLEAR * others.std()
