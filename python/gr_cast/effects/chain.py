# SPDX-License-Identifier: GPL-3.0-or-later
"""The forward model of one recording: transmitter → channel → environment → receiver, as a chain of steps.

A `Scene` holds what is fixed (waveforms, twin's taps, sample count); a `Chain` is the signal on its way
through the steps.
Effects only ever replace attributes of a chain (never write into its arrays), so that a copy of the chain
before any step
can be kept and the rest of the chain run again: this is how derivatives are taken.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import fft as sp_fft

from .basis import course, course_length, course_on, grid_of

TAU = 2 * np.pi
PAD = 1024  # samples of silence or of wrap-around kept around a waveform that is sent once
OVERSAMPLING = 8
BINS = 512  # of a coarse spectrum
KEPT_DELAYS = 16
KEPT_TABLES = 4
SLOW = 3e-4  # by which a gain may change between two paths that are taken together
FEW_PATHS = 3  # that are cheaper one by one from a table than together by an FFT


@dataclass(frozen=True, kw_only=True)
class Path:
    """One path of a source. Delay in samples, on the scale of the twin's taps; Doppler in cycles over the
    recording."""

    source: int
    delay: float
    gain: complex
    doppler: float = 0.0
    drift: float = 0.0  # samples that the delay grows over the recording
    track: np.ndarray | None = None  # (n,) complex factor over time
    shape: np.ndarray | None = None  # taps at whole samples from `delay` on, instead of one


@dataclass(frozen=True, kw_only=True)
class Source:
    """A waveform as the channel sees it: one period, or a window around the recording, from its sample `origin` on."""

    name: str
    samples: np.ndarray  # (p,) complex128, unknown samples are 0
    repeat: bool
    known: np.ndarray  # (p,) bool
    power: float  # mean power over the known samples of the whole waveform
    peak: float  # largest magnitude of the whole waveform
    origin: int = -PAD


@dataclass(kw_only=True)
class Scene:
    """One recording as the forward model needs it. `taps[i]` are the twin's paths of source i."""

    name: str
    sample_rate_hz: float
    count: int  # samples here
    sources: list[Source]
    taps: list[Path]
    transmitters: list[str]
    receiver: str
    anchor: int  # whole samples of delay already taken out of the sources
    carrier_hz: float | None = None
    free_ports: tuple[int, ...] = ()  # sources with a gain and phase of their own
    extra: dict[str, Source] = field(default_factory=dict)  # waveforms not on the air in the twin
    notes: dict = field(default_factory=dict)  # what effects keep between calls
    rms: float = 1.0  # of the wanted signal at the receiver as it was first known: the unit of internal levels
    level: float = 0.0  # the same as it is known now; 0: that
    floor: float = 1e-12  # the noise power that the twin tells
    front_end: np.ndarray = field(default_factory=lambda: np.ones(1))  # taps of the receiver's filter, where numbers are told
    begins: int = 0  # samples of the recording in front of what is looked at
    ahead: int = 0  # samples that the twin knows to be lost in front of what is looked at
    whole: int = 0  # samples of the whole recording; 0: that is looked at
    first: int = 0  # number of the first sample here
    span: int = 0  # samples that "over the recording" means; 0: those that are here
    at: np.ndarray | None = None  # (count,) whole numbers of the samples here, where only some of a stretch are kept

    def __post_init__(self):
        self.span = self.span or self.count
        self.whole = self.whole or self.span
        self._spectra, self._turns, self._tables = {}, {}, []
        self._number_samples()
        response = sum(np.abs(sp_fft.fft(resampled_spectrum(s.samples))) for s in self.sources)
        self.occupied = response > 0.1 * response.max()

    def _number_samples(self):
        self.place = self.first + np.arange(self.count, dtype=float)  # in a window of what was sent
        self.index = self.place if self.at is None else self.at.astype(float)
        self.u = self.index / self.span
        self._wraps = {}

    def stretch(self, first: int, count: int, sources: list[Source], extra: dict[str, Source]) -> "Scene":
        """Other samples of the same recording, `count` from number `first` on, with what was sent around them."""
        other = copy.copy(self)
        other.first, other.count, other.sources, other.extra, other._spectra, other._turns = first, count, sources, extra, {}, {}
        other.at, other._tables = None, []
        other._number_samples()
        return other

    def forget(self) -> None:
        """Let go of what is kept between calls."""
        self._wraps, self._spectra, self._turns, self._tables, self.notes = {}, {}, {}, [], {}

    def spectrum_of(self, code: str) -> np.ndarray:
        """Spectrum of a waveform that is not on the air in the twin."""
        if code not in self._spectra:
            self._spectra[code] = sp_fft.fft(self.extra[code].samples)
        return self._spectra[code]

    def spectrum_of_source(self, i: int) -> np.ndarray:
        if i not in self._spectra:
            self._spectra[i] = sp_fft.fft(self.sources[i].samples)
        return self._spectra[i]

    def density(self, code: int | str) -> np.ndarray:
        """(BINS,) shares of a waveform's power by frequency."""
        key = "density", code
        if key not in self.notes:
            source = self.sources[code] if isinstance(code, int) else self.extra[code]
            power = np.abs(sp_fft.fft(resampled_spectrum(source.samples, BINS))) ** 2
            self.notes[key] = power / power.sum()
        return self.notes[key]

    def table_of(self, wave: np.ndarray) -> np.ndarray:
        """A wave on a grid finer than its samples; the latest are kept, most steps of a derivative leave waves alone."""
        for known, table in self._tables:
            if known is wave:
                return table
        self._tables = [(wave, oversampled(sp_fft.fft(wave), OVERSAMPLING)), *self._tables[: KEPT_TABLES - 1]]
        return self._tables[0][1]

    def delayed(self, delay: float, size: int, carrier: float = 0.0) -> np.ndarray:
        """(size,) what a delay in samples makes of each bin of what is sent with a carrier offset of so many cycles per
        sample; the latest are kept, most steps of a derivative leave delays alone."""
        key = (delay, size, carrier)
        if key not in self._turns:
            if len(self._turns) >= KEPT_DELAYS:
                del self._turns[next(iter(self._turns))]
            f = frequencies(size)
            if carrier:  # what is moved over the band's edge comes in at the other one
                f = f - np.round(f + carrier)
            self._turns[key] = np.exp((-1j * TAU) * delay * f)
        return self._turns[key]

    def course(self, coefficients: np.ndarray, late: float = 0.0) -> np.ndarray:
        """(n,) the smooth course of these coefficients, so many samples late."""
        if late:
            return course_on(grid_of(coefficients), np.maximum(self.index - late, 0.0) / course_length(self.span))
        if self.at is not None:
            return course(coefficients, self.span)[self.at]
        if self.first == 0 and self.span == self.count:
            return course(coefficients, self.count)
        key = "course", hash(coefficients.tobytes())
        if key not in self.notes:  # one stretch after the other asks for the same
            self.notes[key] = grid_of(coefficients)
        return course_on(self.notes[key], self.index / course_length(self.span))

    def spread(self, signal: np.ndarray) -> np.ndarray:
        """(span,) a signal (count,) on the whole axis of time, zero where samples are left out."""
        if self.at is None:
            return signal
        whole = np.zeros(self.span, signal.dtype)
        whole[self.at] = signal
        return whole

    def drift_of(self, doppler: float) -> float:
        """Samples that a real path's delay grows over the recording when its Doppler is `doppler` cycles."""
        return -doppler * self.sample_rate_hz / self.carrier_hz if self.carrier_hz else 0.0

    @property
    def wanted_rms(self) -> float:
        """What levels are told relative to."""
        return self.level or self.rms

    @property
    def duration_s(self) -> float:
        return self.span / self.sample_rate_hz

    @property
    def whole_s(self) -> float:
        return self.whole / self.sample_rate_hz

    def wrap(self, period: int) -> np.ndarray:
        if period not in self._wraps:
            self._wraps[period] = self.index.astype(np.int64) % period
        return self._wraps[period]


def resampled_spectrum(samples: np.ndarray, size: int = BINS) -> np.ndarray:
    """`size` values whose FFT magnitude is the amplitude spectrum of `samples` (Welch's method)."""
    if len(samples) < size:
        samples = np.resize(samples, size)
    count = len(samples) // size
    blocks = samples[: count * size].reshape(count, size)
    return sp_fft.ifft(np.sqrt(np.mean(np.abs(sp_fft.fft(blocks * np.hanning(size), axis=1)) ** 2, axis=0)))


def frequencies(length: int) -> np.ndarray:
    """Cycles per sample of each bin of an FFT of `length`; the bin at half the rate counts as 0 (it has no
    sign)."""
    f = sp_fft.fftfreq(length)
    if length % 2 == 0:
        f[length // 2] = 0.0
    return f


def cubic(table: np.ndarray, position: np.ndarray, periodic: bool) -> np.ndarray:
    """Four-point Lagrange interpolation of `table` at `position` (in table samples)."""
    base = np.floor(position)
    x = position - base
    i = base.astype(np.int64)
    size = len(table)
    if periodic:
        at = lambda k: table[(i + k) % size]  # noqa: E731
    elif i.min() >= 1 and i.max() <= size - 3:
        at = lambda k: table[i + k]  # noqa: E731
    else:
        at = lambda k: table[np.clip(i + k, 0, size - 1)]  # noqa: E731
    below, above = x * (x - 1), (x + 1) * (x - 2)
    return (
        at(-1) * (below * (2 - x) / 6)
        + at(0) * (above * (x - 1) / 2)
        + at(1) * (above * x / -2)
        + at(2) * (below * (x + 1) / 6)
    )


def oversampled(spectrum: np.ndarray, factor: int) -> np.ndarray:
    """The band-limited signal of `spectrum` on a grid `factor` times finer."""
    p = len(spectrum)
    half = (p + 1) // 2
    wide = np.zeros(p * factor, complex)
    wide[:half] = spectrum[:half]
    wide[-(p - half) :] = spectrum[half:]
    return sp_fft.ifft(wide) * factor


def moved(spectrum: np.ndarray, shift: np.ndarray, orders: int, taken: Callable = lambda table: table) -> np.ndarray:
    """The signal of `spectrum` at times `shift` samples later, by a Taylor series; `taken`: which of its samples those are."""
    f = TAU * 1j * frequencies(len(spectrum))
    out, factor = 0.0, 1.0
    for order in range(orders + 1):
        out = out + factor * taken(sp_fft.ifft(spectrum))
        spectrum, factor = spectrum * f, factor * shift / (order + 1)
    return out


@dataclass(kw_only=True)
class Chain:
    """The signal on its way. Before the channel `waves` and `paths` are filled, after it `y` (count,)
    complex128."""

    scene: Scene
    delay: float
    ports: dict[int, complex]
    waves: list[np.ndarray] = field(default_factory=list)
    leaks: dict[int, complex] = field(default_factory=dict)
    carriers: dict[int, np.ndarray] = field(default_factory=dict)  # of a source: cycles at mid-recording, and of drift
    modulations: dict[int, list] = field(default_factory=dict)  # of a source: functions of a delay in samples → (n,) factor
    paths: list[Path] = field(default_factory=list)
    clock: float = 0.0  # samples that the received waveform gains over the recording
    shift: np.ndarray | None = None  # (n,) whole samples that the recording is ahead
    u: np.ndarray | None = None  # (n,) time as a share of the recording, with its jumps
    y: np.ndarray | None = None
    noise: Callable[["Chain"], np.ndarray] | None = None  # (n,) noise in front of the receiver, where it is played
    wanted: np.ndarray | None = None  # what of y comes from the wanted transmitters
    facing: int = 1  # −1 where y is the conjugate of what came

    def copy(self) -> "Chain":
        other = copy.copy(self)
        other.waves, other.paths, other.leaks = list(self.waves), list(self.paths), dict(self.leaks)
        return other

    def run_channel(self) -> None:
        """y = Σ paths; paths that share source, Doppler and track are added in the frequency domain."""
        scene = self.scene
        groups: dict[tuple, list[Path]] = {}
        fast = {i for i, factors in self.modulations.items() if self.late_by_its_path(i, factors)}
        for path in self.paths:
            alone = path.delay if path.source in fast else None
            groups.setdefault((path.source, path.doppler, path.drift, id(path.track), alone), []).append(path)
        y = np.zeros(scene.count, complex)
        spectra = {}
        carrier = {i: (self.carriers[i][0] / scene.span if i in self.carriers else 0.0) for i in range(len(self.waves))}
        for (i, doppler, drift, _, alone), paths in groups.items():
            stretch = self.clock - drift
            if self.slips(stretch) and len(paths) <= FEW_PATHS and all(p.shape is None for p in paths):
                signal = sum(
                    p.gain
                    * _behind(p, carrier[i])
                    * self.copy_of(scene.sources[i], self.waves[i], p.delay + self.delay, stretch)
                    for p in paths
                )
            else:
                if i not in spectra:
                    plain = self.waves[i] is scene.sources[i].samples
                    spectra[i] = scene.spectrum_of_source(i) if plain else sp_fft.fft(self.waves[i])
                response = sum(self._response(p, len(self.waves[i]), carrier[i]) for p in paths)
                signal = self.sample(scene.sources[i], spectra[i] * response, stretch)
            if doppler:
                signal = signal * np.exp(1j * TAU * doppler * self.u)
            if paths[0].track is not None:
                signal = signal * paths[0].track
            if i in self.carriers or i in self.modulations:
                signal = signal * self.sent(i, self._first_delay(i) if alone is None else alone)
            y += self.ports.get(i, 1.0) * signal
        for i, leak in self.leaks.items():
            for path in self.paths:
                if path.source == i:
                    tone = np.exp(1j * TAU * path.doppler * self.u) if path.doppler else 1.0
                    gain = path.gain if path.shape is None else path.gain * _turned_shape(path, carrier[i]).sum()
                    turn = _behind(path, carrier[i]) * self.sent(i, path.delay)
                    y += self.ports.get(i, 1.0) * leak * gain * tone * turn
        self.y = y
        self.wanted = self.y

    def modulate(self, source: int, factor: Callable[[float], np.ndarray]) -> None:
        """Put a factor over time on what a transmitter sends: a function of the samples by which it is late, to (n,)."""
        self.modulations = {**self.modulations, source: [*self.modulations.get(source, []), factor]}

    def late_by_its_path(self, source: int, factors: list) -> bool:
        """Whether factors over time of a transmitter differ between its paths."""
        delays = [p.delay for p in self.paths if p.source == source]
        if len(delays) < 2:
            return False
        first, last = min(delays), max(delays)
        return any(float(np.abs(factor(first) - factor(last)).max()) > SLOW for factor in factors)

    def turn(self, p: np.ndarray) -> np.ndarray:
        """(n,) the factor of a carrier offset of p[0] cycles at mid-recording and p[1] cycles of drift; kept between calls,
        most steps of a derivative leave the carrier alone."""
        held, key = self.scene.notes.get("carrier"), (*p, id(self.u))
        if held is None or held[0] != key:
            v = self.u - 0.5
            self.scene.notes["carrier"] = held = key, np.exp(1j * TAU * v * (p[0] + 0.5 * p[1] * v)), self.u
        return held[1]

    def sent(self, source: int, delay: float = 0.0):
        """(n,) what a transmitter's oscillator and gain make of a path of this delay, but for the carrier's own phase."""
        factor = self.turn(self.carriers[source]) if source in self.carriers else 1.0
        for over_time in self.modulations.get(source, []):
            factor = factor * over_time(delay)
        return factor

    def _first_delay(self, source: int) -> float:
        return next(p.delay for p in self.paths if p.source == source)

    def _response(self, path: Path, size: int, carrier: float) -> np.ndarray:
        turn = path.gain * _behind(path, carrier) * self.scene.delayed(path.delay + self.delay, size, carrier)
        return turn if path.shape is None else turn * sp_fft.fft(_turned_shape(path, carrier), size)

    def sample(self, source: Source, spectrum: np.ndarray, stretch: float) -> np.ndarray:
        """The signal of `spectrum` at the recording's samples; `stretch` samples are gained over the
        recording."""
        if self._moved(stretch) < 1e-7:
            return self._gather(source, sp_fft.ifft(spectrum))
        if not self.slips(stretch):  # a Taylor series is exact enough, and smooth for derivatives
            return moved(spectrum, stretch * self.u, 3, lambda table: self._gather(source, table))
        return self._interpolated(source, oversampled(spectrum, OVERSAMPLING), 0.0, stretch)

    def copy_of(self, source: Source, wave: np.ndarray, delay: float, stretch: float) -> np.ndarray:
        """`wave`, sent by a source, at the recording's samples: `delay` samples later, `stretch` gained over the recording."""
        return self._interpolated(source, self.scene.table_of(wave), delay, stretch)

    def slips(self, stretch: float) -> bool:
        """Whether so many samples are gained over the recording that a signal must be interpolated."""
        return self._moved(stretch) >= 0.05

    def _moved(self, stretch: float) -> float:
        return abs(stretch) * max(1.0, float(np.abs(self.u[[0, -1]]).max()))

    def _interpolated(self, source: Source, table: np.ndarray, delay: float, stretch: float) -> np.ndarray:
        index = self.scene.index if source.repeat else self.scene.place - source.origin
        index = index if self.shift is None else index + self.shift
        return cubic(table, (index - delay + stretch * self.u) * OVERSAMPLING, source.repeat)

    def _gather(self, source: Source, table: np.ndarray) -> np.ndarray:
        """The samples of a table that fall on the recording's samples, with its jumps."""
        scene = self.scene
        first = scene.first - source.origin
        if self.shift is None:
            return table[scene.wrap(len(table))] if source.repeat else table[first : first + scene.count]
        if source.repeat:
            return table[(scene.index.astype(np.int64) + self.shift) % len(table)]
        return table[np.clip(np.arange(scene.count) + self.shift + first, 0, len(table) - 1)]


def _behind(path: Path, carrier: float) -> complex:
    """What a path's delay makes of a transmitter's carrier of so many cycles per sample."""
    return np.exp((-1j * TAU) * carrier * path.delay) if carrier else 1.0


def _turned_shape(path: Path, carrier: float) -> np.ndarray:
    """The taps of a path, each as late as the transmitter's carrier finds it."""
    return path.shape * np.exp((-1j * TAU) * carrier * np.arange(len(path.shape))) if carrier else path.shape


def reach(scene: Scene, low: int, high: int) -> np.ndarray:
    """(count,) bool: recorded samples for which every waveform sample from `low` to `high` samples back is
    known."""
    valid = np.ones(scene.count, bool)
    for source in scene.sources:
        bad = ~source.known
        if not bad.any():
            continue
        if source.repeat:
            line = np.tile(bad, 3)[len(bad) - high : 2 * len(bad) - low]
        else:
            line = np.concatenate([np.zeros(max(high, 0)), bad, np.zeros(max(-low, 0))])
            line = line[: len(bad) + high - low]
        count = np.concatenate([[0], np.cumsum(line)])
        hit = count[high - low + 1 :] - count[: -(high - low + 1)] > 0
        if source.repeat:
            valid &= ~hit[scene.wrap(len(bad))]
        else:
            valid &= ~hit[PAD : PAD + scene.count]
    return valid
