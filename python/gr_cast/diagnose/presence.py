# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a recording holds what the twin sends at all: what the waveform explains where it was found, against what the same
waveform explains at delays at which it is not.

Pieces of recording × waveform* are added with their phases over stretches of several lengths, at every carrier (an FFT), and the
stretches without phase, so that neither a carrier nor a phase that wanders hides a waveform. Where it is not, the share of the
energy that it explains has a Beta distribution about its mean over other delays, whatever the spectra of both: a line explains
as much at every delay. Near delays keep the structure in time of both, far ones are free of echoes: the larger mean counts.
Of pulses of one phase only the places tell: theirs is the share of all that is recorded, not of what is where they are sent.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft as sp_fft
from scipy import ndimage, special

from ..twin.columns import some_at_once
from ..twin.effects import Role, plays
from ..twin.interpolate import TAU
from ..twin.scene import reach
from . import offsets
from .policy import (
    ALL_BUT_A_CARRIER,
    EXPLAINED_LENGTHS,
    FARTHEST_NEAR,
    HALF_OF_NULLS,
    HALVES,
    LEAST_CARRIED,
    LEAST_NULLS,
    LEAST_OVERLAP,
    LEAST_WHOLE,
    LENGTHS,
    LIKELIER,
    LOUDEST_SHARE,
    NULLS,
    NULLS_OF_SHORT,
    ONE_PHASE,
    PIECES_AT_ONCE,
    PRESENCE_ALIKE,
    PRESENCE_AROUND,
    PRESENCE_ENVELOPE,
    PRESENCE_GROWTH,
    PRESENCE_PIECE,
    PRESENCE_SHORT,
    PRESENCE_SHORTEST,
    PRESENCE_SILENT,
    PRESENCE_SURE_NATS,
    PRESENT_NATS,
    STEADY,
)
from .residual import Leftover


@dataclass(frozen=True, kw_only=True)
class Presence:
    """`nats` by which chance does not explain what the waveform does; where it explains most: the carrier in cycles per sample,
    the delay in samples beyond the model's, and its share of the energy."""

    nats: float
    carrier: float = 0.0
    delay: int = 0
    share: float = 0.0

    @property
    def there(self) -> bool:
        return self.nats > PRESENT_NATS


def judge(data, model) -> Presence:
    """Whether the recording of `data` holds what a model sends, at the model's delay and in its orientation."""
    scene = data.scene
    latest = int(np.ceil(max(path.delay for path in scene.taps)))
    if not is_sent_within(scene, latest):
        return Presence(nats=-np.inf)
    y, effects = scene.spread(data.y), model.effects
    if model.inverted:  # oscillators are in front of the inversion
        y, effects = np.conj(y), tuple(e for e in effects if not plays(e, Role.ORIENTATION))
    inside = scene.spread(reach(scene, 0, latest, model.base[0]).astype(float))
    signals = np.array([scene.spread(s) for s in offsets.sent(scene, model.base, effects)])
    source = scene.sources[0]
    period = len(source.samples) if source.repeat else 0
    tried = period or scene.whole + scene.span
    told = look(y, signals, inside, period, tried)
    if told.there:
        return told
    return look(within(y, scene.sources), signals, inside, period, tried, by_places=is_of_one_phase(scene.sources))


def is_sent_within(scene, latest: int) -> bool:
    """Whether enough of what is sent falls into the recording at all, up to `latest` samples late: the tails of its interpolation
    are no waveform."""
    if any(source.repeat for source in scene.sources):
        return True
    sent = 0
    for source in scene.sources:
        first = scene.first - source.origin
        sent += np.count_nonzero(source.samples[max(first - latest, 0) : max(first + scene.count, 0)])
    return sent >= min(PRESENCE_SHORTEST, scene.count // 2)


def within(y: np.ndarray, sources) -> np.ndarray:
    """A recording (n,) whose amplitudes stay within those of what is sent, as all but the loudest of both have them: else a few
    impulses hold all of its energy, and no waveform."""
    sent = np.concatenate([np.abs(s.samples[s.known]) for s in sources])
    most, heard = np.quantile(sent, LOUDEST_SHARE), np.quantile(np.abs(y), LOUDEST_SHARE)
    if not most or not heard:
        return y
    return y / np.maximum(1.0, np.abs(y) / (heard * sent.max() / most))


def look(y, signals, inside, period: int = 0, tried: int = 1, by_places: bool = False) -> Presence:
    """`judge` of arrays: recording (n,), what each transmitter sends (sources, n), 1 where a sample counts (n,); `period` of
    what repeats, the number of delays that were `tried`; `by_places`, where phases tell nothing."""
    best = Presence(nats=-np.inf)
    for length in LENGTHS:
        best = max(best, _look(y, signals, inside, period, tried, length, PRESENCE_SURE_NATS), key=lambda p: p.nats)
        if best.nats > PRESENCE_SURE_NATS or length >= len(y):
            break
    if not best.there:  # one half alone may hold it: samples may be lost between, and what is at other delays then is no chance
        length, again = (len(y), 0) if len(y) < PRESENCE_SHORT else (LENGTHS[-1], period)
        for half in (slice(None, len(y) // 2), slice(len(y) // 2, None)):
            told = _look(y[half], signals[:, half], inside[half], again, HALVES * tried, length, PRESENCE_SURE_NATS)
            best = max(best, told, key=lambda p: p.nats)
    if not best.there and by_places:
        told = _look(y, signals, inside, period, 2 * tried, len(y), PRESENCE_SURE_NATS, by_places=True)
        best = max(best, told, key=lambda p: p.nats)
    return best


def is_of_one_phase(sources) -> bool:
    """Whether all that is sent are pulses of one phase, which nothing but their places and amplitudes tell from another's."""
    for source in sources:
        amplitudes = np.abs(source.samples)
        if abs(np.vdot(amplitudes, source.samples)) < ONE_PHASE * np.vdot(amplitudes, amplitudes):
            return False
    return True


def likelier(options, period: int, tried: int) -> int | None:
    """Which of several (recording, what is sent, 1 where a sample counts) holds most, measured alike: the first one, unless
    another holds clearly more; None where none holds more than chance."""
    for length in LENGTHS:
        nats = [_look(*option, period, tried, length, np.inf).nats for option in options]
        if max(nats) > PRESENT_NATS:
            break
    best = int(np.argmax(nats))
    if nats[best] <= PRESENT_NATS:
        return None
    is_more = nats[best] > LIKELIER * nats[0] + PRESENT_NATS
    # Where both may be there, what either explains with its envelope tells more than what it does without.
    return best if is_more and (nats[0] <= PRESENT_NATS or _explained_nats(*options[best]) > _explained_nats(*options[0])) else 0


def _explained_nats(y, signals, inside) -> float:
    """Nats by which what is sent explains a recording, with gains for stretches of the length that tells most."""
    y, count, best = y * inside, float(inside.sum()), 0.0
    for length in EXPLAINED_LENGTHS:
        edges = np.arange(0, len(y), length)
        common, sent = (np.add.reduceat(part, edges, axis=1) for part in (signals.conj() * y, np.abs(signals * inside) ** 2))
        held = np.sum(np.abs(common) ** 2 / np.maximum(sent, 1e-300)) / np.vdot(y, y).real
        best = max(best, float(-count * np.log(1 - min(held, 0.999999)) - common.size * np.log(count)))
    return best


def _look(y, signals, inside, period: int, tried: int, length: int, sure: float, by_places: bool = False) -> Presence:
    """`look` at a stretch of so many samples, until so many nats are there; `by_places`: by what is explained of all that is
    recorded, not of what is recorded where it is sent."""
    whole = min(len(y), length)
    y, signals, inside = _on_air(*_fullest(y, signals, inside, length))
    if len(y) < PRESENCE_SHORTEST:
        return Presence(nats=np.inf if len(y) > LEAST_WHOLE * whole else -np.inf)
    if not by_places:
        signals = _without_envelopes(signals, inside)
    near, *others = _delays(len(y), period)
    others = [_unlike(signals, inside, delays) for delays in others]
    delays = np.concatenate([near, *others])
    pieces = [_pieces(y, s, inside, delays) for s in signals]
    overlap, met = (np.mean([energies[k].sum(1) for _, energies in pieces], axis=0) for k in (0, 1))
    heard = (overlap > LEAST_OVERLAP * overlap.max()) & (met > 0)
    edges = len(near) + np.cumsum([0, *map(len, others)])
    elsewhere = [at for a, b in zip(edges, edges[1:], strict=False) if len(at := a + np.flatnonzero(heard[a:b])) >= LEAST_NULLS]
    if not elsewhere and by_places:  # only places could tell, and none does
        return Presence(nats=-np.inf)
    if not elsewhere:  # there is nothing that it could be compared with
        return Presence(nats=np.inf if len(y) > LEAST_WHOLE * whole else -np.inf)
    best, count = Presence(nats=-np.inf), pieces[0][0].shape[1]
    lengths = sorted(
        {min(PRESENCE_GROWTH**k, count) for k in range(1, 2 + int(np.ceil(np.log(count) / np.log(PRESENCE_GROWTH))))}
    )
    for together in lengths:
        explained, most, gains = (sum(parts) for parts in zip(*(_added(*piece, together) for piece in pieces), strict=True))
        if by_places:
            most = np.full(len(delays), len(signals) * np.sum(np.abs(y * inside) ** 2))
        share = explained / np.maximum(most, 1e-300)[:, None]
        trials = np.log(tried * share.shape[1] * len(lengths) * 2.0)  # both orientations
        here = np.where(heard[: len(near), None], share[: len(near)], 0.0)
        nats = _nats(here, [share[at] for at in elsewhere], gains) - trials
        d, k = np.unravel_index(int(np.argmax(nats)), nats.shape)
        if nats[d, k] > best.nats:
            carrier = float(sp_fft.fftfreq(share.shape[1])[k] / PRESENCE_PIECE)
            best = Presence(nats=float(nats[d, k]), carrier=carrier, delay=int(near[d]), share=float(share[d, k]))
        if best.nats > sure:
            break
    return best


def _fullest(y, signals, inside, length: int):
    """The stretch of so many samples in which most of what is sent counts."""
    if len(y) <= length:
        return y, signals, inside
    sent = np.concatenate([[0.0], np.cumsum((np.abs(signals) ** 2).sum(0) * inside)])
    first = int(np.argmax(sent[length:] - sent[:-length]))
    at = slice(first, first + length)
    return y[at], signals[:, at], inside[at]


def _on_air(y, signals, inside):
    """The stretch from the first to the last sample that is sent, in which other delays meet the same recording."""
    power = (np.abs(signals) ** 2).sum(0) * inside
    sent = np.flatnonzero(power > PRESENCE_SILENT * np.mean(power))
    at = slice(sent[0], sent[-1] + 1) if len(sent) else slice(0, 0)
    return y[at], signals[:, at], inside[at]


def _without_envelopes(signals, inside):
    """What is sent without what it has of its own envelope, at the carrier that it has much of it at or else at its middle, for
    any signal that is on at these times would explain that as much. What is all but a carrier keeps that."""
    envelopes = inside * ndimage.uniform_filter1d(np.abs(signals * inside), PRESENCE_ENVELOPE, mode="constant")
    energies, n = np.maximum((envelopes**2).sum(1), 1e-300), signals.shape[1]
    size = sp_fft.next_fast_len(4 * n)
    at = np.argmax(np.abs(sp_fft.fft(envelopes * signals, size, axis=1)), axis=1)
    carriers = np.exp(TAU * 1j * sp_fft.fftfreq(size)[at][:, None] * np.arange(n))
    held = (envelopes * signals * carriers.conj()).sum(1)
    share = np.abs(held) ** 2 / np.maximum(energies * (np.abs(signals * inside) ** 2).sum(1), 1e-300)
    stays = (share < LEAST_CARRIED) | (share > ALL_BUT_A_CARRIER)
    carriers[stays], held[stays] = 1.0, (envelopes * signals).sum(1)[stays]
    return signals - (held / energies)[:, None] * envelopes * carriers


def _delays(n: int, period: int):
    """Whole samples around the delay that was found: where the waveform may be, and near and far where it is not."""
    size = min(n, period or n)
    reach = min(PRESENCE_AROUND, size // 8)
    near = np.arange(-reach, reach + 1)
    room = size - 4 * reach  # from 2·reach to −2·reach around
    end = min(FARTHEST_NEAR, room // 3)
    most = NULLS_OF_SHORT if n < PRESENCE_SHORT else NULLS
    steps = np.unique(np.linspace(2 * reach, 2 * reach + max(end, 1), min(most // 2, max(end, 1))).astype(int))
    close = np.concatenate([steps, -steps])
    low, high = 2 * reach + end, size - 2 * reach - end
    far = np.unique(np.linspace(low, high, min(most, max(high - low, 1)) + 2).astype(int)[1:-1])
    return near, close, far


def _unlike(signals, inside, delays) -> np.ndarray:
    """The delays at which what is sent is not what it is without them."""
    sent = signals * inside
    whole = np.sum(np.abs(sent) ** 2)
    alike = np.array([abs(np.vdot(np.roll(signals, d, axis=1), sent)) for d in delays])
    return delays[alike < PRESENCE_ALIKE * whole]


def _pieces(y, sent, inside, delays):
    """((delays, pieces) sums of recording × waveform*; (3, delays, pieces) energy of the waveform in each, of the products, and
    samples that are no silence)."""
    count, y, every = len(y) // PRESENCE_PIECE, y * inside, np.ones(PRESENCE_PIECE)
    heard, power = np.abs(y) ** 2, np.abs(sent) ** 2
    loud, mirrored = power > PRESENCE_SILENT * np.mean(power), np.conj(sent)
    products, energies = np.empty((len(delays), count), complex), np.empty((3, len(delays), count))
    for i, d in enumerate(delays):
        moved = np.roll(power, d)
        for row, x in (
            (products, y * np.roll(mirrored, d)),
            (energies[0], moved * inside),
            (energies[1], heard * moved),
            (energies[2], np.roll(loud, d) * inside),
        ):
            row[i] = x[: count * PRESENCE_PIECE].reshape(count, PRESENCE_PIECE) @ every
    return products, energies


def _added(products, energies, together: int):
    """((delays, carriers) energy that the waveform explains with a gain for every `together` pieces; (delays,) the most that it
    can, whose share is that of random phases whatever the amplitudes of both; number of gains)."""
    delays, count = products.shape
    groups = -(-count // together)
    size = sp_fft.next_fast_len(2 * together)
    sent, met, loud = np.add.reduceat(energies, np.arange(0, count, together), axis=2)
    heard = sent > PRESENCE_SILENT * sent.mean(1, keepdims=True)
    weight = heard / np.where(heard, sent, 1.0)
    explained = np.empty((delays, size))
    for some in some_at_once(np.arange(delays), groups * size, PIECES_AT_ONCE):
        sums = np.zeros((len(some), groups * together), np.complex64)  # what is told are shares, by their tails
        sums[:, :count] = products[some]
        sums = sp_fft.fft(sums.reshape(len(some), groups, together), size, axis=2)
        explained[some] = np.einsum("dgk,dg->dk", sums.real**2 + sums.imag**2, weight[some])
    return explained, (met * loud * weight).sum(1), max(1.0, float(heard.sum(1).mean()))


def _nats(here, elsewhere, gains: float) -> np.ndarray:
    """(delays, carriers) −ln of the chance of shares as large as `here`, or larger, by the Beta distribution of those
    `elsewhere`, [(delays, carriers)]: Chernoff's bound, and as much less as mean and spread are known from few."""
    middle = np.maximum.reduce([np.median(s, axis=0) for s in elsewhere])
    spread = np.maximum(np.maximum.reduce([np.var(s, axis=0) for s in elsewhere]), 1e-30)
    middle = np.clip(middle, 1e-12, 0.999)
    white, seen = gains / middle, np.maximum(middle * (1 - middle) / spread - 1, 1e-3)
    steady = seen > STEADY * white
    mean = np.where(steady, middle, np.clip(middle * gains / special.gammaincinv(gains, 0.5), 1e-12, 0.999))
    count = np.where(steady, seen, np.maximum(np.minimum(white, seen), 1 / mean))
    share = np.clip(here, mean, 1 - 1e-9)
    rate = count * (mean * np.log(mean / share) + (1 - mean) * np.log((1 - mean) / (1 - share)))
    known = HALF_OF_NULLS * min(len(s) for s in elsewhere) * np.where(steady, 1.0, np.maximum(count * mean, 1.0))
    return known * np.log1p(rate / known)


def statement(scene, delays: tuple[int, int], widest: float) -> Leftover:
    """What is said of a recording that holds nothing of the waveform: it was looked for at these delays, in samples, and with
    carriers up to the widest, in cycles per sample."""
    rate = scene.sample_rate_hz
    first, last = (d / rate for d in delays)
    edge = widest * rate
    where = {
        "signal_absent": True,
        "sentence": "The twin's waveform is not in this recording, or too weak to be told from chance: at no delay, no carrier "
        "and in neither orientation does it explain more than it would of any other signal.",
        "searched": {"delay_s": [first, last], "carrier_hz": [-edge, edge], "inverted": [False, True]},
        "record_next": "longer_recording",
    }
    return Leftover(test="presence", p_value=1.0, nats=0.0, where=where, record_next=where["record_next"])


def of_a_part(finding) -> Leftover:
    """What is said of a part of a recording that holds nothing of the waveform, while another part does."""
    first = finding.observation.first / finding.scene.sample_rate_hz
    where = {
        "time_s": [first, first + finding.scene.duration_s],
        "sentence": "The twin's waveform is not in this part of the recording.",
    }
    return Leftover(test="presence", p_value=0.0, nats=0.0, where=where)
