# SPDX-License-Identifier: GPL-3.0-or-later
"""Play a twin with its effects: what its receivers would record, under its own or other conditions.

The signal runs through the same forward models as in a diagnosis, in the same order, block by block on a fixed grid:
what a sample is depends on its number alone, whoever asks for how many at a time. Random effects (phase noise, fading)
are drawn from their law, noise is counted by sample (`emulate.receiver_noise`), all from one seed.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import fft as sp_fft

from ..core.errors import CastError
from ..core.units import amplitude_from_db
from ..emulation.reference import receiver_noise
from ..signals import recording
from .document import Case, Observation, Waveform
from .effects import FAMILIES, Role, plays, with_role
from .entries import effect_of, plain, source_of, told_noise_db, twin_effects
from .model import Model, predict
from .scene import Path, Scene, Source

LONGEST_PERIOD = 1 << 16  # up to here a repeated waveform is taken as a circle, exactly
STREAMS = 16  # noise streams of one effect
MOST_SAMPLES = 1 << 53  # so far a double counts them
FAR = 1 << 40  # first number of the noise, so that ends before the first sample have some


@dataclass(frozen=True, kw_only=True)
class Grid:
    """How a stream is cut: `block` samples at once, of which `end` on either side are thrown away (a filter's memory, a
    narrow band's length), and `margin` samples of a waveform beyond what is reached, half of them faded out."""

    block: int = 1 << 16
    end: int = 4096
    margin: int = 2048

    @property
    def step(self) -> int:
        return self.block - 2 * self.end


class Tape:
    """What a transmitter sends while the twin plays: samples come in at one end, windows are cut out of what is held."""

    def __init__(self):
        self.first, self.held = 0, np.zeros(0, np.complex64)

    @property
    def last(self) -> int:
        return self.first + len(self.held)

    def push(self, samples: np.ndarray) -> None:
        self.held = np.concatenate([self.held, samples])

    def drop(self, before: int) -> None:
        """Forget what came before a sample's number."""
        count = min(max(before - self.first, 0), len(self.held))
        self.first, self.held = self.first + count, self.held[count:]

    def __getitem__(self, span: slice) -> np.ndarray:
        """The samples from number `span.start` to `span.stop`, both of them held."""
        return self.held[span.start - self.first : span.stop - self.first]


@dataclass(frozen=True, kw_only=True)
class Sent:
    """What a transmitter sends: samples in memory, on disk or on a tape, to be scaled; `source` has its power and peak, and
    of a short period all of it."""

    source: Source
    samples: np.ndarray | recording.Stored | Tape
    amplitude: float

    @classmethod
    def of(cls, waveform: Waveform | Tape, amplitude: float) -> "Sent":
        if isinstance(waveform, Tape):  # of power 1 as far as anybody knows
            return cls(source=source_of("live", np.ones(1), amplitude, False), samples=waveform, amplitude=amplitude)
        energy, peak = 0.0, 0.0
        for piece in recording.pieces(waveform.samples):
            power = np.abs(piece) ** 2
            if not np.isfinite(power).all():
                raise CastError(f"waveform {waveform.name}: holds unknown samples (NaN), what is not known cannot be played")
            energy, peak = energy + float(power.sum(dtype=float)), max(peak, float(power.max()))
        head = source_of(waveform.name, waveform.samples[:LONGEST_PERIOD], amplitude, waveform.repeat)
        level = energy / len(waveform.samples) * amplitude**2
        source = replace(head, power=level, peak=float(np.sqrt(peak)) * amplitude)
        return cls(source=source, samples=waveform.samples, amplitude=amplitude)

    def around(self, first: int, last: int, margin: int) -> Source:
        """The waveform around its samples first … last: a short period stays a circle, anything else is cut out and faded."""
        if self.source.repeat and len(self.samples) <= LONGEST_PERIOD:
            return self.source
        cut = self.amplitude * self._cut(first - margin, last + margin)
        fade = np.sin(np.pi / 2 * np.arange(margin // 2) / (margin // 2)) ** 2
        cut[: margin // 2] *= fade
        cut[-(margin // 2) :] *= fade[::-1]
        samples = np.zeros(sp_fft.next_fast_len(len(cut)), complex)
        samples[: len(cut)] = cut
        known = np.ones(len(samples), bool)
        return replace(self.source, samples=samples, repeat=False, known=known, origin=first - margin)

    def _cut(self, first: int, last: int) -> np.ndarray:
        """(last − first,) complex128 samples, zeros where nothing is sent."""
        out, at = np.zeros(last - first, complex), first
        if isinstance(self.samples, Tape):
            begin, end = max(first, self.samples.first), min(last, self.samples.last)
        elif not self.source.repeat:
            begin, end = max(first, 0), min(last, len(self.samples))
        else:
            while at < last:
                place = at % len(self.samples)
                piece = self.samples[place : place + last - at]
                out[at - first : at - first + len(piece)] = piece
                at += len(piece)
            return out
        if end > begin:
            out[begin - first : end - first] = self.samples[begin:end]
        return out


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What is other than the twin says. Amplitudes and waveforms by transmitter; None leaves the twin's own.

    A `Tape` for a waveform is filled while the twin plays.
    """

    amplitude: dict[str, float] = field(default_factory=dict)
    transmit: dict[str, Waveform | Tape] = field(default_factory=dict)
    center_frequency_hz: float | None = None
    carrier_offset_hz: float = 0.0
    gain_db: float | None = None
    noise_power_db: float | None = None  # −inf: none at all, not even interference
    seed: int = 0

    def __post_init__(self):
        for name, value in self.amplitude.items():
            if not 0 <= value < np.inf:
                raise CastError(f"amplitude of {name}: got {value}, needs a finite number of 0 or more")
        if self.center_frequency_hz is not None and not 0 < self.center_frequency_hz < np.inf:
            raise CastError(f"carrier: got {self.center_frequency_hz} Hz, needs a finite number above 0 Hz")
        if not 0 <= self.seed < 1 << 64:
            raise CastError(f"seed: got {self.seed}, needs a whole number from 0 to 2^64 − 1")


class Playback:
    """One recording of a twin, `count` samples long, as it would be taken under some conditions.

    `case` is a twin (`read_twin`), `observation` one of its recordings. What the twin does not know of (a recording's
    delay and phase) is 0; the gain is the one that a diagnosis measured, where it says so, else 0 dB.
    """

    def __init__(
        self, case: Case, observation: Observation, count: int, conditions: Conditions | None = None, grid: Grid | None = None
    ):
        conditions, self.grid = conditions or Conditions(), grid or Grid()
        if not 1 <= count <= MOST_SAMPLES:
            raise CastError(f"duration: got {count:g} samples, needs 1 to {MOST_SAMPLES:g}")
        self.case, self.observation, self.count, self.conditions = case, observation, count, conditions
        here = {id(e) for e in twin_effects(case, observation)}
        self.entries = [(k, e) for k, e in enumerate(case.effects) if id(e) in here]
        self.scene = self._scene()
        self.scene.rms = self._wanted_rms()
        self.model = self._model()
        self._held: tuple[int, np.ndarray] = (-1, np.zeros(0))

    @property
    def sample_rate_hz(self) -> float:
        return self.case.sample_rate_hz

    @property
    def warnings(self) -> list[str]:
        """Where the twin is asked for more than was measured."""
        told = (FAMILIES[effect.family].extrapolated(self.scene, effect) for effect in self.model.effects)
        return [warning for warning in told if warning]

    def chunks(self, size: int = 1 << 20) -> Iterator[np.ndarray]:
        """All samples in order, `size` at a time."""
        return (self.samples(first, size) for first in range(0, self.count, size))

    def samples(self, first: int = 0, count: int | None = None) -> np.ndarray:
        """(count,) complex64 samples from number `first` on, up to the end."""
        last = self.count if count is None else min(first + count, self.count)
        out = np.zeros(max(last - first, 0), np.complex64)
        step = self.grid.step
        for k in range(first // step, -(-last // step)):
            begin, end = max(first, k * step), min(last, (k + 1) * step)
            out[begin - first : end - first] = self.block(k)[begin - k * step : end - k * step]
        return out

    def block(self, k: int) -> np.ndarray:
        """(grid.step,) complex64, the samples from number k·grid.step on."""
        if self._held[0] != k:
            end = self.grid.end
            chain = predict(self._at(k * self.grid.step - end), self.model, self._noise)
            with np.errstate(over="ignore"):
                self._held = (k, chain.y[end:-end].astype(np.complex64))
            if not np.isfinite(self._held[1]).all():
                families = ", ".join(dict.fromkeys(entry["family"] for _, entry in self.entries))
                raise CastError(
                    f"{self.observation.name}: samples beyond any number: levels of {families or 'the taps'} are too large"
                )
        return self._held[1]

    def needs(self, k: int) -> tuple[int, int]:
        """First and last sample of what is sent that block `k` depends on."""
        first, last = self._reach(k * self.grid.step - self.grid.end, self.model)
        return first - self.grid.margin, last + self.grid.margin

    def _scene(self) -> Scene:
        case, observation, conditions = self.case, self.observation, self.conditions
        names, rate = list(observation.on_air), case.sample_rate_hz
        links = [case.links[(tx, observation.receiver)] for tx in names]
        self.sent = [
            Sent.of(conditions.transmit.get(tx, case.waveforms[name]), conditions.amplitude.get(tx, amplitude))
            for tx, (name, amplitude) in observation.on_air.items()
        ]
        on_air = {w for w, _ in observation.on_air.values()}
        self.unsent = {w.name: Sent.of(w, 1.0) for w in case.waveforms.values() if w.name not in on_air}
        carrier = conditions.center_frequency_hz or observation.center_frequency_hz
        ratio, moved_hz = 1.0, 0.0
        if conditions.center_frequency_hz is not None:
            if not observation.center_frequency_hz:
                raise CastError(f"{observation.name}: carrier: the twin does not say its own, so no other can be played")
            ratio, moved_hz = carrier / observation.center_frequency_hz, carrier - observation.center_frequency_hz
        self.ratio, self.moved_hz = ratio, moved_hz
        taps = [
            Path(
                source=i,
                delay=t.delay_s * rate,
                gain=complex(t.amplitude) * np.exp(-2j * np.pi * moved_hz * t.delay_s),
                doppler=t.doppler_hz * ratio * self.count / rate,
            )
            for i, link in enumerate(links)
            for t in link.taps
        ]
        noise_db = self.noise_power_db
        return Scene(
            name=observation.name,
            sample_rate_hz=rate,
            count=1,
            span=self.count,
            sources=[s.source for s in self.sent],
            taps=taps,
            transmitters=names,
            receiver=observation.receiver,
            anchor=0,
            carrier_hz=carrier,
            floor=1e-12 if noise_db is None else max(10 ** (noise_db / 10), 1e-30),
            extra={name: s.source for name, s in self.unsent.items()},
        )

    def _wanted_rms(self) -> float:
        if any(isinstance(s.samples, Tape) for s in self.sent):
            power = sum(abs(p.gain) ** 2 * self.scene.sources[p.source].power for p in self.scene.taps)
            return float(amplitude_from_db(self.gain_db) * np.sqrt(power))
        plain_model = Model(base=self._base())
        wanted = predict(self._at(0, plain_model), plain_model).wanted[: self.count]
        return float(np.sqrt(np.mean(np.abs(wanted) ** 2))) or 1.0

    def _base(self) -> np.ndarray:
        gain = amplitude_from_db(self.gain_db)
        return np.array([0.0, gain, 0.0])

    @property
    def gain_db(self) -> float:
        """Asked for, or measured, else 0 dB."""
        asked = self.conditions.gain_db
        return asked if asked is not None else self._measured("gain_db") or 0.0

    @property
    def noise_power_db(self) -> float | None:
        """Asked for, or told by the twin, or measured; else None."""
        asked, told = self.conditions.noise_power_db, told_noise_db(self.case, self.observation)
        return asked if asked is not None else told if told is not None else self._measured("noise_power_db")

    def _measured(self, name: str) -> float | None:
        """What a diagnosis measured in this recording, or else in others with the same effects."""
        measured = [(entry.get("model") or {}).get(name, {}) for _, entry in self.entries]
        here = [m[self.observation.name] for m in measured if self.observation.name in m]
        every = here or [v for m in measured for v in m.values()]
        return float(np.mean(every)) if every else None

    def _model(self) -> Model:
        model = Model(base=self._base())
        for k, entry in self.entries:
            family = FAMILIES[entry["family"]]
            entry = self._retuned(family, entry)
            effect = effect_of(self.scene, entry)
            drawn = family.played(self.scene, effect, np.random.default_rng([self.conditions.seed, k]))
            model = model.adding(replace(drawn, aux={**drawn.aux, "entry": k}))
        if self.conditions.carrier_offset_hz:
            family = with_role(Role.CARRIER)
            model = model.adding(family.parse(self.scene, {"offset_hz": self.conditions.carrier_offset_hz}, {}))
        return model

    def _retuned(self, family, entry: dict) -> dict:
        """An entry on another carrier: an oscillator's errors and Dopplers grow with it, paths turn by their delay."""
        parameters = {k: plain(v, self.observation.name) for k, v in entry["parameters"].items()}
        parameters, model = family.retuned(parameters, dict(entry.get("model") or {}), self.ratio, self.moved_hz)
        return {**entry, "parameters": parameters, "model": model}

    def _at(self, first: int, model: Model | None = None) -> Scene:
        """The scene of a block of samples from `first` on."""
        reach, margin = self._reach(first, model or self.model), self.grid.margin
        sources = [s.around(*reach, margin) for s in self.sent]
        extra = {name: s.around(*reach, margin) for name, s in self.unsent.items()}
        return self.scene.stretch(first, self.grid.block, sources, extra)

    def _reach(self, first: int, model: Model) -> tuple[int, int]:
        """First and last sample of what was sent that a block can hold: clock and joints move it, paths delay it."""
        last = first + self.grid.block
        clock = sum(e.p[0] for e in model.effects if plays(e, Role.CLOCK)) / self.count
        joints = [e.p for e in model.effects if plays(e, Role.SLIP)]
        edges = [first, last, *(at for at, _ in joints if first <= at < last)]
        shifts = [sum(lost for at, lost in joints if edge >= at) for edge in edges]
        delays = [p.delay for p in self.scene.taps]
        delays += [delay for e in model.effects for delay in FAMILIES[e.family].delays(self.scene, e)]
        early = min(clock * first, clock * last) + min(shifts) - max(delays)
        late = max(clock * first, clock * last) + max(shifts) - min(delays)
        return first + int(np.floor(early)), last + int(np.ceil(late))

    def _noise(self, chain) -> np.ndarray:
        """(n,) floor and interference in front of the receiver."""
        scene, conditions = chain.scene, self.conditions
        if conditions.noise_power_db == -np.inf:
            return np.zeros(scene.count)
        receivers = sorted({o.receiver for o in self.case.observations})
        floor = 0.0 if self.noise_power_db is None else scene.floor
        noise = np.sqrt(floor) * self._white(receivers.index(scene.receiver), scene)
        for effect in self.model.effects:
            if FAMILIES[effect.family].noise_like:
                streams = iter(range(len(receivers) + STREAMS * effect.aux["entry"], 1 << 31))
                draw = lambda streams=streams: self._white(next(streams), scene)  # noqa: E731
                noise = noise + FAMILIES[effect.family].added(scene, effect, chain.wanted, draw)
        return noise

    def _white(self, stream: int, scene: Scene) -> np.ndarray:
        return receiver_noise(self.conditions.seed, stream, scene.count, FAR + scene.first)
