# SPDX-License-Identifier: GPL-3.0-or-later
"""SINR of a downlink, measured: every base station's channel is played by the emulator, sounded, and set against the others.

At each instant the stations send in turns, one period of a Zadoff-Chu code as long as an LTE symbol after the other, so that
the sounder's bins are the subcarriers. With H_k(f) of every station k and the noise N(f) of the terminal,
SINR_i(f) = |H_i|²·P/B / (Σ_k≠i |H_k|²·P/B + N). `superposition` lets all send at once, to see that the sum is what arrives.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...core.errors import CastError
from ...emulation.reference import emulate, scenario_updates
from ...scenario import LinkTaps, Scenario, base_loss_db, taps_at
from ...signals.codes import zadoff_chu
from ...signals.recording import Recording
from ...signals.waveform import Waveform
from ...sounding.receive import whole_periods
from ...sounding.sound import Sounding, SoundingOptions, sound

SUBCARRIER_HZ = 15e3
FFT_OF_BLOCKS = {6: 128, 15: 256, 25: 512, 50: 1024, 100: 2048}  # 3GPP TS 36.104, table 5.6-1, and the usual transforms
THERMAL_DBM_PER_HZ = -174.0
PERIODS = 20
_ROOT = 7
_STEP_S = 1e-3  # of the emulator's taps
# (scenario, inputs (nodes, n), sample_rate_hz, noise_power, seed) -> outputs (nodes, n)
Play = Callable[[Scenario, np.ndarray, float, float, int], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A base station and the terminals that it serves, all nodes of the scenario."""

    station: str
    terminals: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Radio:
    """What all radios share: resource blocks, transmit power over them all, and the terminals' noise figure."""

    blocks: int = 50
    tx_power_dbm: float = 20.0
    noise_figure_db: float = 5.0

    def __post_init__(self):
        if self.blocks not in FFT_OF_BLOCKS:
            raise CastError(f"resource blocks: got {self.blocks}, needs one of {', '.join(map(str, FFT_OF_BLOCKS))}")
        if not (abs(self.tx_power_dbm) <= 100 and 0 <= self.noise_figure_db <= 50):
            raise CastError(
                f"radio: got {self.tx_power_dbm} dBm and a noise figure of {self.noise_figure_db} dB, "
                "limits ±100 dBm and 0 to 50 dB"
            )

    @property
    def sample_rate_hz(self) -> float:
        return FFT_OF_BLOCKS[self.blocks] * SUBCARRIER_HZ

    @property
    def occupied_hz(self) -> float:
        return self.blocks * 12 * SUBCARRIER_HZ

    @property
    def noise_power(self) -> float:
        """Per complex sample, over that of a station's samples."""
        level_dbm = THERMAL_DBM_PER_HZ + 10 * np.log10(self.sample_rate_hz) + self.noise_figure_db
        return float(10 ** ((level_dbm - self.tx_power_dbm) / 10))

    @property
    def subcarriers(self) -> np.ndarray:
        """Bins of the transform that carry data: all round the carrier, which is left out."""
        half = self.blocks * 6
        return np.concatenate([np.arange(-half, 0), np.arange(1, half + 1)])


def play_reference(scenario: Scenario, inputs, sample_rate_hz: float, noise_power: float, seed: int) -> np.ndarray:
    """By the NumPy emulator."""
    nodes = len(scenario.nodes)
    updates = scenario_updates(scenario, sample_rate_hz)
    return emulate(inputs, updates, nodes, noise_power=[noise_power] * nodes, seed=seed)


def excerpt(scenario: Scenario, keys, begin_s: float, duration_s: float) -> Scenario:
    """The links `keys` from `begin_s` on, in steps of 1 ms, as a scenario of its own."""
    clock_s = np.arange(int(np.ceil(duration_s / _STEP_S)) + 1) * _STEP_S
    links, losses_db = {}, {}
    for key in keys:
        moving = not scenario.links[key].is_static
        delay_s, gain = taps_at(scenario, key, begin_s + (clock_s if moving else np.zeros(1)) + 1e-9)
        links[key], losses_db[key] = LinkTaps(delay_s=delay_s, gain=gain), base_loss_db(scenario, key)
    return Scenario(
        name=scenario.name, nodes=tuple(dict.fromkeys(node for key in keys for node in key)), links=links, time_s=clock_s,
        link_base_loss_db=losses_db, interpolation=scenario.interpolation,
    )  # fmt: skip


class Downlink:
    """Sounds all links from stations to terminals of a scenario at any instant. Raises CastError where there is no link."""

    def __init__(self, scenario: Scenario, cells: list[Cell], radio: Radio, play: Play = play_reference, seed: int = 1):
        self.scenario, self.cells, self.radio, self._play = scenario, cells, radio, play
        self.stations = [cell.station for cell in cells]
        self.serving = {terminal: cell.station for cell in cells for terminal in cell.terminals}
        self._keys = [(station, terminal) for station in self.stations for terminal in self.serving]
        missing = [f"{tx}>{rx}" for tx, rx in self._keys if (tx, rx) not in scenario.links]
        if missing:
            raise CastError(f"{scenario.name}: no link {', '.join(missing)}; nodes are {', '.join(scenario.nodes)}")
        self._code = Waveform(samples=zadoff_chu(FFT_OF_BLOCKS[radio.blocks], _ROOT), name="reference symbols")
        self._seed = seed

    def _burst(self, at_s: float, sent: dict[str, np.ndarray], seed: int) -> dict[str, Recording]:
        """What every terminal hears of `sent`, a period or samples per station; the first period of it is left out."""
        length = len(self._code.samples)
        total = (PERIODS + 1) * length
        rate_hz = self.radio.sample_rate_hz
        played = excerpt(self.scenario, self._keys, at_s, total / rate_hz)
        inputs = np.zeros((len(played.nodes), total), np.complex64)
        for station, samples in sent.items():
            inputs[played.nodes.index(station)] = np.resize(samples, total)
        outputs = self._play(played, inputs, rate_hz, self.radio.noise_power, seed)
        heard = {terminal: outputs[played.nodes.index(terminal), length:] for terminal in self.serving}
        return {
            terminal: Recording(samples=np.asarray(samples, np.complex64), sample_rate_hz=rate_hz)
            for terminal, samples in heard.items()
        }

    def _sound(self, recording: Recording) -> Sounding:
        return sound(recording, self._code, SoundingOptions(correct_offset=False, max_taps=1))

    def _gain(self, recording: Recording, sounding: Sounding) -> np.ndarray:
        """|H(f)|² at all bins, (fft,), without the noise that is in it; 0 where the sounder sees no signal.

        By the mean of all periods, in which no channel moves, and not by the sounding's response, which has no phase where the
        sounder took it for one that does.
        """
        code = self._code.samples
        if not len(sounding.taps.delay_samples):
            return np.zeros(len(code))
        heard = whole_periods(recording, len(code)).samples
        sent = np.abs(np.fft.fft(code)) ** 2
        power = np.abs(np.fft.fft(heard.mean(axis=0, dtype=complex))) ** 2
        return np.maximum(power - len(code) * sounding.noise_power / len(heard), 0.0) / sent

    def _seeds(self, at_s: float, count: int) -> list[int]:
        # An instant's noise depends on nothing but the seed and the instant.
        entropy = [self._seed, round(at_s * 1e6)]
        return [int(word) >> 1 for word in np.random.SeedSequence(entropy).generate_state(count)]

    def sound(self, at_s: float) -> tuple[dict, dict]:
        """|H(f)|² of every link at all bins, (fft,), and the noise of every terminal per sample, of a burst per station."""
        gain, noise = {}, {terminal: [] for terminal in self.serving}
        for station, seed in zip(self.stations, self._seeds(at_s, len(self.stations)), strict=True):
            for terminal, recording in self._burst(at_s, {station: self._code.samples}, seed).items():
                sounding = self._sound(recording)
                gain[station, terminal] = self._gain(recording, sounding)
                noise[terminal].append(sounding.noise_power)
        return gain, {terminal: float(np.mean(values)) for terminal, values in noise.items()}

    def sinr(self, at_s: float) -> dict[str, np.ndarray]:
        """Linear SINR of every terminal's subcarriers, (12·blocks,), all stations sending at full load."""
        gain, noise = self.sound(at_s)
        # A station's power is in the occupied band alone, that of the code in all of the sampled one.
        denser = self.radio.sample_rate_hz / self.radio.occupied_hz
        out = {}
        for terminal, serving in self.serving.items():
            power = {station: denser * gain[station, terminal][self.radio.subcarriers] for station in self.stations}
            rest = sum((power[station] for station in self.stations if station != serving), 0.0)
            out[terminal] = power[serving] / (rest + noise[terminal])
        return out

    def superposition(self, at_s: float) -> dict[str, tuple[float, float]]:
        """Interference and noise, dB re a station's power: (measured with all stations on, summed from `sound`).

        A terminal's station sends the code while the others send noise-like data; the sounder takes what does not repeat
        for noise.
        """
        gain, noise = self.sound(at_s)
        out = {}
        rng = np.random.default_rng([self._seed, round(at_s * 1e6)])
        total = (PERIODS + 1) * len(self._code.samples)
        for cell in self.cells:
            data = rng.normal(size=(len(self.stations), 2, total)) / np.sqrt(2)
            sent = {station: values[0] + 1j * values[1] for station, values in zip(self.stations, data, strict=True)}
            sent[cell.station] = self._code.samples
            recordings = self._burst(at_s, sent, self._seeds(at_s, len(self.stations) + 1)[-1])
            for terminal in cell.terminals:
                others = sum(gain[station, terminal].mean() for station in self.stations if station != cell.station)
                measured = self._sound(recordings[terminal]).noise_power
                out[terminal] = (float(10 * np.log10(measured)), float(10 * np.log10(others + noise[terminal])))
        return out
