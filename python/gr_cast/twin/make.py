# SPDX-License-Identifier: GPL-3.0-or-later
"""A case from what is there: recordings that say who was on the air, and what a scenario or a sounding believes of the links."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.documents import Reader, yaml_text
from ..core.errors import CastError, Faults
from ..core.files import written_aside
from ..core.units import amplitude_from_db, db_from_amplitude, db_from_power
from ..scenario import Scenario, base_loss_db, link_name, taps_at
from ..signals import on_air, recording
from ..signals.doubts import doubts
from ..signals.waveform import waveform_from_entry
from .document import TWIN_FILE, VERSION, read_case

LEAST_SAMPLES = 256  # of a recording: fewer tell nothing apart
LONGEST_LOOK = 10_000  # instants of a scenario that one recording is compared with


@dataclass(frozen=True, kw_only=True)
class Heard:
    """A recording on disk: who sent what, with which amplitude, and who received it. `at_s` is its beginning in the scenario."""

    stem: Path
    receiver: str
    sent: dict[str, dict]
    amplitude: float
    sample_rate_hz: float
    center_frequency_hz: float | None
    duration_s: float
    at_s: float
    scenario: str | None
    doubts: tuple[str, ...]

    @property
    def links(self) -> list[tuple[str, str]]:
        return [(tx, self.receiver) for tx in self.sent]


def heard(path: str | Path, *, link: tuple[str, str] | None = None, waveform: dict | None = None) -> Heard:
    """What a recording says of itself; `link` and `waveform` (an entry of a twin) stand in for what it does not say."""
    taken, stem = recording.read(path, longest=0), recording.stem_of(path)
    get, about = Reader(str(stem)), taken.metadata
    sent = on_air.sent(about, str(stem))
    receiver = about.get("cast:receiver") or (link and link[1])
    if not sent and link:
        sent = {link[0]: about.get("cast:waveform")}
    sent = {tx: entry or waveform for tx, entry in sent.items()}
    if not sent or not receiver:
        get.faults.add("", "does not say who sends and who receives: add --link TX>RX")
    if any(entry is None for entry in sent.values()):
        get.faults.add("", "does not name its waveform: add --code, such as --code glfsr:8 or --code file:STEM")
    if taken.sample_rate_hz is None:
        get.faults.add("core:sample_rate", "missing, needs the rate in Hz")
    amplitude = get.number(about.get("cast:tx_amplitude", 1.0), "cast:tx_amplitude")
    at_s = get.number(about.get("cast:scenario_at_s", 0.0), "cast:scenario_at_s", "s")
    for tx, entry in sent.items():
        period = len(waveform_from_entry(entry).samples) if "code" in (entry or {}) else LEAST_SAMPLES
        if len(taken.samples) < max(period, LEAST_SAMPLES):
            least = f"{period} of one period of its code" if period > LEAST_SAMPLES else f"{LEAST_SAMPLES}"
            get.faults.add("", f"holds {len(taken.samples)} samples of what {tx} sends, needs {least} at least")
    get.faults.raise_if_any()
    return Heard(
        stem=stem,
        receiver=str(receiver),
        sent=sent,
        amplitude=amplitude,
        sample_rate_hz=taken.sample_rate_hz,
        center_frequency_hz=taken.center_frequency_hz,
        duration_s=len(taken.samples) / taken.sample_rate_hz,
        at_s=at_s,
        scenario=about.get("cast:scenario"),
        doubts=tuple(doubts(taken)),
    )


def believed_of(scenario: Scenario, key: tuple[str, str], at_s: float, duration_s: float) -> tuple[list[dict], float]:
    """(taps of a twin's link, what they lose in dB): the scenario's at `at_s`, base loss included, each with the one Doppler that
    fits it best over `duration_s`."""
    if key not in scenario.links:
        raise CastError(f"{scenario.name}: link {link_name(key)}: the scenario has no such link; it has {_some(scenario)}")
    clock = scenario.time_s[(scenario.time_s > at_s) & (scenario.time_s < at_s + duration_s)][:LONGEST_LOOK]
    when = np.concatenate([[at_s], clock])
    delay_s, gain = taps_at(scenario, key, when)
    used = gain[0] != 0
    if not used.any():
        raise CastError(f"{scenario.name}: link {link_name(key)}: no tap at {at_s:g} s")
    turn = np.sum(gain[1:] * gain[:-1].conj() * (delay_s[1:] == delay_s[:-1]), axis=0)
    step_s = float(np.mean(np.diff(when))) if len(when) > 1 else 1.0
    doppler_hz = np.angle(turn) / (2 * np.pi * step_s)
    wave = np.exp(2j * np.pi * doppler_hz * (when - at_s)[:, None])
    stays = (delay_s == delay_s[0]) & used
    mean = np.sum(gain * wave.conj() * stays, axis=0) / len(when)
    lost = np.sum(np.abs(gain - mean * wave * stays) ** 2) / np.sum(np.abs(gain) ** 2)
    mean = mean * amplitude_from_db(-base_loss_db(scenario, key))
    order = np.flatnonzero(used)[np.argsort(delay_s[0, used], kind="stable")]
    taps = [_tap(delay_s[0, k], mean[k], doppler_hz[k]) for k in order if mean[k] != 0]
    return taps, float(db_from_power(max(lost, 1e-30)))


def _tap(delay_s: float, gain: complex, doppler_hz: float) -> dict:
    tap = {"delay_s": float(delay_s), "gain_db": float(db_from_amplitude(gain)), "phase_rad": float(np.angle(gain))}
    return tap | ({"doppler_hz": float(doppler_hz)} if abs(doppler_hz) > 1e-9 else {})


def _some(scenario: Scenario) -> str:
    names = [link_name(key) for key in scenario.links]
    return ", ".join(names[:8]) + (", …" if len(names) > 8 else "")


def _waveforms(recordings: list[Heard]) -> dict[str, dict]:
    """Every waveform that is sent, each once, by its name in the case."""
    found = []
    for entry in (entry for one in recordings for entry in one.sent.values()):
        if entry not in found:
            found.append(entry)
    return {f"w{k + 1}": entry for k, entry in enumerate(found)}


def _check(recordings: list[Heard]) -> None:
    faults, names = Faults("case"), [one.stem.name for one in recordings]
    if len({one.sample_rate_hz for one in recordings}) > 1:
        faults.add("sample rates", ", ".join(f"{one.stem.name} {one.sample_rate_hz:g} Hz" for one in recordings) + ": needs one")
    for name in dict.fromkeys(names):
        if names.count(name) > 1:
            faults.add(name, "two recordings have this name, a case holds each name once")
    faults.raise_if_any()


def document(recordings: list[Heard], taps: dict[tuple[str, str], list[dict]], noise_db: dict[str, float]) -> dict:
    """The twin of a case: its recordings, and of every link that is heard in them the taps that are believed."""
    _check(recordings)
    waveforms = _waveforms(recordings)
    nodes, told = {}, []
    for one in recordings:
        row = {"file": one.stem.name, "receiver": one.receiver, "transmitters": [*one.sent]}
        for tx, entry in one.sent.items():
            name = next(name for name, known in waveforms.items() if known == entry)
            says = {"transmit": name, "amplitude": one.amplitude}
            first = nodes.setdefault(tx, says)
            for key in (key for key in says if says[key] != first[key]):  # otherwise than in the first recording
                row.setdefault(key, {})[tx] = says[key]
        if one.center_frequency_hz is not None:
            row["center_frequency_hz"] = one.center_frequency_hz
        told.append(row)
    links = dict.fromkeys(key for one in recordings for key in one.links)
    made = {
        "cast_twin": VERSION,
        "sample_rate_hz": recordings[0].sample_rate_hz,
        "waveforms": {name: entry | ({"file": name} if "file" in entry else {}) for name, entry in waveforms.items()},
        "nodes": nodes | {one.receiver: {} for one in recordings if one.receiver not in nodes},
        "links": [{"tx": tx, "rx": rx, "taps": taps[tx, rx]} for tx, rx in links],
        "recordings": told,
        "unknown": ["delay", "phase", "gain"],
    }
    return made | ({"noise": {rx: {"power_db": power} for rx, power in noise_db.items()}} if noise_db else {})


def write(folder: str | Path, recordings: list[Heard], made: dict) -> None:
    """Write a case, `document` with the recordings and waveforms that it names, whole or not at all. Raises CastError where the
    folder is there already, or where what was made is no case."""
    folder = Path(folder)
    if folder.exists():
        raise CastError(f"{folder}: is there already; nothing is overwritten, choose another folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    sources = {name: Path(entry["file"]) for name, entry in _waveforms(recordings).items() if "file" in entry}
    sources |= {one.stem.name: one.stem for one in recordings}
    with written_aside(folder) as aside:
        aside.mkdir()
        for name, stem in sources.items():
            for path in (recording.meta_path, recording.data_path):
                shutil.copyfile(path(stem), path(aside / name))
        (aside / TWIN_FILE).write_text(yaml_text(made), encoding="utf-8")
        try:
            read_case(aside)
        except CastError as error:
            raise CastError(*(fault.replace(str(aside), str(folder)) for fault in error.faults)) from None
