# SPDX-License-Identifier: GPL-3.0-or-later
"""What is fixed in one recording: the waveforms on the air, the twin's paths, its samples."""

import copy
from dataclasses import dataclass, field

import numpy as np
from scipy import fft as sp_fft

from .basis import course, course_length, course_on, grid_of
from .interpolate import TAU, frequencies, oversampled, phasor

PAD = 1024  # samples of silence or of wrap-around kept around a waveform that is sent once
OVERSAMPLING = 8
BINS = 512  # of a coarse spectrum
FADE = 16  # samples over which what is known of a waveform fades where the rest is not
KEPT_DELAYS = 16
KEPT_TABLES = 4
ROUNDING = 1e-6  # share of a waveform's energy that the format of its file leaves across the line on which it lies


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
    samples: np.ndarray  # (p,) complex128, unknown samples are `bridged`
    repeat: bool
    known: np.ndarray  # (p,) bool
    power: float  # mean power over the known samples of the whole waveform
    peak: float  # largest magnitude of the whole waveform
    origin: int = -PAD

    @property
    def on_one_line(self) -> bool:
        """Whether all samples have one phase or its opposite: mirrored, the waveform is itself but for a turn."""
        energy = float(np.vdot(self.samples, self.samples).real)
        return energy - abs(np.sum(self.samples**2)) < ROUNDING * energy


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

    def on_air(self) -> np.ndarray:
        """(n,) bool: where something is sent, to some samples."""
        if any(s.repeat for s in self.sources):
            return np.ones(self.count, bool)
        at = PAD + self.place.astype(int)
        return np.any([s.samples[at] != 0 for s in self.sources], axis=0)

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
            self._turns[key] = phasor(-TAU * delay * f)
            if size % 2 == 0:  # half of it turns one way, half the other
                self._turns[key][size // 2] = np.cos(np.pi * delay)
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
        """(…, span) signals (…, count) on the whole axis of time, zero where samples are left out."""
        if self.at is None:
            return signal
        whole = np.zeros((*signal.shape[:-1], self.span), signal.dtype)
        whole[..., self.at] = signal
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


def bridged(samples: np.ndarray, known: np.ndarray, repeat: bool) -> np.ndarray:
    """(n,) complex samples, those that are not `known` (n,) bool faded from the last and to the next known one, silent between:
    an edge to nothing would ring far into what is known wherever a signal is read between its samples."""
    clean = np.where(known, samples, 0).astype(complex)
    if known.all() or not known.any():
        return clean
    edge, size = np.flatnonzero(known), len(known)
    gap = np.flatnonzero(~known)
    after = np.searchsorted(edge, gap)
    filled, total = np.zeros(len(gap), complex), np.zeros(len(gap))
    for nearest in (after - 1, after):
        there = edge[nearest % len(edge)]
        far = np.abs(gap - there)
        far = np.minimum(far, size - far) if repeat else np.where((nearest >= 0) & (nearest < len(edge)), far, size)
        weight = np.where(far <= FADE, 0.5 + 0.5 * np.cos(np.pi * far / (FADE + 1)), 0.0)
        filled, total = filled + weight * clean[there], total + weight
    clean[gap] = filled / np.maximum(total, 1.0)
    return clean


def resampled_spectrum(samples: np.ndarray, size: int = BINS) -> np.ndarray:
    """`size` values whose FFT magnitude is the amplitude spectrum of `samples` (Welch's method)."""
    if len(samples) < size:
        samples = np.resize(samples, size)
    count = len(samples) // size
    blocks = samples[: count * size].reshape(count, size)
    return sp_fft.ifft(np.sqrt(np.mean(np.abs(sp_fft.fft(blocks * np.hanning(size), axis=1)) ** 2, axis=0)))


def reach(scene: Scene, low: int, high: int, delay: float = 0.0) -> np.ndarray:
    """(count,) bool: recorded samples for which every waveform sample from `low` to `high` samples back is known, once what was
    sent is `delay` samples late."""
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
            valid &= ~np.roll(hit, round(delay))[scene.wrap(len(bad))]
        else:  # its window begins with what the recording's first sample is
            valid &= ~hit[PAD : PAD + scene.count]
    return valid
