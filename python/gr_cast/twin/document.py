# SPDX-License-Identifier: GPL-3.0-or-later
"""Read a case folder: twin.yaml, its waveforms and its recordings, with every fault of it reported at
once."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..core.documents import Reader, short, yaml_file
from ..core.errors import CastError
from ..signals import codes, recording
from ..signals.periods import one_period
from .contract import LONGEST_DELAY, MOST_DB, Known, check_effects

VERSION = 1
LONGEST_IN_MEMORY = 1 << 22  # samples; longer files stay on disk and are read in parts
SLOWEST_HZ, FASTEST_HZ = 1e-3, 1e15  # sample rates beyond which no number worked out of them is one
LARGEST = 1e6  # amplitude of a transmitter, full scale 1.0
TWIN_FILE = "twin.yaml"
UNKNOWNS = ("delay", "phase", "gain")
_TOP = {
    "cast_twin",
    "sample_rate_hz",
    "center_frequency_hz",
    "waveforms",
    "nodes",
    "links",
    "recordings",
    "noise",
    "unknown",
    "effects",
}


@dataclass(frozen=True, kw_only=True)
class Tap:
    """One path of a link; complex amplitude 10^(gain_db/20)·exp(j·phase_rad)."""

    delay_s: float
    gain_db: float = 0.0
    phase_rad: float = 0.0
    doppler_hz: float = 0.0

    @property
    def amplitude(self) -> complex:
        return 10 ** (self.gain_db / 20) * np.exp(1j * self.phase_rad)


@dataclass(frozen=True, kw_only=True)
class Link:
    tx: str
    rx: str
    taps: tuple[Tap, ...]
    unknown: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Waveform:
    """Samples (n,) complex64 of one period or of the whole, NaN where not known."""

    name: str
    samples: np.ndarray | recording.Stored
    repeat: bool
    built_in: bool

    @cached_property
    def level(self) -> tuple[float, float]:
        """(mean power of the known samples, their largest magnitude)."""
        power = [np.abs(piece[np.isfinite(piece)].astype(complex)) ** 2 for piece in recording.pieces(self.samples)]
        count = sum(len(p) for p in power)
        return float(sum(p.sum() for p in power) / count), float(np.sqrt(max(p.max(initial=0.0) for p in power)))


@dataclass(frozen=True, kw_only=True)
class Observation:
    """One recording of a case with what was on the air: transmitter → (waveform name, amplitude)."""

    name: str
    receiver: str
    on_air: dict[str, tuple[str, float]]
    samples: np.ndarray | recording.Stored
    datatype: str
    center_frequency_hz: float | None
    vault: bool
    first: int = 0  # index in the recording of the first sample here, where this is a part of it
    whole: int = 0  # samples of the recording, where this is a part of it

    def part(self, first: int, last: int) -> "Observation":
        return replace(self, samples=self.samples[first:last], first=first, whole=len(self.samples))


@dataclass(frozen=True, kw_only=True)
class Case:
    name: str
    folder: Path
    document: dict
    sample_rate_hz: float
    waveforms: dict[str, Waveform]
    links: dict[tuple[str, str], Link]
    observations: tuple[Observation, ...]
    noise_db: dict[str, float]
    effects: tuple[dict, ...]

    @property
    def transmitters(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(tx for o in self.observations for tx in o.on_air))

    def sent(self, observation: Observation) -> dict[str, dict]:
        """Transmitter to the entry of its waveform in a recording, as it is found from any folder."""
        entries = {tx: self.document["waveforms"][name] for tx, (name, _) in observation.on_air.items()}
        return {tx: e | {"file": str((self.folder / e["file"]).resolve())} if "file" in e else e for tx, e in entries.items()}


def read_case(folder: str | Path) -> Case:
    """Read and check a case folder. Raises CastError with one line per fault."""
    return _read(Path(folder) / TWIN_FILE, recorded=True)


def read_twin(path: str | Path) -> Case:
    """Read and check a twin alone: its waveforms lie beside it, its recordings need not exist and hold no samples here.
    Raises CastError with one line per fault."""
    return _read(Path(path), recorded=False)


def _read(path: Path, recorded: bool) -> Case:
    folder = path.parent
    case = f" (a case is a folder with a {TWIN_FILE}, or with a place.yaml for a place)"
    get = yaml_file(path, missing=case if recorded else "")
    document = get.document
    get.keys(document, "", _TOP, ("sample_rate_hz", "waveforms", "nodes", "links", "recordings"))
    get.version("cast_twin", VERSION)
    is_told = "sample_rate_hz" in document
    told = get.number(document["sample_rate_hz"], "sample_rate_hz", "Hz", SLOWEST_HZ, FASTEST_HZ) if is_told else math.nan
    rate = 1.0 if math.isnan(told) else told
    carrier = _carrier(get, document.get("center_frequency_hz"), "center_frequency_hz")
    _unknown(get, document.get("unknown", list(UNKNOWNS)), "unknown")
    waveforms = _waveforms(get, folder, told)
    nodes = _nodes(get)
    links = _links(get, nodes, rate)
    observations = _observations(get, folder, nodes, links, told, carrier, recorded)
    noise = _noise(get, nodes)
    entries = document.get("effects")
    known = Known(nodes=tuple(nodes), links=tuple(links), waveforms=tuple(_mapping(get, "waveforms")), rate_hz=rate)
    effects = check_effects(get, get.sequence([] if entries is None else entries, "effects"), known)
    get.faults.raise_if_any()
    return Case(
        name=folder.resolve().name,
        folder=folder,
        document=document,
        sample_rate_hz=rate,
        waveforms=waveforms,
        links=links,
        observations=tuple(observations),
        noise_db=noise,
        effects=effects,
    )


def _mapping(get: Reader, key: str) -> dict:
    """A section of the document, its names checked elsewhere; empty where it is not given or none."""
    section = get.document.get(key, {})
    return section if isinstance(section, dict) else {}


def _carrier(get: Reader, value, place: str) -> float | None:
    return None if value is None else get.number(value, place, "Hz", 0.0, 1e15)


def _unknown(get: Reader, value, place: str) -> tuple[str, ...]:
    entries = get.sequence(value, place)
    return tuple(get.choice(one, f"{place}[{k}]", UNKNOWNS) for k, one in enumerate(entries))


def _read_sigmf(get: Reader, place: str, stem: Path, rate: float, allow_nan: bool):
    try:
        taken = recording.read(stem, allow_nan=allow_nan, longest=LONGEST_IN_MEMORY)
    except CastError as error:
        for fault in error.faults:
            get.faults.add(place, fault)
        return None
    is_comparable = taken.sample_rate_hz is not None and not math.isnan(rate)  # NaN: the twin's own is refused
    if is_comparable and not math.isclose(taken.sample_rate_hz, rate, rel_tol=1e-9):
        get.faults.add(place, f"{stem.name}: core:sample_rate is {taken.sample_rate_hz} Hz, the twin says {rate} Hz")
    return taken


def _waveforms(get: Reader, folder: Path, rate: float) -> dict[str, Waveform]:
    found = {}
    for name, entry in get.mapping(get.document.get("waveforms", {}), "waveforms").items():
        place = f"waveforms.{get.name(name, 'waveforms')}"
        if not isinstance(entry, dict):
            get.faults.add(place, f"got {short(entry)}, needs a mapping with code or file")
        elif "code" in entry:
            try:
                found[name] = Waveform(name=name, samples=codes.from_spec(entry), repeat=True, built_in=True)
            except CastError as error:
                for fault in error.faults:
                    get.faults.add(place, fault)
        elif "file" in get.keys(entry, place, {"file", "repeat"}, ("file",)):
            repeat = get.truth(entry.get("repeat", True), f"{place}.repeat")
            file = get.path_inside(entry["file"], f"{place}.file")
            taken = _read_sigmf(get, place, folder / file, rate, True) if file else None
            if taken is not None:
                if not any(np.nansum(np.abs(piece)) > 0 for piece in recording.pieces(taken.samples)):
                    get.faults.add(place, "holds no known sample other than zero")
                samples = one_period(taken.samples) if repeat and isinstance(taken.samples, np.ndarray) else taken.samples
                found[name] = Waveform(name=name, samples=samples, repeat=repeat, built_in=False)
    return found


def _named(get: Reader, value, place: str, names, what: str) -> str | None:
    """A name of the document's own, else None."""
    name = str(value) if isinstance(value, int) and not isinstance(value, bool) else value
    if isinstance(name, str) and name in names:
        return name
    get.faults.add(place, f"got {short(value)}, not in {what}")
    return None


def _nodes(get: Reader) -> dict[str, dict]:
    """What each node says of itself: `transmit`, a waveform, and `amplitude`, where it does."""
    nodes = {}
    for name, entry in get.mapping(get.document.get("nodes", {}), "nodes").items():
        place = f"nodes.{get.name(name, 'nodes')}"
        entry = get.keys({} if entry is None else entry, place, {"transmit", "amplitude"})
        nodes[name] = {}
        if "transmit" in entry:
            nodes[name]["transmit"] = _named(get, entry["transmit"], f"{place}.transmit", _mapping(get, "waveforms"), "waveforms")
        if "amplitude" in entry:
            nodes[name]["amplitude"] = get.number(entry["amplitude"], f"{place}.amplitude", "", 0.0, LARGEST)
    return nodes


def _links(get: Reader, nodes: dict, rate: float) -> dict[tuple[str, str], Link]:
    links = {}
    for index, entry in enumerate(get.sequence(get.document.get("links", []), "links")):
        place = f"links[{index}]"
        entry = get.keys(entry, place, {"tx", "rx", "taps", "unknown"}, ("tx", "rx", "taps"))
        key = tuple(_named(get, entry[end], f"{place}.{end}", nodes, "nodes") if end in entry else None for end in ("tx", "rx"))
        entries = get.sequence(entry.get("taps", [None]), f"{place}.taps")
        if not entries:
            get.faults.add(f"{place}.taps", "needs a list of one tap or more")
        taps = [_tap(get, tap, f"{place}.taps[{k}]", rate) for k, tap in enumerate(entries)] if "taps" in entry else []
        if key in links and None not in key:
            get.faults.add(place, f"the link {key[0]}>{key[1]} stands twice")
        links[key] = Link(
            tx=key[0], rx=key[1], taps=tuple(taps), unknown=_unknown(get, entry.get("unknown", []), f"{place}.unknown")
        )
    return links


def _tap(get: Reader, entry, place: str, rate: float) -> Tap:
    entry = get.keys(entry, place, {"delay_s", "gain_db", "phase_rad", "doppler_hz"}, ("delay_s",))
    limits = (
        ("delay_s", "s", 0.0, LONGEST_DELAY / rate), ("gain_db", "dB", -MOST_DB, MOST_DB), ("phase_rad", "rad", -1e6, 1e6),
        ("doppler_hz", "Hz", -rate, rate),
    )  # fmt: skip
    return Tap(**{key: get.number(entry.get(key, 0.0), f"{place}.{key}", unit, low, high) for key, unit, low, high in limits})


def _observations(get: Reader, folder: Path, nodes, links, rate, carrier, recorded) -> list[Observation]:
    found, names = [], set()
    entries = get.sequence(get.document.get("recordings", [None]), "recordings")
    allowed = {"file", "receiver", "transmitters", "transmit", "amplitude", "center_frequency_hz", "use"}
    if not entries:
        get.faults.add("recordings", "needs one recording or more")
    for index, entry in enumerate(entries if "recordings" in get.document else ()):
        place = f"recordings[{index}]"
        entry = get.keys(entry, place, allowed, ("file", "receiver", "transmitters"))
        if not {"file", "receiver", "transmitters"} <= {*entry}:
            continue
        file = get.path_inside(entry["file"], f"{place}.file")
        if file and file in names:
            get.faults.add(f"{place}.file", f"{short(file)} stands twice")
        names.add(file)
        receiver = _named(get, entry["receiver"], f"{place}.receiver", nodes, "nodes")
        on_air = _on_air(get, entry, place, receiver, nodes, links)
        use = get.choice(entry.get("use", "fit"), f"{place}.use", ("fit", "vault"))
        frequency = _carrier(get, entry.get("center_frequency_hz", carrier), f"{place}.center_frequency_hz")
        taken = recording.Recording(samples=np.zeros(0, np.complex64), sample_rate_hz=rate)
        if recorded:
            taken = _read_sigmf(get, place, folder / file, rate, False) if file else None
        if taken is not None:
            if recorded and not any(piece.any() for piece in recording.pieces(taken.samples)):
                get.faults.add(place, f"{file}: every sample is zero")
            found.append(
                Observation(
                    name=file,
                    receiver=receiver,
                    on_air=on_air,
                    samples=taken.samples,
                    datatype=taken.datatype,
                    center_frequency_hz=frequency,
                    vault=use == "vault",
                )
            )
    if recorded and found and all(o.vault for o in found):
        get.faults.add("recordings", "every recording is for the vault, none is left to fit")
    return found


def _on_air(get: Reader, entry: dict, place: str, receiver, nodes, links) -> dict[str, tuple[str, float]]:
    """Transmitter → (waveform, amplitude) of one recording."""
    transmitters = get.sequence(entry["transmitters"], f"{place}.transmitters")
    transmitters = [_named(get, tx, f"{place}.transmitters", nodes, "nodes") for tx in transmitters]
    if not transmitters:
        get.faults.add(f"{place}.transmitters", "needs a list of one node or more")
    if len({*transmitters}) < len(transmitters):
        get.faults.add(f"{place}.transmitters", "the same node stands twice")
    own = {}
    for key in ("transmit", "amplitude"):
        told = entry.get(key)
        own[key] = get.keys({} if told is None else told, f"{place}.{key}", {*transmitters} - {None})
    on_air = {}
    for tx in transmitters:
        if tx is None:
            continue
        if receiver is not None and (tx, receiver) not in links:
            get.faults.add(place, f"no link {tx}>{receiver} in links")
        waveform = own["transmit"].get(tx, nodes[tx].get("transmit"))
        waveform = _named(get, waveform, f"{place}.transmit.{tx}", _mapping(get, "waveforms"), "waveforms")
        amplitude = own["amplitude"].get(tx, nodes[tx].get("amplitude", 1.0))
        if tx in own["amplitude"]:
            amplitude = get.number(amplitude, f"{place}.amplitude.{tx}", "", 0.0, LARGEST)
        on_air[tx] = (waveform, float(amplitude))
    return on_air


def _noise(get: Reader, nodes) -> dict[str, float]:
    noise = {}
    for name, entry in get.mapping(get.document.get("noise", {}), "noise").items():
        place = f"noise.{short(name)[1:-1]}"
        _named(get, name, place, nodes, "nodes")
        entry = get.keys(entry, place, {"power_db"}, ("power_db",))
        if "power_db" in entry:
            noise[name] = get.number(entry["power_db"], f"{place}.power_db", "dB", -MOST_DB, MOST_DB)
    return noise
