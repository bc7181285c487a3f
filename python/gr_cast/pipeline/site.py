# SPDX-License-Identifier: GPL-3.0-or-later
"""A site's inventory: what carries the samples there, and each node's interface and device arguments. Nothing of the stack."""

from dataclasses import dataclass, field
from pathlib import Path

from ..core.documents import Reader, yaml_file
from ..core.errors import CastError
from ..twin.contract import MOST_DB, Known, check_effects
from .document import Pipeline, scenario_of

VERSION = 1
_KEYS = {"cast_site", "noise_power_db", "effects", "program", "nodes"}


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where a node stands at a site, as its commands are told: interface and device arguments."""

    interface: str = ""
    device: str = ""


@dataclass(frozen=True, kw_only=True)
class Site:
    """A twin or a testbed. Its air is the embedded emulator, with `effects` (entries of a twin) of its radios and channels, or a
    `program` that plays what was sent over radios and records what they hear."""

    name: str
    folder: Path
    noise_power_db: float | None = None
    effects: tuple[dict, ...] = ()
    program: str | None = None
    nodes: dict[str, Place] = field(default_factory=dict)

    def place(self, node: str) -> Place:
        return self.nodes.get(node, Place())


def read(path: str | Path, pipeline: Pipeline | None = None, repository: Path | None = None) -> Site:
    """Read an inventory, for a pipeline where one is given. Raises CastError with every fault at once."""
    path = Path(path)
    get = yaml_file(path, missing=f": the inventory of the site {path.stem}")
    document = get.document
    get.keys(document, "", _KEYS, ("cast_site",))
    get.version("cast_site", VERSION)
    if "program" in document and {"noise_power_db", "effects"} & {*document}:
        get.faults.add("program", "noise_power_db and effects are the embedded emulator's: drop them, or the program")
    if "program" not in document and "noise_power_db" not in document:
        get.faults.add("", "needs noise_power_db (the embedded emulator), or a program that plays and records")
    nodes = {
        get.name(name, "nodes"): _place(get, entry, f"nodes.{name}")
        for name, entry in get.mapping(document.get("nodes", {}), "nodes").items()
    }
    entries = get.sequence(document.get("effects", []), "effects")
    effects = check_effects(get, entries, _known(pipeline, repository)) if pipeline else tuple(entries)
    made = Site(
        name=path.stem,
        folder=path.parent.resolve(),
        noise_power_db=_noise(get, document),
        effects=effects,
        program=get.text(document["program"], "program") if "program" in document else None,
        nodes=nodes,
    )
    get.faults.raise_if_any()
    return made


def read_all(folder: Path, pipeline: Pipeline, repository: Path) -> tuple[list[Site], list[str]]:
    """(sites, faults) of all inventories that a pipeline names, NAME.yaml in a folder."""
    found, faults = [], []
    for name in pipeline.sites:
        try:
            found.append(read(folder / f"{name}.yaml", pipeline, repository))
        except CastError as error:
            faults += error.faults
    return found, faults


def _noise(get: Reader, document: dict) -> float | None:
    if "noise_power_db" not in document:
        return None
    return get.number(document["noise_power_db"], "noise_power_db", "dB re full scale", -MOST_DB, MOST_DB)


def _place(get: Reader, entry, place: str) -> Place:
    entry = get.keys(entry, place, {"interface", "device"})
    return Place(**{key: get.text(entry[key], f"{place}.{key}") for key in ("interface", "device") if key in entry})


def _known(pipeline: Pipeline, repository: Path | None) -> Known:
    scenarios = [scenario_of(one, repository or Path()) for one in pipeline.experiments]
    return Known(
        nodes=tuple(dict.fromkeys(node for one in scenarios for node in one.nodes)),
        links=tuple(dict.fromkeys(key for one in scenarios for key in one.links)),
        waveforms=(),
        rate_hz=pipeline.sample_rate_hz,
    )
