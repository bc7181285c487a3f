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

from .diagnose.align import effect_of, plain, source_of, told_noise_db, twin_effects
from .diagnose.case import Case, Observation
from .diagnose.model import Model, predict
from .effects import FAMILIES
from .effects.chain import Path, Scene, Source
from .emulate import receiver_noise
from .errors import CastError
from .units import amplitude_from_db

BLOCK = 1 << 16  # samples that are computed at once, ends included
END = 4096  # of them at either end, thrown away: a filter's memory, a narrow band's length
MARGIN = 2048  # samples of a waveform beyond what is reached, faded out
LONGEST_PERIOD = BLOCK  # up to here a repeated waveform is taken as a circle, exactly
STREAMS = 16  # noise streams of one effect
FAR = 1 << 40  # first number of the noise, so that ends before the first sample have some


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What is other than the twin says. Amplitudes by transmitter; None leaves the twin's own."""

    amplitude: dict[str, float] = field(default_factory=dict)
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

    def __init__(self, case: Case, observation: Observation, count: int, conditions: Conditions | None = None):
        conditions = conditions or Conditions()
        if count < 1:
            raise CastError(f"duration: got {count} samples, needs 1 or more")
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
        out = []
        for effect in self.model.effects:
            if effect.family == "pa_nonlinearity":
                sent, measured = self.scene.sources[effect.aux["source"]].peak, effect.aux["peak"]
                if sent > 1.01 * measured:
                    name = self.scene.transmitters[effect.aux["source"]]
                    out.append(f"{name}: amplifier driven to {sent:.3g}, measured up to {measured:.3g}: extrapolated")
        return out

    def chunks(self, size: int = 1 << 20) -> Iterator[np.ndarray]:
        """All samples in order, `size` at a time."""
        return (self.samples(first, size) for first in range(0, self.count, size))

    def samples(self, first: int = 0, count: int | None = None) -> np.ndarray:
        """(count,) complex64 samples from number `first` on, up to the end."""
        last = self.count if count is None else min(first + count, self.count)
        out = np.zeros(max(last - first, 0), np.complex64)
        step = BLOCK - 2 * END
        for k in range(first // step, -(-last // step)):
            begin, end = max(first, k * step), min(last, (k + 1) * step)
            out[begin - first : end - first] = self._block(k)[begin - k * step : end - k * step]
        return out

    def _block(self, k: int) -> np.ndarray:
        if self._held[0] != k:
            scene = self._at(k * (BLOCK - 2 * END) - END)
            chain = predict(scene, self.model, self._noise)
            self._held = (k, chain.y[END : BLOCK - END].astype(np.complex64))
        return self._held[1]

    def _scene(self) -> Scene:
        case, observation, conditions = self.case, self.observation, self.conditions
        names, rate = list(observation.on_air), case.sample_rate_hz
        links = [case.links[(tx, observation.receiver)] for tx in names]
        sources = []
        for tx, (waveform, amplitude) in observation.on_air.items():
            w = case.waveforms[waveform]
            if not np.isfinite(w.samples).all():
                raise CastError(f"waveform {w.name}: holds unknown samples (NaN), what is not known cannot be played")
            sources.append(source_of(w.name, w.samples, conditions.amplitude.get(tx, amplitude), w.repeat))
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
        noise_db = told_noise_db(case, observation) if conditions.noise_power_db is None else conditions.noise_power_db
        on_air = {w for w, _ in observation.on_air.values()}
        return Scene(
            name=observation.name,
            sample_rate_hz=rate,
            count=1,
            span=self.count,
            sources=sources,
            taps=taps,
            transmitters=names,
            receiver=observation.receiver,
            anchor=0,
            carrier_hz=carrier,
            floor=1e-12 if noise_db is None else max(10 ** (noise_db / 10), 1e-30),
            extra={
                w.name: source_of(w.name, w.samples, 1.0, w.repeat) for w in case.waveforms.values() if w.name not in on_air
            },
        )

    def _wanted_rms(self) -> float:
        plain_model = Model(base=self._base())
        wanted = predict(self._at(0, plain_model), plain_model).wanted[: self.count]
        return float(np.sqrt(np.mean(np.abs(wanted) ** 2))) or 1.0

    def _base(self) -> np.ndarray:
        gain = amplitude_from_db(self.gain_db)
        return np.array([0.0, gain, 0.0])

    @property
    def gain_db(self) -> float:
        """Asked for, or measured in this recording, or in others with the same effects; else 0 dB."""
        if self.conditions.gain_db is not None:
            return self.conditions.gain_db
        measured = [(entry.get("model") or {}).get("gain_db", {}) for _, entry in self.entries]
        here = [m[self.observation.name] for m in measured if self.observation.name in m]
        every = here or [v for m in measured for v in m.values()]
        return float(np.mean(every)) if every else 0.0

    def _model(self) -> Model:
        model = Model(base=self._base())
        for k, entry in self.entries:
            family = FAMILIES[entry["family"]]
            entry = self._retuned(family, entry)
            effect = effect_of(self.scene, entry)
            drawn = family.played(self.scene, effect, np.random.default_rng([self.conditions.seed, k]))
            model = model.adding(replace(drawn, aux={**drawn.aux, "entry": k}))
        if self.conditions.carrier_offset_hz:
            family = FAMILIES["carrier_frequency_offset"]
            model = model.adding(family.parse(self.scene, {"offset_hz": self.conditions.carrier_offset_hz}, {}))
        return model

    def _retuned(self, family, entry: dict) -> dict:
        """An entry on another carrier: an oscillator's errors and Dopplers grow with it, paths turn by their delay."""
        parameters = {k: plain(v, self.observation.name) for k, v in entry["parameters"].items()}
        model = dict(entry.get("model") or {})
        for numbers in (parameters, model):
            for name, power in family.follows_carrier.items():
                if numbers.get(name) is not None:
                    numbers[name] *= self.ratio**power
        if entry["family"] == "extra_path":
            parameters["phase_rad"] = (parameters.get("phase_rad") or 0.0) - 2 * np.pi * self.moved_hz * parameters["delay_s"]
        return {**entry, "parameters": parameters, "model": model}

    def _at(self, first: int, model: Model | None = None) -> Scene:
        """The scene of BLOCK samples from `first` on."""
        reach = self._reach(first, model or self.model)
        sources = [_around(s, *reach) for s in self.scene.sources]
        return self.scene.stretch(first, BLOCK, sources, {name: _around(s, *reach) for name, s in self.scene.extra.items()})

    def _reach(self, first: int, model: Model) -> tuple[int, int]:
        """First and last sample of what was sent that a block can hold: clock and joints move it, paths delay it."""
        last = first + BLOCK
        clock = sum(e.p[0] for e in model.effects if e.family == "sample_clock_offset") / self.count
        joints = [e.p for e in model.effects if e.family == "sample_loss"]
        edges = [first, last, *(at for at, _ in joints if first <= at < last)]
        shifts = [sum(lost for at, lost in joints if edge >= at) for edge in edges]
        delays = [p.delay for p in self.scene.taps]
        delays += [e.p[2] for e in model.effects if e.family in ("extra_path", "second_transmitter")]
        delays += [e.aux["first"] + len(e.p) / 2 for e in model.effects if e.family == "diffuse_tail"]
        delays += [max(delays) + e.p[0] for e in model.effects if e.family == "tap_delay_error"]
        early = min(clock * first, clock * last) + min(shifts) - max(delays)
        late = max(clock * first, clock * last) + max(shifts) - min(delays)
        return first + int(np.floor(early)), last + int(np.ceil(late))

    def _noise(self, chain) -> np.ndarray:
        """(n,) floor and interference in front of the receiver."""
        scene, conditions = chain.scene, self.conditions
        if conditions.noise_power_db == -np.inf:
            return np.zeros(scene.count)
        receivers = sorted({o.receiver for o in self.case.observations})
        floor = scene.floor if self._floor_is_told else 0.0
        noise = np.sqrt(floor) * self._white(receivers.index(scene.receiver), scene)
        for effect in self.model.effects:
            if FAMILIES[effect.family].noise_like:
                streams = iter(range(len(receivers) + STREAMS * effect.aux["entry"], 1 << 31))
                draw = lambda streams=streams: self._white(next(streams), scene)  # noqa: E731
                noise = noise + FAMILIES[effect.family].added(scene, effect, chain.wanted, draw)
        return noise

    @property
    def _floor_is_told(self) -> bool:
        return self.conditions.noise_power_db is not None or self.observation.receiver in self.case.noise_db

    def _white(self, stream: int, scene: Scene) -> np.ndarray:
        return receiver_noise(self.conditions.seed, stream, scene.count, FAR + scene.first)


def _around(source: Source, first: int, last: int) -> Source:
    """A waveform around its samples first … last: a short period stays a circle, anything else is cut out and faded."""
    size = len(source.samples)
    if source.repeat and size <= LONGEST_PERIOD:
        return source
    index = first - MARGIN + np.arange(sp_fft.next_fast_len(last - first + 2 * MARGIN))
    if source.repeat:
        samples = source.samples[index % size]
    else:
        samples = np.where((index >= 0) & (index < size), source.samples[np.clip(index, 0, size - 1)], 0)
    fade = np.sin(np.pi / 2 * np.arange(MARGIN // 2) / (MARGIN // 2)) ** 2
    samples[: MARGIN // 2] *= fade
    samples[-(MARGIN // 2) :] *= fade[::-1]
    return replace(source, samples=samples, repeat=False, known=np.ones(len(samples), bool), origin=first - MARGIN)

