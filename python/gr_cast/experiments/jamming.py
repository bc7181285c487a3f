# SPDX-License-Identifier: GPL-3.0-or-later
"""Wi-Fi under a jammer: frames sampled along a scenario, each through the emulator, with its SINR and whether it arrived.

The link is saturated: frames follow each other after the standard's mean wait. Only some are computed, spread evenly, and
each stands for its neighbours. All times are radio time.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len

from ..core.errors import CastError
from ..core.units import db_from_power, power_from_db
from ..scenario import Scenario, base_loss_db, taps_at
from ..scenario.band import in_band_power

LINK_BAND_HZ = 16.6e6  # that the carriers of 20 MHz Wi-Fi fill
WAIT_S = 34e-6 + 7.5 * 9e-6  # DIFS and the mean backoff of 802.11a
MARGIN = 400  # samples computed to either side of a frame
SPECTRUM_BINS = 128
BANDWIDTH_HZ = {"narrowband": 156e3, "wideband": 10e6}


@dataclass(frozen=True, kw_only=True)
class Jammer:
    """Gaussian noise of power 1 in `bandwidth_hz` around `centre_hz` from the carrier, on from and until `on_s`.

    `harmonic` is (offset from the carrier in Hz, dB re the jammer's power): the square of the noise, twice as wide.
    """

    bandwidth_hz: float
    centre_hz: float = 0.0
    on_s: tuple[float, float] = (0.0, np.inf)
    harmonic: tuple[float, float] | None = None

    def samples(self, rng: np.random.Generator, size: int, begin_s: float, sample_rate_hz: float) -> np.ndarray:
        """(size,) complex samples from `begin_s` on; silent while the jammer is off."""
        period = next_fast_len(size)
        inside = np.abs(np.fft.fftfreq(period, 1 / sample_rate_hz)) <= self.bandwidth_hz / 2
        bins, count = np.zeros(period, complex), int(inside.sum())
        bins[inside] = rng.normal(size=count) + 1j * rng.normal(size=count)
        noise = np.fft.ifft(bins)[:size] * (period / np.sqrt(2 * count))
        time_s = begin_s + np.arange(size) / sample_rate_hz
        on_air = noise * np.exp(2j * np.pi * self.centre_hz * time_s)
        if self.harmonic:
            offset_hz, level_db = self.harmonic
            # The square of circular Gaussian noise of power 1 has power 2.
            on_air = on_air + np.sqrt(power_from_db(level_db) / 2) * noise**2 * np.exp(2j * np.pi * offset_hz * time_s)
        return on_air * ((time_s >= self.on_s[0]) & (time_s < self.on_s[1]))


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Who transmits to whom over what, and how loud: powers at the receiver, means over time and the sender's band.

    `snr_db` is without the jammer, `sinr_db` with it (None: no jammer). They hold over `levels_of` where it is given: then
    noise and jammer are as loud here as there. Raises CastError where the two contradict.
    """

    scenario: Scenario
    jammer: Jammer | None
    snr_db: float = 25.0
    sinr_db: float | None = None
    tx: str = "tx"
    rx: str = "rx"
    jammer_node: str = "jammer"
    seed: int = 0
    levels_of: Scenario | None = None

    def __post_init__(self):
        if not np.isfinite(self.snr_db):
            raise CastError(f"snr: got {self.snr_db} dB, needs a finite number")
        if self.jammer and not (self.sinr_db is not None and -60 <= self.sinr_db < self.snr_db):
            raise CastError(f"sinr: got {self.sinr_db} dB, needs -60 to below the snr of {self.snr_db} dB: a jammer adds power")

    @property
    def transmitters(self) -> list[str]:
        return [self.tx, self.jammer_node] if self.jammer else [self.tx]

    @property
    def noise_power(self) -> float:
        return self._mean_gain(self.tx, LINK_BAND_HZ) * power_from_db(-self.snr_db)

    @property
    def jammer_amplitude(self) -> float:
        """Of the transmitted noise, relative to the link's transmitted rms."""
        if self.jammer is None:
            return 0.0
        hears = self._mean_gain(self.jammer_node, self.jammer.bandwidth_hz, self.jammer.centre_hz)
        disturbance = self._mean_gain(self.tx, LINK_BAND_HZ) * power_from_db(-self.sinr_db)
        return float(np.sqrt((disturbance - self.noise_power) / hears))

    def _mean_gain(self, node: str, bandwidth_hz: float, centre_hz: float = 0.0) -> float:
        return mean_gain(self.levels_of or self.scenario, (node, self.rx), bandwidth_hz, centre_hz)


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One frame: when it began, energies of what was wanted and of all else at the receiver, and the spectrum (bins,)."""

    time_s: float
    delivered: bool
    wanted: float
    disturbance: float
    spectrum: np.ndarray

    @property
    def sinr_db(self) -> float:
        return float(db_from_power(self.wanted / self.disturbance))


def mean_gain(scenario: Scenario, key: tuple[str, str], bandwidth_hz: float, centre_hz: float = 0.0) -> float:
    """Power gain of a link for a flat spectrum around `centre_hz`, mean over the scenario's time, base loss applied."""
    if key not in scenario.links:
        raise CastError(f"{scenario.name}: no link {key[0]}>{key[1]}")
    delay_s, gain = taps_at(scenario, key, scenario.time_s)
    turned = gain * np.exp(-2j * np.pi * centre_hz * delay_s)
    power = float(np.mean(in_band_power(delay_s, turned, bandwidth_hz)) * power_from_db(-base_loss_db(scenario, key)))
    if not power > 0:
        raise CastError(f"{scenario.name}: link {key[0]}>{key[1]} hears nothing")
    return power


def frame_times_s(duration_s: float, frames_per_s: float, frame_s: float) -> np.ndarray:
    """When the computed frames begin: the middle of equal steps; CastError where they would overlap."""
    if not (0 < duration_s < np.inf and 0 < frames_per_s < np.inf):
        raise CastError(f"frames: got {frames_per_s} per s over {duration_s} s, needs finite numbers above 0")
    limit = 1 / (frame_s + WAIT_S)
    if frames_per_s > limit:
        raise CastError(f"frames: got {frames_per_s:g} per s, limit {limit:.0f}: the saturated link")
    return (np.arange(round(duration_s * frames_per_s)) + 0.5) / frames_per_s


def frames(setting: Setting, modem, emulator, times_s: np.ndarray, payload_bytes: int) -> Iterator[Frame]:
    """Send a frame at each of `times_s` through the emulator; every payload is its number and random bytes.

    `emulator` is `blocks.frames.FrameEmulator` on this setting's transmitters and noise, `modem` a `blocks.modem.Modem`.
    """
    rate, jammer_amplitude = modem.sample_rate_hz, setting.jammer_amplitude
    for number, time_s in enumerate(times_s):
        rng = np.random.default_rng([setting.seed, number])
        payload = number.to_bytes(4, "little") + rng.bytes(payload_bytes - 4)
        sent = modem.modulate(payload)
        begin = max(round(time_s * rate) - MARGIN, 0)
        inputs = np.zeros((len(setting.transmitters), emulator.past + MARGIN + len(sent) + MARGIN), complex)
        first = emulator.past + MARGIN
        inputs[0, first : first + len(sent)] = sent
        if setting.jammer:
            noise = setting.jammer.samples(rng, inputs.shape[1], (begin - emulator.past) / rate, rate)
            inputs[1] = jammer_amplitude * noise
        received, wanted = emulator.receive(begin, inputs)
        on_air = slice(MARGIN + emulator.bulk_delay, MARGIN + emulator.bulk_delay + len(sent))
        rest = received[on_air] - wanted[on_air]
        # The receiver's gain control: a modem need not know the path loss.
        scaled = received / np.sqrt(np.mean(np.abs(received[on_air]) ** 2))
        yield Frame(
            time_s=(begin + MARGIN) / rate,
            delivered=any(packet.payload == payload for packet in modem.demodulate(scaled)),
            wanted=float(np.sum(np.abs(wanted[on_air], dtype=float) ** 2)),
            disturbance=float(np.sum(np.abs(rest, dtype=float) ** 2)),
            spectrum=_spectrum(received[on_air]),
        )


def _spectrum(samples: np.ndarray) -> np.ndarray:
    """Mean power of each frequency (SPECTRUM_BINS,), lowest first, of samples (Welch, without overlap)."""
    blocks = samples[: len(samples) // SPECTRUM_BINS * SPECTRUM_BINS].reshape(-1, SPECTRUM_BINS)
    power = np.mean(np.abs(np.fft.fft(blocks * np.hanning(SPECTRUM_BINS), axis=1)) ** 2, axis=0)
    return np.fft.fftshift(power) / SPECTRUM_BINS


def frame_period_s(modem, payload_bytes: int) -> float:
    """Seconds from one frame of the saturated link to the next."""
    return len(modem.modulate(bytes(payload_bytes))) / modem.sample_rate_hz + WAIT_S


def series(found: list[Frame], step_s: float, offered_mbit_per_s: float) -> dict[str, np.ndarray]:
    """Columns over steps of `step_s`: time_s (their middle), throughput_mbit_per_s and sinr_db (mean powers); NaN: no frame."""
    place = np.floor(np.array([frame.time_s for frame in found]) / step_s).astype(int)
    steps = np.arange(place[-1] + 1)

    def total(values):
        return np.bincount(place, np.array(values, float), minlength=len(steps))

    with np.errstate(divide="ignore", invalid="ignore"):
        share = total([frame.delivered for frame in found]) / total(np.ones(len(found)))
        sinr = total([frame.wanted for frame in found]) / total([frame.disturbance for frame in found])
    return {
        "time_s": (steps + 0.5) * step_s,
        "throughput_mbit_per_s": share * offered_mbit_per_s,
        "sinr_db": db_from_power(sinr),
    }


def interval_of_harm(time_s: np.ndarray, sinr_db: np.ndarray) -> tuple[float, float] | None:
    """Where a box of lower SINR fits best (least squares of two levels), as its edges in s; None where it explains under half.

    An edge is midway between the frames on its two sides.
    """
    stride = -(-len(time_s) // 1500)  # all pairs of edges are tried
    time_s, x = time_s[::stride], sinr_db[::stride] - np.mean(sinr_db[::stride])
    n = len(x)
    sums = np.concatenate([[0.0], np.cumsum(x)])
    size = np.arange(n + 1)[None, :] - np.arange(n + 1)[:, None]
    inside = sums[None, :] - sums[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        explained = np.where((size > 0) & (size < n) & (inside < 0), inside**2 * (1 / size + 1 / (n - size)), 0)
    first, last = np.unravel_index(np.argmax(explained), explained.shape)
    if explained[first, last] < 0.5 * np.sum(x**2):
        return None
    edges = np.concatenate([time_s[:1], (time_s[1:] + time_s[:-1]) / 2, time_s[-1:]])
    return float(edges[first]), float(edges[last])
