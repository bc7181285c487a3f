# SPDX-License-Identifier: GPL-3.0-or-later
"""A place case played as recordings: every link at every time through emulator and sounder, collected into new campaigns.

The world is a SPEC: it becomes a scenario of four taps as `create` makes it, a code is sent over each link as it stands at
the time of the snapshot, with noise, and what comes out is sounded.
"""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...core.documents import yaml_file
from ...core.errors import Faults
from ...core.files import written_aside
from ...core.units import amplitude_from_db, db_from_power
from ...emulation.reference import emulate, scenario_updates
from ...scenario.create import effects, pipeline
from ...scenario.create.spec import Spec
from ...scenario.model import GRID_STEP_S, LinkTaps, Scenario, base_loss_db, link_name, taps_at
from ...signals.recording import Recording
from ...signals.waveform import waveform_from_text
from ...sounding import collect
from ...sounding.result import about_recording, as_document
from ...sounding.sound import SoundingOptions, sound
from .document import FILE, Place
from .soundings import Sounding

CODE = "glfsr:11"  # 10.2 us at this rate: longer than any delay
PERIODS = 16
RATE_HZ = 2 / GRID_STEP_S  # taps lie on samples, and chips of half a grid step tell neighbours apart
_STEPS = 64  # of the band, over which a power is the mean


@dataclass(frozen=True, kw_only=True)
class World:
    """A scenario, by how much its links' delays were moved to fit the grid in each hold, what taps lose of each link's energy,
    and the band that they stand for."""

    scenario: Scenario
    moved_s: dict[tuple[str, str], list[float]]
    hold_s: float
    lost: dict[tuple[str, str], float]
    band_hz: float


def world(spec: Spec, run: pipeline.Run) -> World:
    """The scenario of a SPEC, without installing it."""
    pipeline.create(spec, run, only="approximation")
    spec = effects.world(spec)
    scenario = pipeline.scenario(spec, run)
    moved_s = {}
    for tx, rx, shifts_s in pipeline.delays_moved_s(spec, run):
        moved_s[tx, rx] = moved_s[rx, tx] = shifts_s
    lost = pipeline.lost(spec, run)
    lost |= {key[::-1]: share for key, share in lost.items()}
    return World(scenario=scenario, moved_s=moved_s, hold_s=spec.hold_s, lost=lost, band_hz=scenario.bandwidth_hz)


def campaigns(
    place: Place,
    world: World,
    *,
    noise_power_db: float,
    seed: int,
    progress: Callable[[int, int], None] = lambda done, all_: None,
) -> dict[str, dict[str, np.ndarray]]:
    """File name → arrays of every campaign of the case, sounded in this world with noise of so much per sample, dB re what is
    sent. Raises CastError for nodes and times that the world has not."""
    _check(place, world)
    total = sum(len(one.tx) * len(one.time_s) for one in place.soundings)
    done, out = 0, {}
    for number, campaign in enumerate(place.soundings):
        rng = np.random.default_rng([seed, number])
        snapshots = []
        for time_s in np.unique(campaign.time_s):
            for tx, rx in dict.fromkeys(zip(campaign.tx, campaign.rx, strict=True)):
                snapshots.append(snapshot(world, (tx, rx), float(time_s), noise_power_db, rng))
                done += 1
                progress(done, total)
        out[campaign.file] = (
            _responses(campaign, snapshots, world) if campaign.kind == "response" else _powers(campaign, snapshots, world, rng)
        )
    return out


def _check(place: Place, world: World) -> None:
    faults, scenario = Faults(f"{place.name}"), world.scenario
    for one in place.soundings:
        for node in sorted({*one.tx, *one.rx} - {*scenario.nodes}):
            faults.add(one.file, f"node {node}: not in the world, which has {', '.join(scenario.nodes)}")
        last_s = np.inf if scenario.is_static else scenario.time_s[-1]
        if one.time_s.min() < 0 or one.time_s.max() > last_s:
            faults.add(
                one.file, f"time_s: got {one.time_s.min():g} to {one.time_s.max():g} s, the world lasts from 0 to {last_s:g} s"
            )
        if one.kind == "response" and np.count_nonzero(np.abs(one.frequency_hz) <= world.band_hz / 2) < 2:
            faults.add(one.file, f"frequency_hz: has not two within the {world.band_hz / 1e6:g} MHz that taps stand for")
    faults.raise_if_any()


def recording(world: World, link: tuple[str, str], time_s: float, noise_power_db: float, rng: np.random.Generator) -> Recording:
    """What is heard over one link as it stands at a time, whole periods of the code."""
    waveform = waveform_from_text(CODE)
    sent = np.resize(waveform.samples, (PERIODS + 1) * len(waveform.samples))
    heard = np.zeros(len(sent), complex)
    if link in world.scenario.links:
        delay_s, gain = taps_at(world.scenario, link, np.array([time_s]))
        taps = LinkTaps(
            delay_s=np.rint(delay_s / GRID_STEP_S) * GRID_STEP_S,
            gain=gain * amplitude_from_db(-base_loss_db(world.scenario, link)),
        )
        frozen = Scenario(name=link_name(link), nodes=("tx", "rx"), links={("tx", "rx"): taps})
        heard = emulate(np.stack([sent, np.zeros_like(sent)]), scenario_updates(frozen, RATE_HZ), 2)[1]
    noise = rng.normal(size=(2, len(heard))) * amplitude_from_db(noise_power_db) / np.sqrt(2)
    about = {"cast:transmitter": link[0], "cast:receiver": link[1], "cast:scenario_at_s": time_s}
    samples = (heard + noise[0] + 1j * noise[1])[len(waveform.samples) :].astype(np.complex64)
    return Recording(
        samples=samples, sample_rate_hz=RATE_HZ, center_frequency_hz=world.scenario.center_frequency_hz, metadata=about
    )


def snapshot(
    world: World, link: tuple[str, str], time_s: float, noise_power_db: float, rng: np.random.Generator
) -> collect.Snapshot:
    """One link sounded at one time, its delays moved back to where the place has them."""
    file = recording(world, link, time_s, noise_power_db, rng)
    options = SoundingOptions(correct_offset=False, carrier_offset_hz=0.0)
    about = about_recording(file, link_name(link), {"samples_per_chip": 1}, options)
    one = collect.of_document(as_document(sound(file, waveform_from_text(CODE), options), about), link_name(link))
    shifts_s = world.moved_s.get(link, [0.0])
    return replace(one, delay_s=one.delay_s - shifts_s[min(int(time_s / world.hold_s), len(shifts_s) - 1)])


def _responses(campaign: Sounding, snapshots: list[collect.Snapshot], world: World) -> dict[str, np.ndarray]:
    """The campaign's own frequencies, as far as taps stand for them. What taps lose is known no better and counts as noise: it is
    one error over all frequencies, and over all times at which taps are the same, and must not weigh more than one entry."""
    made = collect.campaign(snapshots, campaign.frequency_hz[np.abs(campaign.frequency_hz) <= world.band_hz / 2])
    power = np.nanmean(np.abs(made["response"]) ** 2, axis=(1, 2))
    links = list(zip(made["tx"].tolist(), made["rx"].tolist(), strict=True))
    alike = [len(made["frequency_hz"]) * _repeated(world, link, made["time_s"]) for link in links]
    share = [world.lost.get(link, 0.0) * count for link, count in zip(links, alike, strict=True)]
    return made | {"noise_power": made["noise_power"] + share * power}


def lost_in_words(place: Place, world: World) -> list[str]:
    """What four taps on Colosseum's grid lose of the links that are sounded: no cause in the place, and told as such."""
    sounded = {link for one in place.soundings for link in zip(one.tx, one.rx, strict=True)}
    lost_db = {link: float(db_from_power(max(world.lost.get(link, 0.0), 1e-20))) for link in sorted(sounded)}
    worst = max(lost_db, key=lost_db.get)
    return [
        f"four taps on a grid of {1e9 * GRID_STEP_S:g} ns lose {np.median([*lost_db.values()]):.1f} dB of what a link hears"
        f" (median; worst {lost_db[worst]:.1f} dB, {link_name(worst)}): counted as noise, no cause in the place"
    ]


def _repeated(world: World, link: tuple[str, str], time_s: np.ndarray) -> float:
    """How often the same taps are sounded."""
    if link not in world.scenario.links:
        return 1.0
    _, gain = taps_at(world.scenario, link, time_s)
    return len(time_s) / len(np.unique(gain, axis=0))


def _powers(
    campaign: Sounding, snapshots: list[collect.Snapshot], world: World, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Mean power over the band, read by a meter with the campaign's own error."""
    found = collect.campaign(snapshots, collect.frequencies_hz(snapshots, _STEPS, world.band_hz))
    place = {link: row for row, link in enumerate(zip(found["tx"], found["rx"], strict=True))}
    rows = [place[link] for link in zip(campaign.tx, campaign.rx, strict=True)]
    power_db = db_from_power((np.abs(found["response"][rows]) ** 2).mean(axis=2))
    power_db = np.where(np.isfinite(power_db), power_db, np.nan)[:, np.searchsorted(found["time_s"], campaign.time_s)]
    power_db = power_db + campaign.std_db[:, None] * rng.standard_normal(power_db.shape)
    known = {"tx": np.array(campaign.tx), "rx": np.array(campaign.rx), "time_s": campaign.time_s, "std_db": campaign.std_db}
    return known | {"power_db": power_db}


def write(folder: Path, place: Place, arrays: dict[str, dict[str, np.ndarray]]) -> None:
    """The case with its own twin and these campaigns in the place of its own, whole or not at all."""
    with written_aside(folder) as aside:
        aside.mkdir()
        own = yaml_file(place.folder / FILE).document
        shutil.copy(place.folder / FILE, aside)
        for file in (place.folder / own["twin"], place.spec.model_path):
            target = aside / file.resolve().relative_to(place.folder.resolve())
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(file, target)
        for name, values in arrays.items():
            (aside / name).parent.mkdir(parents=True, exist_ok=True)
            collect.write(aside / name, values)
