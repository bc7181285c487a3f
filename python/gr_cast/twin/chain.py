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

from .interpolate import TAU, cubic, moved, oversampled, phasor, turning
from .scene import OVERSAMPLING, Path, Scene, Source

SLOW = 3e-4  # by which a gain may change between two paths that are taken together
KEPT = 1 << 22  # samples of signals that arrived, all places together
FEW_PATHS = 3  # that are cheaper one by one from a table than together by an FFT


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
    pace: float = 1.0  # of the receiver's time over its samples' count
    shift: np.ndarray | None = None  # (n,) whole samples that the recording is ahead
    silent: np.ndarray | None = None  # (n,) bool: zeros were written in the place of what came
    u: np.ndarray  # (n,) time as a share of the recording, with its jumps
    y: np.ndarray = field(default_factory=lambda: np.zeros(0))
    noise: Callable[["Chain"], np.ndarray] | None = None  # (n,) noise in front of the receiver, where it is played
    wanted: np.ndarray = field(default_factory=lambda: np.zeros(0))  # what of y comes from the wanted transmitters
    facing: int = 1  # −1 where y is the conjugate of what came
    turned: float = 0.0  # cycles over the recording amid it by which the receiver's oscillators have turned what came

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
        spectra: dict[int, np.ndarray] = {}
        carrier = {i: (self.carriers[i][0] / scene.span if i in self.carriers else 0.0) for i in range(len(self.waves))}
        for place, ((i, *_, alone), paths) in enumerate(groups.items()):
            signal = self._arrived(place, i, paths, carrier[i], spectra)
            if i in self.carriers or i in self.modulations:
                signal = signal * self.sent(i, self._first_delay(i) if alone is None else alone)
            y += self.ports.get(i, 1.0) * signal
        for i, leak in self.leaks.items():
            for path in self.paths:
                if path.source == i:
                    tone = turning(path.doppler, self.u) if path.doppler else 1.0
                    gain = path.gain if path.shape is None else path.gain * _turned_shape(path.shape, carrier[i]).sum()
                    turn = _behind(path, carrier[i]) * self.sent(i, path.delay)
                    y += self.ports.get(i, 1.0) * leak * gain * tone * turn
        self.y = y
        self.wanted = self.y

    def _arrived(self, place: int, i: int, paths: list[Path], carrier: float, spectra: dict[int, np.ndarray]) -> np.ndarray:
        """What comes of a source over paths of one movement, but for what changes over time at the transmitter. The last one at
        each place among them is kept: derivatives by what changes there leave the rest alone."""
        arrays = [self.waves[i], self.u, self.shift, *(one for p in paths for one in (p.track, p.shape))]
        numbers = [i, carrier, self.delay, self.clock, *(n for p in paths for n in (p.gain, p.delay, p.doppler, p.drift))]
        kept = self.scene.notes.setdefault("arrived", {})
        before = kept.get(place)
        if before is not None and before[0] == numbers and all(map(_same, before[1], arrays)):
            return before[2]
        signal = self._came(i, paths, carrier, spectra)
        if (place + 1) * self.scene.count <= KEPT:
            kept[place] = numbers, arrays, signal if signal.base is None else signal.copy()
        return signal

    def _came(self, i: int, paths: list[Path], carrier: float, spectra: dict[int, np.ndarray]) -> np.ndarray:
        source, wave, stretch, doppler = self.scene.sources[i], self.waves[i], self.clock - paths[0].drift, paths[0].doppler
        if self.slips(stretch) and len(paths) <= FEW_PATHS and all(p.shape is None for p in paths):
            signal = np.zeros(self.scene.count, complex)
            for p in paths:
                signal = signal + p.gain * _behind(p, carrier) * self.copy_of(source, wave, p.delay + self.delay, stretch)
        else:
            if i not in spectra:
                spectra[i] = self.scene.spectrum_of_source(i) if wave is source.samples else sp_fft.fft(wave)
            response = sum(self._response(p, len(wave), carrier) for p in paths)
            signal = self.sample(source, spectra[i] * response, stretch)
        if doppler:
            signal = signal * turning(doppler, self.u)
        return signal if paths[0].track is None else signal * paths[0].track

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
        held, key = self.scene.notes.get("carrier"), (*p, self.pace, id(self.u))
        if held is None or held[0] != key:
            v = (self.u - 0.5) * self.pace
            self.scene.notes["carrier"] = held = key, phasor(TAU * v * (p[0] + 0.5 * p[1] * v)), self.u
        return held[1]

    def turn_per_sample(self, source: int | None = None) -> float:
        """Radians that the receiver's oscillators turn from one sample of the recording to the next, and with them the oscillator
        of a transmitter and its strongest path: what is late in front of these is not turned back as it would be behind them."""
        cycles = self.turned
        if source is not None:
            cycles += self.carriers[source][0] if source in self.carriers else 0.0
            cycles += max((p for p in self.paths if p.source == source), key=lambda p: abs(p.gain)).doppler
        return self.facing * TAU * cycles / self.scene.span

    def _since_the_beginning(self, p: np.ndarray) -> complex:
        """The factor under which a carrier that is told amid a recording has a phase of 0 at its first sample: of several
        transmitters the twin knows what phases they have there."""
        if len(self.scene.sources) == 1:
            return 1.0
        v = -(0.5 + self.scene.begins / self.scene.span) * self.pace
        return np.exp(-1j * TAU * v * (p[0] + 0.5 * p[1] * v))

    def sent(self, source: int, delay: float = 0.0):
        """(n,) what a transmitter's oscillator and gain make of a path of this delay, but for the carrier's own phase."""
        factor = self.turn(p) * self._since_the_beginning(p) if (p := self.carriers.get(source)) is not None else 1.0
        for over_time in self.modulations.get(source, []):
            factor = factor * over_time(delay)
        return factor

    def _first_delay(self, source: int) -> float:
        return next(p.delay for p in self.paths if p.source == source)

    def _response(self, path: Path, size: int, carrier: float) -> np.ndarray:
        turn = path.gain * _behind(path, carrier) * self.scene.delayed(path.delay + self.delay, size, carrier)
        return turn if path.shape is None else turn * sp_fft.fft(_turned_shape(path.shape, carrier), size)

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


def _same(a: np.ndarray | None, b: np.ndarray | None) -> bool:
    return a is b or (a is not None and b is not None and np.array_equal(a, b))


def _behind(path: Path, carrier: float) -> complex:
    """What a path's delay makes of a transmitter's carrier of so many cycles per sample."""
    return np.exp((-1j * TAU) * carrier * path.delay) if carrier else 1.0


def _turned_shape(shape: np.ndarray, carrier: float) -> np.ndarray:
    """The taps of a path, each as late as the transmitter's carrier finds it."""
    return shape * phasor(-TAU * carrier * np.arange(len(shape))) if carrier else shape
