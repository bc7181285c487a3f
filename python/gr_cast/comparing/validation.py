# SPDX-License-Identifier: GPL-3.0-or-later
"""Does a scenario play as it should? Sounded through the emulator, beside its taps and beside the paths it came from.

Three channels per link and instant: the ray-traced one, its four taps, and what the sounder hears. The distance of the
first two is what the approximation lost, that of the last two what emulation and sounding lost.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.documents import Reader
from ..core.errors import CastError
from ..core.units import amplitude_from_db, db_from_amplitude, db_from_power
from ..emulation.reference import emulate, scenario_updates
from ..scenario import LinkTaps, Scenario, band_hz, base_loss_db, link_name, taps_at, zarr_file
from ..scenario.band import in_band_power
from ..scenario.create import paths
from ..scenario.model import GRID_STEP_S
from ..signals.recording import Recording
from ..signals.waveform import waveform_from_text
from ..sounding.sound import Sounding, SoundingOptions, sound

CODE = "glfsr:11"  # 10.2 us: longer than any delay, so that nothing aliases
PERIODS = 40
SNR_DB = 30.0
MAX_SIGMA = 5.0  # of a few hundred taps by chance one passes 4
SAMPLE_RATE_HZ = 2 / GRID_STEP_S  # chips of half a grid step tell neighbouring taps apart
Play = Callable[[Scenario, np.ndarray, float], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class LinkCheck:
    """One link at one instant. Errors in dB are energy over the band, relative to the reference's; path losses are those of
    the power in the band, but for `tap_sum_loss_db`, the sum of |tap|^2. None: not known."""

    link: str
    time_s: float
    taps: int
    found: int
    missed: int  # taps above the detection threshold that were not found
    extra: int  # taps found where there is none
    worst_sigma: float  # largest deviation of a tap's gain or delay, in its own standard deviations
    path_loss_db: float
    tap_sum_loss_db: float
    sounded_path_loss_db: float
    ray_path_loss_db: float | None
    sounded_from_taps_db: float
    taps_from_rays_db: float | None
    sounded_from_rays_db: float | None

    @property
    def holds(self) -> bool:
        return self.missed == 0 and self.extra == 0 and self.worst_sigma <= MAX_SIGMA


def play_reference(scenario: Scenario, samples: np.ndarray, sample_rate_hz: float) -> np.ndarray:
    """What the second of two nodes hears of the first, by the NumPy emulator."""
    return emulate(np.stack([samples, np.zeros_like(samples)]), scenario_updates(scenario, sample_rate_hz), 2)[1]


def chosen_links(scenario: Scenario, count: int) -> list[tuple[str, str]]:
    """Up to `count` links, spread over all, moving ones first in half of them."""
    moving = [key for key, taps in scenario.links.items() if not taps.is_static]
    static = [key for key, taps in scenario.links.items() if taps.is_static]
    first = min(len(moving), max(count // 2, count - len(static)))
    spread = []
    for links, wanted in ((moving, first), (static, min(len(static), count - first))):
        spread += (
            [links[index] for index in np.unique(np.linspace(0, len(links) - 1, wanted).round().astype(int))] if wanted else []
        )
    return spread


def check_link(
    scenario: Scenario,
    key: tuple[str, str],
    time_s: float,
    *,
    rays: tuple[np.ndarray, np.ndarray] | None = None,
    bandwidth_hz: float | None = None,
    play: Play = play_reference,
    seed: int = 0,
) -> LinkCheck:
    """Freeze a link at an instant on the 10 ns grid, play a code over it with noise at 30 dB, sound it, and compare over the
    scenario's band, or `bandwidth_hz`."""
    if key not in scenario.links:
        raise CastError(f"{scenario.name}: link {link_name(key)}: there is none")
    delay_s, gain = taps_at(scenario, key, np.array([time_s]))
    gain = gain * amplitude_from_db(-base_loss_db(scenario, key))
    delay_s = np.rint(delay_s / GRID_STEP_S) * GRID_STEP_S  # where the hardware's filters have them
    if not gain.any():
        raise CastError(f"{scenario.name}: link {link_name(key)}: has no taps at {time_s:g} s")
    frozen = Scenario(name=scenario.name, nodes=("tx", "rx"), links={("tx", "rx"): LinkTaps(delay_s=delay_s, gain=gain)})
    sounding = _sounded(frozen, play, seed)
    found_s = sounding.taps.delay_samples[None] / SAMPLE_RATE_HZ
    found = sounding.taps.gain.mean(axis=1)[None]
    missed, extra, sigma = _deviations(sounding, delay_s[0], gain[0])
    taps = (delay_s, gain)
    heard = (found_s, found)
    width_hz = bandwidth_hz or band_hz(scenario)
    return LinkCheck(
        link=link_name(key), time_s=time_s, taps=int((gain != 0).sum()), found=found.size, missed=missed, extra=extra,
        worst_sigma=sigma, path_loss_db=_loss_db(taps, width_hz),
        tap_sum_loss_db=-float(db_from_power((np.abs(gain) ** 2).sum())), sounded_path_loss_db=_loss_db(heard, width_hz),
        ray_path_loss_db=None if rays is None else _loss_db(rays, width_hz),
        sounded_from_taps_db=_difference_db(taps, heard, width_hz),
        taps_from_rays_db=None if rays is None else _difference_db(rays, taps, width_hz),
        sounded_from_rays_db=None if rays is None else _difference_db(rays, heard, width_hz),
    )  # fmt: skip


def _loss_db(channel, bandwidth_hz: float) -> float:
    return -float(db_from_power(in_band_power(*channel, bandwidth_hz)[0]))


def _difference_db(reference, other, bandwidth_hz: float) -> float:
    return float(paths.difference_db(reference, other, bandwidth_hz)[0])


def _sounded(frozen: Scenario, play: Play, seed: int) -> Sounding:
    waveform = waveform_from_text(CODE)
    period = len(waveform.samples)
    sent = np.resize(waveform.samples, (PERIODS + 1) * period).astype(np.complex64)
    heard = np.asarray(play(frozen, sent, SAMPLE_RATE_HZ))[period:]  # echoes of the first period come from silence
    level = np.sqrt(np.mean(np.abs(heard) ** 2))
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(2, len(heard)))
    heard = heard / level + np.sqrt(10 ** (-SNR_DB / 10) / 2) * (noise[0] + 1j * noise[1])
    recording = Recording(samples=(heard * level).astype(np.complex64), sample_rate_hz=SAMPLE_RATE_HZ)
    return sound(recording, waveform, SoundingOptions(correct_offset=False))


def _deviations(sounding: Sounding, delay_s: np.ndarray, gain: np.ndarray) -> tuple[int, int, float]:
    """Taps missed, taps too many, and the largest deviation of the others in standard deviations."""
    taps = sounding.taps
    true_samples, level_db = delay_s[gain != 0] * SAMPLE_RATE_HZ, db_from_amplitude(gain[gain != 0])
    matched, missed, sigmas = set(), 0, [0.0]
    for at, db in zip(true_samples, level_db, strict=True):
        near = int(np.argmin(np.abs(taps.delay_samples - at))) if taps.delay_samples.size else -1
        if near < 0 or abs(taps.delay_samples[near] - at) > 0.5 or near in matched:
            missed += bool(db > sounding.smallest_path_gain_db + 1.0)  # a tap at the threshold itself may go either way
            continue
        matched.add(near)
        sigmas.append(abs(taps.delay_samples[near] - at) / taps.delay_std_samples[near])
        sigmas.append(abs(db_from_power(taps.power[near]) - db) / taps.gain_std_db[near])
    return missed, taps.delay_samples.size - len(matched), float(max(sigmas))


def traced_rays(path: str | Path, scenario: Scenario):
    """How to ask an installed scenario's ray-traced channel: a call (key, time_s) -> (delays, gains) (1, P), or None.

    The paths stay in the work folder that made the scenario; where it is gone, there is nothing to compare with.
    """
    if Path(path).suffix != ".zarr":
        return None
    about = zarr_file.attributes(path)
    file = Path(str(about.get("paths_file", "")))
    if not file.is_file():
        return None
    get = Reader(f"{path}: .zattrs")
    moved = _moves(get, get.sequence(about.get("delays_moved_s", []), "delays_moved_s"))
    hold_s = get.number(about.get("hold_s", 1e9), "hold_s", "s", 1e-6)
    get.faults.raise_if_any()
    links = paths.read(file)
    number = {node: index for index, node in enumerate(scenario.nodes)}

    def rays(key: tuple[str, str], time_s: float):
        for a, b in (key, key[::-1]):  # the way back is the same
            link = links.get((number[a], number[b]))
            if link is not None:
                delay_s, gain = paths.at(link, np.array([time_s]), scenario.center_frequency_hz)
                shifts_s = moved.get((a, b), [0.0])
                return delay_s + shifts_s[min(int(time_s / hold_s), len(shifts_s) - 1)], gain
        return None

    return rays


def _moves(get: Reader, entries: list) -> dict[tuple[str, str], list[float]]:
    """Seconds by which a link's delays were moved in each stretch, by (tx, rx)."""
    moved = {}
    for index, entry in enumerate(entries):
        place = f"delays_moved_s[{index}]"
        ends = [get.text(end, place) for end in get.sequence(entry, place)[:2]]
        shifts = get.sequence(entry[2] if isinstance(entry, list) and len(entry) == 3 else None, place)
        moved[tuple(ends)] = [get.number(shift, place, "s") for shift in shifts] or [0.0]
    return moved


def check(scenario: Scenario, keys: Sequence, *, rays=None, bandwidth_hz=None, play: Play = play_reference) -> list[LinkCheck]:
    """Check links: static ones once, moving ones at the start, in the middle and at the end."""
    out = []
    for key in keys:
        moving = key in scenario.links and not scenario.links[key].is_static
        for time_s in scenario.time_s[[0, scenario.time_s.size // 2, -1]] if moving else [0.0]:
            known = rays(key, time_s) if rays else None
            out.append(check_link(scenario, key, float(time_s), rays=known, bandwidth_hz=bandwidth_hz, play=play, seed=len(out)))
    return out
