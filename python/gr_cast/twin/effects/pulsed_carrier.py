# SPDX-License-Identifier: GPL-3.0-or-later
"""Pulses of a carrier or a chirp: pulsed interference whose every pulse is one wave, c_k·exp(j2π(f·n + ½·s·m²)), m samples from
the middle of pulse k. Internal: Re and Im of c_k over the wanted rms; the gate and the wave are found by search (aux
`period`, `first`, `width` in samples, `frequency` in cycles per sample, `sweep` in cycles per sample²).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft as sp_fft
from scipy import optimize

from ...core.tails import log_gamma_tail
from ..columns import Lags, some_at_once
from ..interpolate import TAU, phasor, within_turn
from .base import AIR, PROBE, Family, Multiplicity, rms_of, said_rms, start
from .values import NEEDED, NEEDED_POSITIVE, NUMBER, POSITIVE, Value

BLOCKS = (32, 128, 512, 2048)  # samples of a block in which a pulse is looked for as a line
FEWEST_PULSES = 3  # that make a period
MOST_NUMBERS = 6_000_000  # pulses times samples: what is worth its memory
SURPRISE_NATS = 8.0  # by which a period must stand out of the largest of as many of noise
TEETH = (2, 4, 16)  # harmonics of a period that are added: of long pulses few, of short ones many
FASTEST = 0.5  # cycles per sample that a chirp sweeps in one pulse, at most
SELDOM = 8  # times the period that was seen: of every so many pulses there may be one
LOUDEST_SAMPLE = 3.0  # times the rms of noise, to which samples are cut: a few impulses make no train
LOUD_NATS = 6.0  # energy over that of noise from which a block holds a pulse, may be
MOST_PEAKS, MOST_PARTS = 16, 6  # loud blocks of a line that are set on a beat, and of how many beats two are apart
LOUD_CELL = 4.0  # times the mean energy of noise: one loud block alone is no period
LOUDEST = 6  # pulses that show the wave
MOST_TURNS = 80  # quarters of a cycle, at most, by which a chirp's edge is tried ahead of its middle
EVEN = 0.25  # of the mean energy of a pulse, the least of the median: in a train with gaps every second pulse would be none
GAPS = 9  # places between two pulses at which the wave is looked for too
EDGES = 48  # places at which a pulse's beginning and end are tried
AT_ONCE = 1 << 16  # places of pulses, or bins of their spectra, that are worked on at once
POLISHED = 3  # times that a search for the best wave begins again
EDGED = 2  # times that edges are looked for again once it is known
EDGE_SHARE = 2.5  # energies of noise that an edge is placed to (Hinkley 1970)
DB = 10 / np.log(10)


@dataclass(frozen=True, kw_only=True)
class Train:
    """A train of pulses on the time of a recording: all in samples, cycles per sample and cycles per sample²."""

    period: float
    first: float
    width: float
    frequency: float
    sweep: float

    def pulses(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) the pulse that each sample lies in, −1 between pulses, and the samples from that pulse's middle."""
        number = np.floor((index - self.first) / self.period)
        into = index - self.first - number * self.period
        return np.where(into < self.width, number, -1e9), into - self.width / 2

    def wave(self, index: np.ndarray) -> np.ndarray:
        """(n,) the wave in the pulses, 0 between them."""
        number, from_middle = self.pulses(index)
        return (number > -1e9) * phasor(TAU * (self.frequency * index + 0.5 * self.sweep * from_middle**2))


def trains(signal: np.ndarray, power: float) -> list[Train]:
    """The likeliest train in complex noise of a known power per sample, or none."""
    seen = [
        found for block in BLOCKS if 24 * block <= len(signal) for found in (*_combs(signal, block), *_lattices(signal, block))
    ]
    best = (0.0, None)
    for begun in seen:
        train, nats = _refined(signal, power, begun)
        energy = np.sort(_matched(signal, power, train))
        if nats > best[0] and len(energy) >= FEWEST_PULSES and energy[len(energy) // 2] > EVEN * energy.mean():
            best = (nats, train)
    return [] if best[0] < np.log(len(signal)) + SURPRISE_NATS else [best[1]]


def _over_median(frames: np.ndarray) -> np.ndarray:
    """(blocks, lines) energy in the lines of blocks over its mean in noise, whatever stands in a line all the time."""
    energy = np.abs(sp_fft.fft(frames, axis=1)) ** 2
    return energy / np.maximum(np.median(energy, axis=0) / np.log(2), 1e-300)


def _combs(signal, block: int) -> list[Train]:
    """Of many pulses, the train of which a line of blocks shows most harmonics, where it is no noise."""
    energy = _over_median(signal[: len(signal) // block * block].reshape(-1, block))
    energy = np.minimum(energy, LOUD_CELL)
    size = sp_fft.next_fast_len(2 * len(energy), real=True)
    lines = np.abs(sp_fft.rfft(energy - energy.mean(axis=0), size, axis=0)) ** 2
    lines /= np.median(lines[1:]) / np.log(2)
    places = np.arange(int(np.ceil(FEWEST_PULSES * size / len(energy))), len(lines) // 2)
    best, comb = (SURPRISE_NATS, []), np.zeros((len(places), block))
    for h in range(1, TEETH[-1] + 1) if len(places) else ():
        seen = np.searchsorted(places, -(-len(lines) // h))
        comb[:seen] += lines[h * places[:seen]]
        if h in TEETH:
            counted = np.minimum(h, (len(lines) - 1) // places)
            surprise = -log_gamma_tail(comb.max(1), counted) - np.log(comb.size * len(TEETH) * len(BLOCKS))
            k = int(np.argmax(surprise))
            if surprise[k] > best[0]:
                best = float(surprise[k]), [_folded(signal, block, size / places[k] * block, int(np.argmax(comb[k])))]
    return best[1]


def _lattices(signal, block: int) -> list[Train]:
    """Of few pulses, the train on whose beat most of the loud blocks of one line are."""
    hop = block // 2
    energy = _over_median(np.lib.stride_tricks.sliding_window_view(signal, block)[::hop])
    loud = np.maximum(energy - LOUD_NATS, 0.0)
    row = int(np.argmax(np.sum(np.minimum(loud, LOUD_NATS), axis=0)))
    peaks = np.flatnonzero(
        (loud[:, row] > 0) & (energy[:, row] >= np.maximum(np.roll(energy[:, row], 1), np.roll(energy[:, row], -1)))
    )
    peaks = np.sort(peaks[np.argsort(-energy[peaks, row])[:MOST_PEAKS]])
    i, j = np.triu_indices(len(peaks), 1)
    period = (peaks[j] - peaks[i])[:, None] / np.arange(1, MOST_PARTS + 1)
    turns = (peaks - peaks[i, None])[:, None] / period[..., None]
    on = np.abs(turns - np.round(turns)) * period[..., None] <= 1.0
    nats = (on * energy[peaks, row]).sum(2) - np.log(len(energy)) * len(energy) / period
    often = (period >= 4) & (len(energy) / period >= FEWEST_PULSES - 1) & (on.sum(2) >= FEWEST_PULSES)
    nats = np.where(often, nats, 0.0)
    if not nats.size or nats.max() <= 0.0:
        return []
    pair, parts = np.unravel_index(int(np.argmax(nats)), nats.shape)
    beat = period[pair, parts] * hop
    return [Train(period=beat, first=peaks[i[pair]] * hop % beat, width=float(block), frequency=row / block, sweep=0.0)]


def _folded(signal, block: int, period: float, row: int) -> Train:
    """A train that was seen as a comb of a line in blocks, with the beginning and width that the folded blocks show."""
    n, hop = len(signal), block // 2
    frames = np.lib.stride_tricks.sliding_window_view(signal, block)[::hop]
    energy = np.abs(frames @ np.exp(-2j * np.pi * row * np.arange(block) / block)) ** 2
    middle = np.arange(len(energy)) * hop + block / 2
    best = (-np.inf,)
    for t in period * (1 + np.arange(-12, 13) / 12 * min(0.5, block / n * period / hop)):
        bins = max(8, int(t / hop))
        at = (within_turn(middle / t) * bins).astype(int)
        total, hits = np.bincount(at, energy, bins), np.maximum(np.bincount(at, minlength=bins), 1)
        for length in (x for x in (1, 2, 4, 8, 16) if x <= bins // 2):
            window = np.convolve(np.concatenate([total, total]), np.ones(length))[length - 1 : length - 1 + bins]
            count = np.convolve(np.concatenate([hits, hits]), np.ones(length))[length - 1 : length - 1 + bins]
            excess = (window / count / energy.mean() - 1) * np.sqrt(count)
            k = int(np.argmax(excess))
            best = max(best, (float(excess[k]), t, (k + 0.5 * length) / bins * t, length * t / bins))
    _, period, centre, width = best
    return Train(period=period, first=(centre - width / 2) % period, width=width, frequency=row / block, sweep=0.0)


def _refined(signal, power, train: Train) -> tuple[Train, float]:
    """The train with the period, beginning, width, frequency and sweep that explain most, and the nats by which it does."""
    for seldom in (SELDOM, 1, 1, 1):
        train = _edges(signal, _beat(signal, power, _wave(signal, train), seldom))
    energy = _matched(signal, power, train)
    mean = max(float(energy.mean()) / max(_between(signal, power, train), 1.0), 1.0)
    return train, len(energy) * (mean - 1 - np.log(mean))


def _between(signal, power, train: Train) -> float:
    """Energy of the wave between the pulses over that of noise: of a band that is on all the time as much as in them."""
    places = np.linspace(train.width, train.period - train.width, GAPS)
    return float(np.median([_matched(signal, power, replace(train, first=train.first + late)).mean() for late in places]))


def _pulse(train: Train, size: int) -> np.ndarray:
    """(size,) the wave of a pulse, about its middle."""
    from_middle = np.arange(size) - (size - 1) / 2
    return phasor(TAU * (train.frequency * from_middle + 0.5 * train.sweep * from_middle**2))


def _matched(signal, power, train: Train) -> np.ndarray:
    """(pulses,) energy of each pulse over that of noise in it."""
    parts = _segments(signal, train, train.width)
    return np.abs(parts @ np.conj(_pulse(train, parts.shape[1]))) ** 2 / (parts.shape[1] * power)


def _beat(signal, power, train: Train, seldom: int) -> Train:
    """The train, its wave known, with the period (a part, or up to so many times as long) and beginning that explain most."""
    size = max(8, int(round(train.width)))
    wave = _pulse(train, size)
    span = sp_fft.next_fast_len(len(signal) + size)
    both = sp_fft.ifft(sp_fft.fft(signal, span) * np.conj(sp_fft.fft(wave, span)))[: len(signal)]
    energy = np.abs(both) ** 2 / (size * power)  # of a pulse that begins at a sample; of noise exponential, 1 in the mean
    count = len(signal) / train.period
    best = (-np.inf, train.period, train.first)
    within = len(signal) - size // 2
    energy = np.append(energy[:within], 0.0)
    for times in (*(1 / k for k in range(2, 4) if seldom > 1), *range(1, seldom + 1)):
        if count / times < FEWEST_PULSES - 1 or times * train.period < 2 * size:
            continue
        begins = (train.first + train.period * np.arange(np.ceil(times))[:, None] + np.linspace(-1, 1, 9) * size).ravel()
        periods, number = times * train.period + np.linspace(-2, 2, 33) * size * times / count, np.arange(int(count / times) + 1)
        for some in some_at_once(periods, len(begins) * len(number), AT_ONCE):
            at = np.rint(begins[:, None] + (some[:, None] * number)[:, None]).astype(int)
            at[(at < 0) | (at >= within)] = within
            pulses = np.count_nonzero(at < within, axis=2)
            mean = np.maximum(energy[at].sum(2) / np.maximum(pulses, 1), 1.0)
            nats = pulses * (mean - 1 - np.log(mean))
            k = np.argmax(nats, axis=1)
            best = max(best, max(zip(nats[np.arange(len(some)), k].tolist(), some, begins[k].tolist(), strict=True)))
    _, period, first = best
    return replace(train, period=float(period), first=first % float(period))


def _segments(signal, train: Train, width: float) -> np.ndarray:
    """(pulses, width) samples around the middle of each pulse, zeros beyond the ends."""
    n, size = len(signal), max(8, int(round(width)))
    begins = np.round(np.arange(train.first - train.period, n, train.period) + train.width / 2 - size / 2).astype(int)
    at = begins[:, None] + np.arange(size)
    inside = (at >= 0) & (at < n)
    return np.where(inside, signal[np.clip(at, 0, n - 1)], 0.0)[inside.sum(1) > size // 4]


def _wave(signal, train: Train) -> Train:
    """The train with the frequency and sweep that explain most of its strongest pulses."""
    parts = _segments(signal, train, train.width)
    parts = parts[np.argsort(-np.sum(np.abs(parts) ** 2, axis=1))[:LOUDEST]].astype(np.complex64)  # bins alone are told
    size = parts.shape[1]
    span = sp_fft.next_fast_len(2 * size)
    from_middle = np.arange(size) - (size - 1) / 2
    reach, best = np.floor(min(FASTEST * size / 2, MOST_TURNS)), (-np.inf,)
    turns = np.arange(-reach, reach + 1)  # quarters of a cycle by which an edge is ahead of the middle
    for some in some_at_once(turns, len(parts) * span, AT_ONCE):
        turned = phasor(-TAU * some[:, None] * (from_middle / size) ** 2).astype(np.complex64)
        lines = sp_fft.fft(parts * turned[:, None], span, axis=2)
        lines = (lines.real**2 + lines.imag**2).sum(1)
        m, k = np.unravel_index(int(np.argmax(lines)), lines.shape)
        best = max(best, (float(lines[m, k]), k, 2 * some[m] / size**2))
    return replace(train, frequency=float(sp_fft.fftfreq(span)[best[1]]), sweep=best[2])


def _edges(signal, train: Train, to_the_sample: bool = False) -> Train:
    """The train with the beginning and the width that explain most, its wave known; of pulses below the noise no sample is an
    edge."""
    size = int(min(3 * train.width + 16, train.period))
    parts = _segments(signal, train, size)
    down = np.conj(_pulse(train, parts.shape[1]))
    sums = np.concatenate([np.zeros((len(parts), 1)), np.cumsum(parts * down, axis=1)], axis=1).T
    at = np.unique(np.linspace(0, parts.shape[1], EDGES + 1).astype(int))

    def held(begins, ends):  # (begins, ends) energy of pulses from one sample to another
        long = ends[None, :] - begins[:, None]
        inside = np.abs(sums[ends][None] - sums[begins][:, None]) ** 2
        return np.where(long > 0, inside.sum(2) / np.maximum(long, 1), 0.0)

    energy = np.array([held(at[k : k + 1], at)[0] for k in range(len(at))])
    if not energy.any():
        return train
    i, j = (at[k] for k in np.unravel_index(int(np.argmax(energy)), energy.shape))
    step = int(np.diff(at).max())
    for _ in range(2 * to_the_sample):  # one edge after the other
        near = np.arange(max(i - step, 0), min(i + step, j - 1) + 1)
        i = near[int(np.argmax(held(near, np.array([j]))[:, 0]))]
        near = np.arange(max(j - step, i + 1), min(j + step, parts.shape[1]) + 1)
        j = near[int(np.argmax(held(np.array([i]), near)[0]))]
    begins, ends = i - parts.shape[1] / 2, j - parts.shape[1] / 2
    middle, moved = train.first + train.width / 2, 0.5 * (begins + ends)
    frequency = train.frequency + train.sweep * moved
    width = float(ends - begins)
    return replace(train, first=float((middle + begins) % train.period), width=width, frequency=frequency)


def polished(signal: np.ndarray, train: Train) -> Train:
    """The train with its beat, edges and wave where its pulses explain most, the edges looked for again where the wave is known:
    of loud ones a wave that is off by a hundredth of a cycle leaves more than noise."""
    for _ in range(EDGED):
        train = _edges(signal, _smoothed(signal, train), to_the_sample=True)
    return _smoothed(signal, train)


def _smoothed(signal: np.ndarray, train: Train) -> Train:
    """The train moved in small steps to where its pulses explain most."""
    index = np.arange(len(signal))
    number = np.floor((index - train.first - train.width / 2) / train.period + 0.5)
    from_middle = index - train.first - train.width / 2 - number * train.period
    near = (np.abs(from_middle) < train.width) & (signal != 0)
    if not near.any():
        return train
    y, from_middle, number = signal[near], from_middle[near], number[near]
    which, centre = (number - number.min()).astype(int), number.mean()
    steps = np.array(
        [
            train.width / (4 * (which.max() + 1)),
            *2 * [max(1.0, train.width / 32)],
            1 / (8 * train.width),
            1 / train.width**2,
        ]
    )

    def moved(q):
        late, begin, end, frequency, sweep = q * steps + [0.0, -train.width / 2, train.width / 2, train.frequency, train.sweep]
        return late, begin, end, frequency, sweep

    def left(q):
        late, begin, end, frequency, sweep = moved(q)
        at = from_middle - (number - centre) * late
        inside = (at >= begin) & (at < end)
        at, k = at[inside], which[inside]
        down = y[inside] * phasor(-TAU * (frequency * at + 0.5 * sweep * at**2))
        sums = np.bincount(k, down.real) ** 2 + np.bincount(k, down.imag) ** 2
        return -float(np.sum(sums / np.maximum(np.bincount(k), 1)))

    q = np.zeros(5)
    for _ in range(POLISHED):
        options = {"initial_simplex": q + np.vstack([np.zeros(5), np.eye(5)]), "xatol": 1e-3, "fatol": 1e-6 * abs(left(q))}
        q = optimize.minimize(left, q, method="Nelder-Mead", options=options).x
    late, begin, end, frequency, sweep = moved(q)
    period = train.period + late
    first = train.first + train.width / 2 + begin - centre * late
    frequency += sweep * 0.5 * (begin + end)  # at the pulses' new middle
    return Train(period=period, first=first % period, width=end - begin, frequency=frequency, sweep=sweep)


class PulsedCarrier(Family):
    name = "pulsed_carrier"
    told_as = "pulsed_interference"
    parameters = {"period_s": NEEDED_POSITIVE, "duty_cycle": Value(low=0.0, high=1.0, needed=True), "power_dbc": NEEDED}
    remembered = {"first_s": NUMBER, "carrier_hz": NUMBER, "sweep_hz_per_s": NUMBER, "wanted_rms": POSITIVE}
    owners = ("environment",)
    stage = AIR
    relative = True
    multiplicity = Multiplicity.ONE
    lasting = False
    linear = True
    random = True

    @staticmethod
    def _train(effect) -> Train:
        return Train(**{name: effect.aux[name] for name in ("period", "first", "width", "frequency", "sweep")})

    @staticmethod
    def _numbers(scene, train: Train) -> tuple[np.ndarray, int]:
        """(n,) the place of each sample's pulse in the recording, −1 between pulses; and how many there are."""
        number = train.pulses(scene.index)[0]
        inside = number > -1e9
        low = number[inside].min() if inside.any() else 0
        return np.where(inside, number - low, -1).astype(int), int(number[inside].max() - low + 1) if inside.any() else 0

    def _wave(self, scene, effect):
        """(n,) the pulses as they are."""
        train = self._train(effect)
        at, count = self._numbers(scene, train)
        gains = np.zeros(max(count, 1), complex)
        told = (effect.p[::2] + 1j * effect.p[1::2])[:count]
        gains[: len(told)] = told
        return rms_of(scene, effect) * np.where(at >= 0, gains[at], 0.0) * train.wave(scene.index)

    def apply(self, chain, effect):
        chain.y = chain.y + self._wave(chain.scene, effect)

    def columns(self, scene, effect, chain, before, rest):
        train = self._train(effect)
        at, _ = self._numbers(scene, train)
        one = before.copy()
        one.y = one.y + PROBE * rms_of(scene, effect) * train.wave(scene.index)
        unit = (rest(one, effect).y - chain.y) / PROBE
        count = len(effect.p) // 2
        rows = np.array([unit * (at == k) for k in range(count)])
        return Lags(signals=rows, entries=tuple((k, 0) for k in range(count)))

    def starts(self, view):
        n, size = view.scene.span, np.abs(view.recorded)
        power = float(np.median(size[size > 0] ** 2)) / np.log(2) if size.any() else 1.0
        tame = view.recorded * np.minimum(1.0, LOUDEST_SAMPLE * np.sqrt(power) / np.maximum(size, 1e-300))
        for train in trains(view.scene.spread(tame), power):
            train = polished(view.scene.spread(view.recorded), train)
            count = self._numbers(view.scene, train)[1]
            if count >= FEWEST_PULSES and count * n <= MOST_NUMBERS and train.width < train.period / 2:
                yield start(self, np.zeros(2 * count), prior=np.ones(2 * count), aux=vars(train).copy(), trials=float(n))

    def settled_law(self, scene, effect, covariance):
        effect = super().settled_law(scene, effect, covariance)
        power, noise = float(np.sum(effect.p**2)), np.diag(covariance)
        train, count = self._train(effect), len(effect.p) / 2
        # A pulse of `width` samples tells its energy, power/count·width, to `noise` times that of one: so far its edges are seen.
        edge = min(EDGE_SHARE * train.width * float(np.mean(noise)) / max(power / count, 1e-300), train.width / 4) + 0.5
        edge = np.hypot(edge, train.width / EDGES)
        # The last pulse is placed to half a step of the search for a beat too, an eighth of a pulse.
        strength = 2 * np.sqrt(np.sum(effect.p**2 * noise)) / max(power, 1e-300)
        stds = {
            "period_s": float(np.hypot(2 * edge / np.sqrt(count), train.width / 16)) / count / scene.sample_rate_hz,
            "duty_cycle": edge * np.sqrt(2.0) / train.period,
            "power_dbc": DB * float(np.hypot(strength, edge / train.width)),
        }
        return replace(effect, aux={**effect.aux, "_stds": stds})

    def hidden(self, effect):
        return 5  # of the gate and the wave

    def values(self, scene, effect, p):
        power = 2 * np.mean(p**2) * (rms_of(scene, effect) / scene.wanted_rms) ** 2
        return {
            "period_s": effect.aux["period"] / scene.sample_rate_hz,
            "duty_cycle": effect.aux["width"] / effect.aux["period"],
            "power_dbc": 10 * np.log10(power + 1e-30),
        }

    def in_time(self, scene, effect, later, longer):
        period = effect.aux["period"]
        return replace(effect, aux={**effect.aux, "first": (effect.aux["first"] - later * scene.span) % period})

    def parse(self, scene, parameters, model):
        rate = scene.sample_rate_hz
        aux = {
            "period": parameters["period_s"] * rate,
            "first": model.get("first_s", 0.0) * rate,
            "width": parameters["duty_cycle"] * parameters["period_s"] * rate,
            "frequency": model["carrier_hz"] / rate,
            "sweep": model.get("sweep_hz_per_s", 0.0) / rate**2,
            **said_rms(model),
        }
        effect = start(self, np.zeros(2), aux=aux)
        count = 2 * max(1, self._numbers(scene, self._train(effect))[1])
        prior = np.full(count, 10 ** (parameters["power_dbc"] / 10) / 2)
        return replace(effect, p=np.zeros(count), free=np.ones(count, bool), prior=prior)

    def model(self, scene, effect):
        rate, train = scene.sample_rate_hz, self._train(effect)
        told = {"first_s": train.first / rate, "carrier_hz": train.frequency * rate, "sweep_hz_per_s": train.sweep * rate**2}
        return told | {"wanted_rms": rms_of(scene, effect)}

    def played(self, scene, effect, rng):
        phases = rng.uniform(0, 2 * np.pi, len(effect.p) // 2)
        size = np.sqrt(2 * effect.prior[0])
        return effect.moved(size * np.stack([np.cos(phases), np.sin(phases)], 1).ravel())

    def describe(self, number):
        return (
            f"Pulses of one wave each every {number('period_s')}, on for {number('duty_cycle')} of it, "
            f"{number('power_dbc')} while on."
        )
