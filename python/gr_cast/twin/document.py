# SPDX-License-Identifier: GPL-3.0-or-later
"""Read a case folder: twin.yaml, its waveforms and its recordings, with every fault of it reported at
once."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import yaml

from ..core.errors import CastError, Faults
from ..signals import codes, recording
from .effects import NAMED

VERSION = 1
LONGEST_IN_MEMORY = 1 << 22  # samples; longer files stay on disk and are read in parts
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
_EFFECT_KEYS = {"family", "owner", "where", "parameters", "evidence", "confidence", "sentence", "model"}


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


def _number(value) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


class _Reader:
    """Walks the document and collects faults; every getter returns something usable so that the walk goes
    on."""

    def __init__(self, where: str):
        self.faults = Faults(where)

    def keys(self, place: str, entry, allowed, required=()) -> bool:
        if not isinstance(entry, dict):
            self.faults.add(place, f"got {type(entry).__name__}, needs a mapping")
            return False
        for key in entry:
            if key not in allowed:
                self.faults.add(f"{place}.{key}" if place else str(key), "unknown key")
        for key in required:
            if key not in entry:
                self.faults.add(f"{place}.{key}" if place else str(key), "missing")
        return True

    def number(self, place: str, entry: dict, key: str, default=0.0, low=-math.inf, unit="") -> float:
        value = entry.get(key, default)
        if not _number(value) or value < low:
            limit = "" if low == -math.inf else f" of {low} or more"
            self.faults.add(
                f"{place}.{key}" if place else key,
                f"got {value!r}, needs a finite number{limit} {unit}".rstrip(),
            )
            return float(default or 0.0)
        return float(value)

    def entries(self, document: dict, key: str, kind: type):
        value = document.get(key, kind())
        if not isinstance(value, kind):
            self.faults.add(key, f"got {type(value).__name__}, needs a {'list' if kind is list else 'mapping'}")
            return kind()
        return value

    def unknown(self, place: str, value) -> tuple[str, ...]:
        if not isinstance(value, list) or any(v not in UNKNOWNS for v in value):
            self.faults.add(place, f"got {value!r}, needs a list out of {', '.join(UNKNOWNS)}")
            return ()
        return tuple(value)


def read_case(folder: str | Path) -> Case:
    """Read and check a case folder. Raises CastError with one line per fault."""
    return _read(Path(folder) / TWIN_FILE, recorded=True)


def read_twin(path: str | Path) -> Case:
    """Read and check a twin alone: its waveforms lie beside it, its recordings need not exist and hold no samples here.
    Raises CastError with one line per fault."""
    return _read(Path(path), recorded=False)


def _read(path: Path, recorded: bool) -> Case:
    folder = path.parent
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CastError(f"{path}: no such file{f' (a case is a folder with a {TWIN_FILE})' if recorded else ''}") from None
    except (NotADirectoryError, IsADirectoryError, PermissionError, UnicodeDecodeError) as error:
        raise CastError(f"{path}: cannot be read: {error}") from None
    except (yaml.YAMLError, RecursionError) as error:
        raise CastError(f"{path}: not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(document, dict):
        raise CastError(f"{path}: got {type(document).__name__}, needs a mapping")
    r = _Reader(str(path))
    r.keys("", document, _TOP, ("cast_twin", "sample_rate_hz", "waveforms", "nodes", "links", "recordings"))
    if "cast_twin" in document and document["cast_twin"] != VERSION:
        r.faults.add("cast_twin", f"got {document['cast_twin']!r}, this program reads version {VERSION}")
    rate = r.number("", document, "sample_rate_hz", 1.0, unit="Hz")
    if "sample_rate_hz" in document and rate <= 0:
        r.faults.add("sample_rate_hz", f"got {rate}, needs more than 0 Hz")
        rate = 1.0
    carrier = document.get("center_frequency_hz")
    if carrier is not None and not (_number(carrier) and carrier >= 0):
        r.faults.add("center_frequency_hz", f"got {carrier!r}, needs a number of Hz or null")
        carrier = None
    r.unknown("unknown", document.get("unknown", list(UNKNOWNS)))
    waveforms = _waveforms(r, folder, r.entries(document, "waveforms", dict), rate)
    nodes = _nodes(r, r.entries(document, "nodes", dict), document)
    links = _links(r, r.entries(document, "links", list), nodes)
    observations = _observations(r, folder, document, nodes, links, rate, carrier, recorded)
    noise = _noise(r, r.entries(document, "noise", dict), nodes)
    effects = _effects(r, document.get("effects") or [], nodes, links)
    r.faults.raise_if_any()
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


def _read_sigmf(r: _Reader, place: str, stem: Path, rate: float, allow_nan: bool):
    try:
        taken = recording.read(stem, allow_nan=allow_nan, longest=LONGEST_IN_MEMORY)
    except CastError as error:
        for fault in error.faults:
            r.faults.add(place, fault)
        return None
    if taken.sample_rate_hz is not None and not math.isclose(taken.sample_rate_hz, rate, rel_tol=1e-9):
        r.faults.add(place, f"{stem.name}: core:sample_rate is {taken.sample_rate_hz} Hz, the twin says {rate} Hz")
    return taken


def _file_name(r: _Reader, place: str, entry: dict) -> str | None:
    name = entry.get("file")
    if not isinstance(name, str) or not name or Path(name).is_absolute() or ".." in Path(name).parts:
        r.faults.add(f"{place}.file", f"got {name!r}, needs a SigMF stem inside the case folder")
        return None
    return name


def _waveforms(r: _Reader, folder: Path, entries: dict, rate: float) -> dict[str, Waveform]:
    found = {}
    for name, entry in entries.items():
        place = f"waveforms.{name}"
        if not isinstance(entry, dict):
            r.faults.add(place, f"got {type(entry).__name__}, needs a mapping with code or file")
        elif "code" in entry:
            try:
                found[name] = Waveform(name=name, samples=codes.from_spec(entry), repeat=True, built_in=True)
            except CastError as error:
                for fault in error.faults:
                    r.faults.add(place, fault)
        elif r.keys(place, entry, {"file", "repeat"}, ("file",)):
            repeat = entry.get("repeat", True)
            if not isinstance(repeat, bool):
                r.faults.add(f"{place}.repeat", f"got {repeat!r}, needs true or false")
            file = _file_name(r, place, entry)
            taken = _read_sigmf(r, place, folder / file, rate, True) if file else None
            if taken is not None:
                if not any(np.nansum(np.abs(piece)) > 0 for piece in recording.pieces(taken.samples)):
                    r.faults.add(place, "holds no known sample other than zero")
                found[name] = Waveform(name=name, samples=taken.samples, repeat=bool(repeat), built_in=False)
    return found


def _nodes(r: _Reader, entries: dict, document: dict) -> dict[str, dict]:
    waveforms = document.get("waveforms") if isinstance(document.get("waveforms"), dict) else {}
    nodes = {}
    for name, entry in entries.items():
        entry = {} if entry is None else entry
        if not r.keys(f"nodes.{name}", entry, {"transmit", "amplitude"}):
            continue
        if "transmit" in entry and entry["transmit"] not in waveforms:
            r.faults.add(f"nodes.{name}.transmit", f"got {entry['transmit']!r}, not in waveforms")
        r.number(f"nodes.{name}", entry, "amplitude", 1.0, 0.0)
        nodes[name] = entry
    return nodes


def _links(r: _Reader, entries: list, nodes: dict) -> dict[tuple[str, str], Link]:
    links = {}
    for index, entry in enumerate(entries):
        place = f"links[{index}]"
        if not r.keys(place, entry, {"tx", "rx", "taps", "unknown"}, ("tx", "rx", "taps")):
            continue
        for end in ("tx", "rx"):
            if end in entry and entry[end] not in nodes:
                r.faults.add(f"{place}.{end}", f"got {entry[end]!r}, not in nodes")
        taps = []
        if not isinstance(entry.get("taps", []), list) or not entry.get("taps", [None]):
            r.faults.add(f"{place}.taps", "needs a list of one tap or more")
            continue
        for k, tap in enumerate(entry.get("taps", [])):
            where = f"{place}.taps[{k}]"
            if r.keys(where, tap, {"delay_s", "gain_db", "phase_rad", "doppler_hz"}, ("delay_s",)):
                taps.append(
                    Tap(
                        delay_s=r.number(where, tap, "delay_s", 0.0, 0.0, "s"),
                        gain_db=r.number(where, tap, "gain_db", unit="dB"),
                        phase_rad=r.number(where, tap, "phase_rad", unit="rad"),
                        doppler_hz=r.number(where, tap, "doppler_hz", unit="Hz"),
                    )
                )
        key = (entry.get("tx"), entry.get("rx"))
        if key in links:
            r.faults.add(place, f"the link {key[0]}>{key[1]} stands twice")
        unknown = r.unknown(f"{place}.unknown", entry.get("unknown", []))
        links[key] = Link(tx=key[0], rx=key[1], taps=tuple(taps), unknown=unknown)
    return links


def _observations(r: _Reader, folder: Path, document: dict, nodes, links, rate, carrier, recorded) -> list[Observation]:
    found, names = [], set()
    entries = r.entries(document, "recordings", list)
    waveforms = document.get("waveforms") if isinstance(document.get("waveforms"), dict) else {}
    allowed = {"file", "receiver", "transmitters", "transmit", "amplitude", "center_frequency_hz", "use"}
    if "recordings" in document and not entries:
        r.faults.add("recordings", "needs one recording or more")
    for index, entry in enumerate(entries):
        place = f"recordings[{index}]"
        if not r.keys(place, entry, allowed, ("file", "receiver", "transmitters")):
            continue
        file = _file_name(r, place, entry)
        if file in names:
            r.faults.add(f"{place}.file", f"{file!r} stands twice")
        names.add(file)
        receiver, transmitters = entry.get("receiver"), entry.get("transmitters", [])
        if receiver not in nodes:
            r.faults.add(f"{place}.receiver", f"got {receiver!r}, not in nodes")
        if not isinstance(transmitters, list) or not transmitters:
            r.faults.add(f"{place}.transmitters", f"got {transmitters!r}, needs a list of one node or more")
            transmitters = []
        own = {key: entry.get(key) or {} for key in ("transmit", "amplitude")}
        for key, value in own.items():
            r.keys(f"{place}.{key}", value, transmitters)
        on_air = {}
        for tx in transmitters:
            node = nodes.get(tx)
            if node is None:
                r.faults.add(f"{place}.transmitters", f"got {tx!r}, not in nodes")
                continue
            if (tx, receiver) not in links:
                r.faults.add(f"{place}", f"no link {tx}>{receiver} in links")
            waveform = own["transmit"].get(tx, node.get("transmit")) if isinstance(own["transmit"], dict) else None
            if waveform not in waveforms:
                r.faults.add(f"{place}.transmit.{tx}", f"got {waveform!r}, not in waveforms")
            amplitude = own["amplitude"].get(tx, node.get("amplitude", 1.0)) if isinstance(own["amplitude"], dict) else 1.0
            on_air[tx] = (waveform, r.number(f"{place}.amplitude", {tx: amplitude}, tx, 1.0, 0.0))
        use = entry.get("use", "fit")
        if use not in ("fit", "vault"):
            r.faults.add(f"{place}.use", f"got {use!r}, needs vault or nothing")
        frequency = entry.get("center_frequency_hz", carrier)
        if frequency is not None and not _number(frequency):
            r.faults.add(f"{place}.center_frequency_hz", f"got {frequency!r}, needs a number of Hz or null")
        taken = recording.Recording(samples=np.zeros(0, np.complex64), sample_rate_hz=rate)
        if recorded:
            taken = _read_sigmf(r, place, folder / file, rate, False) if file else None
        if taken is not None:
            if recorded and not any(piece.any() for piece in recording.pieces(taken.samples)):
                r.faults.add(place, f"{file}: every sample is zero")
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
        r.faults.add("recordings", "every recording is for the vault, none is left to fit")
    return found


def _noise(r: _Reader, entries: dict, nodes) -> dict[str, float]:
    noise = {}
    for name, entry in entries.items():
        place = f"noise.{name}"
        if name not in nodes:
            r.faults.add(place, "not in nodes")
        if r.keys(place, entry, {"power_db"}, ("power_db",)):
            noise[name] = r.number(place, entry, "power_db", unit="dB")
    return noise


def _effects(r: _Reader, entries, nodes, links) -> tuple[dict, ...]:
    if not isinstance(entries, list):
        r.faults.add("effects", f"got {type(entries).__name__}, needs a list")
        return ()
    owners = {*nodes, *(f"{tx}>{rx}" for tx, rx in links), "environment"}
    for index, entry in enumerate(entries):
        place = f"effects[{index}]"
        if not r.keys(place, entry, _EFFECT_KEYS, ("family", "owner", "parameters")):
            continue
        if entry.get("family") not in NAMED:
            r.faults.add(f"{place}.family", f"got {entry.get('family')!r}, needs one of {', '.join(NAMED)}")
        owner = entry.get("owner")
        if not isinstance(owner, dict) or owner.get("name") not in owners:
            r.faults.add(
                f"{place}.owner",
                f"got {owner!r}, needs level and the name of a node, a link tx>rx or environment",
            )
        if not isinstance(entry.get("parameters"), dict):
            r.faults.add(f"{place}.parameters", "needs a mapping")
    return tuple(entry for entry in entries if isinstance(entry, dict))
