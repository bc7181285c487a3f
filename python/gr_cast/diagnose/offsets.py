# SPDX-License-Identifier: GPL-3.0-or-later
"""Carrier offset, sample clock and delay of a recording of which only stretches are known, before anything is fitted.

Within a stretch neither the clock nor a carrier of some kHz does harm, so that the correlations of every stretch with what
was sent, lag by lag, hold all that is to be known. Turned by a carrier and shifted by a clock they add up with their phases:
the pair under which they hold most energy, over all lags (every echo counts) and all transmitters, is the likeliest.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft as sp_fft

from ..twin.effects import FAMILIES, Role, plays, with_role
from ..twin.effects.base import start
from ..twin.interpolate import TAU, phasor
from ..twin.model import Model, _run, _start_chain, predict
from .fit import misfit
from .policy import (
    CARRIER_STEP,
    CLOCK_STEP,
    DRIFT_BLOCKS,
    DRIFT_CLEAR,
    DRIFT_SMEARS,
    DRIFT_STEP,
    EARLY,
    LATE,
    LOBES,
    LONGEST_STRETCH,
    MOST_DRIFT,
    OFFSET_PIECE,
    TEETH,
    TOLD_SIGMA,
    WORST_CLOCK,
)


@dataclass(frozen=True, kw_only=True)
class Offset:
    """Carrier in cycles and clock in samples gained, both over the recording; delay in samples beyond the model's."""

    cycles: float
    gained: float
    delay: float


def models(data, model: Model) -> list[Model]:
    """The model with the likeliest offset of the carrier alone, and with those of carrier and clock, its gains fitted."""
    scene, out, y, effects = data.scene, [], data.y * (data.use > 0), model.effects
    if model.inverted:  # oscillators are in front of the inversion
        y, effects = np.conj(y), tuple(e for e in effects if not plays(e, Role.ORIENTATION))
    for offset in find(scene, model.base, y, effects):
        carrier = start(with_role(Role.CARRIER), [offset.cycles, 0.0], trials=scene.span)
        carrier = replace(carrier, free=FAMILIES[carrier.family].settled(scene, carrier))
        base = np.concatenate([[model.base[0] + offset.delay], model.base[1:]])
        other = replace(model, base=base).adding(carrier)
        if offset.gained:
            other = other.adding(start(with_role(Role.CLOCK), [_of_one_oscillator(scene, offset)], trials=20))
        out.append(_best_tooth(data, other))
    return out


def turning(data, model: Model, told: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(cycles over the recording, magnitude) of the spectrum in which a recording turns against what a model has `told` (n,)."""
    product = _product(data, model, told)
    size = sp_fft.next_fast_len(4 * len(product))
    return sp_fft.fftfreq(size) * len(product), np.abs(sp_fft.fft(product, size))


def drifting(data, model: Model, told: np.ndarray) -> tuple[float, float] | None:
    """(cycles over the recording at its middle, cycles of drift) with which it turns ever faster against what a model has `told`
    (n,); None where a steady turn holds much of what short stretches do, or a drift hardly more."""
    product = _product(data, model, told)
    n, size = len(product), sp_fft.next_fast_len(len(product))
    blocks = product[: n // DRIFT_BLOCKS * DRIFT_BLOCKS].reshape(DRIFT_BLOCKS, -1)
    steady = np.abs(sp_fft.fft(product, size)).max()
    if blocks.shape[1] < DRIFT_BLOCKS or steady > DRIFT_SMEARS * np.abs(sp_fft.fft(blocks, axis=1)).max(1).sum():
        return None
    bend = np.pi * (np.arange(n) / n - 0.5) ** 2

    def turned(drift):
        return np.abs(sp_fft.fft(product * phasor(-drift * bend), size))

    drift = max(np.arange(-MOST_DRIFT, MOST_DRIFT + 1, DRIFT_STEP), key=lambda one: turned(one).max())
    drift = max(drift + np.arange(-DRIFT_STEP, DRIFT_STEP + 1), key=lambda one: turned(one).max())
    k = int(np.argmax(spectrum := turned(drift)))
    return (float(sp_fft.fftfreq(size)[k] * n), float(drift)) if spectrum[k] > DRIFT_CLEAR * steady else None


def _product(data, model: Model, told: np.ndarray) -> np.ndarray:
    """The recording, before an inversion, times the conjugate of what is told."""
    product = data.scene.spread(data.y * np.conj(told) * data.use)
    return np.conj(product) if model.inverted else product


def within_told(data, model: Model) -> Model:
    """The model where the recording has the twin's own oscillators: its delay anywhere that a clock which the twin knows moves it
    to over the recording, its carrier as far off as the twin's standard deviation allows. Nearer, a fit finds both."""
    at = model.index_of(Role.CARRIER)
    told = 0.0 if at is None else TOLD_SIGMA * model.effects[at].aux.get("_told", [0.0])[0]
    gained = sum(e.p[0] for e in model.effects if plays(e, Role.CLOCK))
    if abs(gained) < 1.0 and told < CARRIER_STEP:
        return model
    late = np.arange(-1, np.ceil(abs(gained)) + 2) * np.sign(gained) if abs(gained) >= 1.0 else [0.0]
    models = [replace(model, base=np.concatenate([[model.base[0] + d], model.base[1:]])) for d in late]
    against = lambda m: turning(data, m, predict(data.scene, m).wanted)  # noqa: E731
    model = max(models, key=lambda m: against(m)[1].max())
    if told < CARRIER_STEP:
        return model
    cycles, magnitude = against(model)
    moved = cycles[int(np.argmax(np.where(np.abs(cycles) <= told, magnitude, 0.0)))]
    own = model.effects[at]
    return model.replacing(at, own.moved(own.p + moved * (np.arange(len(own.p)) == 0)))


def _best_tooth(data, model: Model) -> Model:
    """The model, gains fitted, with the carrier under which it explains most of those that stretches at regular intervals make
    alike: what is within a stretch tells them apart, all samples together."""
    scene = data.scene
    firsts = [scene.index[a] for a, _ in stretches(scene, scene.count)]
    at = model.index_of(Role.CARRIER, found=True)
    teeth = scene.span / np.median(np.diff(firsts)) * np.arange(-TEETH, TEETH + 1) if len(firsts) > 2 else [0.0]
    moved = [model.effects[at].moved(model.effects[at].p + [cycles, 0.0]) for cycles in teeth]
    models = [with_gains(data, model.replacing(at, carrier)) for carrier in moved]
    return min(models, key=lambda m: misfit(data, predict(scene, m).y))


def _of_one_oscillator(scene, offset: Offset) -> float:
    """The clock of the oscillator that makes the carrier, where that is as near as the search tells."""
    tied = offset.cycles / scene.duration_s / scene.carrier_hz * scene.span if scene.carrier_hz else 0.0
    return tied if abs(tied - offset.gained) < 2 * CLOCK_STEP else offset.gained


def with_gains(data, model: Model) -> Model:
    """The model with gain and phase of the whole and of every free port at their least squares."""
    scene, w, base, ports = data.scene, data.root, model.base, data.scene.free_ports
    rows = [_alone(scene, base, model.effects, dict.fromkeys(ports, 0.0))]
    if ports:
        rows += [*sent_alone(scene, base, model.effects)[list(ports)]]
    gains = np.linalg.lstsq((np.array(rows) * w).T, data.y * w, rcond=None)[0]
    if model.inverted:
        gains = np.conj(gains)
    shares = gains[1:] / gains[0]
    return replace(model, base=np.array([base[0], gains[0].real, gains[0].imag, *np.ravel([[g.real, g.imag] for g in shares])]))


def sent(scene, base, effects) -> np.ndarray:
    """(sources, n) what each source alone adds to the prediction at a model's delay and a gain of 1."""
    every = range(len(scene.sources))
    return np.array([_alone(scene, base, effects, {k: float(k == i) for k in every}) for i in every])


def sent_alone(scene, base, effects) -> np.ndarray:
    """`sent` without what is there without any source, and is no transmitter's."""
    return sent(scene, base, effects) - _alone(scene, base, effects, dict.fromkeys(range(len(scene.sources)), 0.0))


def _alone(scene, base, effects, ports) -> np.ndarray:
    """(n,) the prediction at a gain of 1 with these gains of the sources."""
    chain = _start_chain(scene, base)
    chain.ports = ports
    return _run(scene, [base[0], 1.0, 0.0], effects, chain, 0).y


def stretches(scene, longest: int) -> list[tuple[int, int]]:
    """[(first, last + 1)] of the samples that follow each other without a gap, cut where they are longer."""
    cuts = [0, *(np.flatnonzero(np.diff(scene.index) > 1) + 1), scene.count]
    found = []
    for a, b in zip(cuts, cuts[1:], strict=False):
        pieces = -(-(b - a) // longest)
        edges = np.linspace(a, b, pieces + 1).astype(int)
        found += zip(edges, edges[1:], strict=False)
    return [(int(a), int(b)) for a, b in found]


def find(scene, base, y: np.ndarray, effects=()) -> list[Offset]:
    """The likeliest offset of the carrier alone, and that of carrier and clock; `y` (n,) zero where it is not used."""
    signals, whole, pieces = sent(scene, base, effects), stretches(scene, LONGEST_STRETCH), stretches(scene, OFFSET_PIECE)
    widest = int(np.ceil(WORST_CLOCK * scene.span))
    lags = np.arange(EARLY - widest, LATE + widest + 1)
    coarse = _coarse(y, signals, whole)
    turned = y * phasor(-TAU * coarse * scene.index)
    table = np.array([[_lagged(turned, s, a, b, lags) for s in signals] for a, b in pieces])  # (pieces, sources, lags)
    middle = np.array([scene.index[(a + b) // 2] for a, b in pieces]) / scene.span
    length = np.median([b - a for a, b in whole])
    reach = LOBES / length * scene.span  # cycles over the recording
    size = sp_fft.next_fast_len(len(lags) + 2 * widest)
    spectrum, f = sp_fft.fft(table, size, axis=-1), sp_fft.fftfreq(size)

    def best(gained: float, cycles: np.ndarray) -> tuple[float, Offset]:
        """(energy, the best of these carriers) at a clock: the lag of a fast clock falls by `gained` over the recording."""
        turns = phasor(-TAU * np.outer(cycles - coarse * scene.span, middle))
        ramp = phasor(-TAU * gained * middle[:, None] * f)[:, None]
        level = sp_fft.ifft(spectrum * ramp, axis=-1)[..., : len(lags)]
        sums = np.abs(np.tensordot(turns, level, 1)) ** 2  # (carriers, sources, lags)
        inside = sums[..., widest : len(lags) - widest].sum(1)
        k = int(np.argmax(inside.sum(1)))
        delay = lags[widest + int(np.argmax(inside[k]))]
        return float(inside[k].sum()), Offset(cycles=float(cycles[k]), gained=float(gained), delay=float(delay))

    wide = coarse * scene.span + np.arange(-reach, reach, CARRIER_STEP)
    clocks = np.arange(-widest, widest + CLOCK_STEP, CLOCK_STEP)
    _, first = max((best(g, wide) for g in clocks), key=lambda b: b[0])
    near = np.linspace(-1, 1, 21)
    around = first.cycles + CARRIER_STEP * near
    _, fine = max((best(first.gained + CLOCK_STEP * s, around) for s in near[::2]), key=lambda b: b[0])
    return [best(0.0, wide)[1], fine]


def _coarse(y, signals, pieces) -> float:
    """Cycles per sample by which the recording turns within its stretches, over all lags and sources."""
    size = sp_fft.next_fast_len(2 * max(b - a for a, b in pieces))
    total = np.zeros(size)
    for a, b in pieces:
        for s in signals:
            rows = np.zeros((LATE - EARLY + 1, size), complex)
            for row, lag in zip(rows, range(EARLY, LATE + 1), strict=True):
                low, high = max(a, lag), min(b, len(s) + lag)
                row[low - a : high - a] = y[low:high] * np.conj(s[low - lag : high - lag])
            total += (np.abs(sp_fft.fft(rows, axis=1)) ** 2).sum(0)
    return float(sp_fft.fftfreq(size)[int(np.argmax(total))])


def _lagged(y, signal, a: int, b: int, lags) -> np.ndarray:
    """(lags,) Σ y[n]·conj(signal[n − lag]) over the stretch from a to b."""
    size = sp_fft.next_fast_len(b - a + len(lags))
    low, high = a - int(lags[-1]), b - int(lags[0])
    template = np.zeros(high - low, complex)
    inside = slice(max(low, 0), min(high, len(signal)))
    template[inside.start - low : inside.stop - low] = signal[inside]
    # template[k] is signal[a − last lag + k]: lag d pairs y[a + i] with template[i + last lag − d]
    both = sp_fft.ifft(np.conj(sp_fft.fft(y[a:b], size)) * sp_fft.fft(template, size))
    return np.conj(both[: len(lags)][::-1])
