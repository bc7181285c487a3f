# SPDX-License-Identifier: GPL-3.0-or-later
"""A place case: the folder of place.yaml, its SPEC and mesh, and its sounding campaigns, read strictly, all faults at once."""

from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.documents import Reader, yaml_file
from ...core.errors import CastError
from ...core.files import is_file
from ...scenario.create import materials, model, spec
from ...scenario.create.geometry import Solid
from ...scenario.create.media import Medium
from ...scenario.create.spec import Spec
from . import soundings
from .soundings import Sounding

FILE = "place.yaml"
VERSION = 1
MAX_BYTES = 1 << 30  # of all campaigns of a case, unpacked
MAX_SOUNDINGS = 64
UNKNOWN = {"phase": ("none", "link", "snapshot"), "delay": ("none", "node", "link"), "gain": ("none", "common", "node")}


@dataclass(frozen=True, kw_only=True)
class Place:
    """A twin of a place and what was sounded there; `media` names what each object is made of, `unknown` what the soundings
    do not claim to know of phases, delays and gains."""

    name: str
    folder: Path
    spec: Spec
    solids: tuple[Solid, ...]
    media: dict[str, Medium]
    soundings: tuple[Sounding, ...]
    unknown: dict[str, str]
    max_range_m: float | None


def is_place(folder: str | Path) -> bool:
    return is_file(Path(folder) / FILE)


def read(folder: str | Path) -> Place:
    """Read a place case. CastError names file, place, value and limit of every fault at once."""
    folder = Path(folder)
    get = yaml_file(folder / FILE, missing=": a place case is a folder with a place.yaml")
    twin, campaigns, unknown, farthest_m = _contents(get)
    told: list[str] = []
    with _told(told):
        get.faults.raise_if_any()
    made = solids = None
    with _told(told):
        made = spec.read(folder / twin) if twin else None
        solids = materials.assign(model.read(made)[0], made.materials, made.carrier_hz) if made else None
    nodes = tuple(node.name for node in made.nodes) if made else None
    found, left = [], MAX_BYTES
    for entry in campaigns:
        with _told(told):
            found.append(soundings.read(folder / entry["file"], entry["kind"], entry["vault"], nodes, left))
            left -= _size(found[-1])
            told += _absolute(folder / entry["file"], found[-1], made)
    if told:
        raise CastError(*told)
    return Place(
        name=folder.resolve().name, folder=folder, spec=made, solids=tuple(solids),
        media={solid.name: solid.medium for solid in solids}, soundings=tuple(found), unknown=unknown, max_range_m=farthest_m,
    )  # fmt: skip


def _absolute(path: Path, sounding: Sounding, made: Spec | None) -> list[str]:
    """The fault of frequencies that are no offsets from the carrier."""
    if made is None or sounding.frequency_hz is None:
        return []
    low, high = sounding.frequency_hz[[0, -1]]
    if -made.carrier_hz < low <= made.carrier_hz / 2:
        return []
    return [f"{path}: frequency_hz: got {low:g} to {high:g} Hz, needs offsets from the carrier, {made.carrier_hz:g} Hz"]


def read_file(path: str | Path) -> dict:
    """What a place.yaml says by itself. CastError has all its faults."""
    get = yaml_file(path)
    _contents(get)
    get.faults.raise_if_any()
    return get.document


def _contents(get: Reader) -> tuple[str, list[dict], dict[str, str], float | None]:
    """The SPEC's file, the campaigns, what is unknown, and the range, of a place.yaml."""
    document = get.document
    get.keys(document, "", {"cast_place", "twin", "soundings", "unknown", "limits"}, ("twin", "soundings"))
    get.version("cast_place", VERSION)
    twin = get.path_inside(document["twin"], "twin") if "twin" in document else ""
    campaigns = _campaigns(get, document.get("soundings", []))
    given = get.keys(document.get("unknown", {}), "unknown", UNKNOWN)
    unknown = {key: get.choice(given.get(key, "none"), f"unknown.{key}", choices) for key, choices in UNKNOWN.items()}
    limits = get.keys(document.get("limits", {}), "limits", {"max_range_m"})
    farthest_m = get.number(limits["max_range_m"], "limits.max_range_m", "m", 0.1, 1e6) if "max_range_m" in limits else None
    return twin, campaigns, unknown, farthest_m


@contextmanager
def _told(faults: list[str]):
    """Faults of what is read within go to the list; the next file is read all the same."""
    try:
        yield
    except CastError as error:
        faults += error.faults


def _size(sounding: Sounding) -> int:
    return sum(value.nbytes for value in vars(sounding).values() if isinstance(value, np.ndarray))


def _campaigns(get: Reader, entries) -> list[dict]:
    """What place.yaml says of its sounding files, those without a fault."""
    found = []
    entries = get.sequence(entries, "soundings")
    if not 1 <= len(entries) <= MAX_SOUNDINGS:
        get.faults.add("soundings", f"got {len(entries)} files, needs 1 to {MAX_SOUNDINGS}")
    for index, entry in enumerate(entries[:MAX_SOUNDINGS]):
        place, before = f"soundings[{index}]", len(get.faults)
        entry = get.keys(entry, place, {"file", "kind", "use"}, ("file", "kind"))
        file = get.path_inside(entry.get("file"), f"{place}.file") if "file" in entry else ""
        kind = get.choice(entry.get("kind"), f"{place}.kind", soundings.KINDS) if "kind" in entry else ""
        if "use" in entry:
            get.choice(entry["use"], f"{place}.use", ("vault",))
        if file in [one["file"] for one in found]:
            get.faults.add(f"{place}.file", f"{file} is named twice")
        if len(get.faults) == before:
            found.append({"file": file, "kind": kind, "vault": "use" in entry})
    if entries and len(found) == len(entries) and all(one["vault"] for one in found):
        get.faults.add("soundings", "all of them are use: vault, needs one or more to diagnose from")
    return found
