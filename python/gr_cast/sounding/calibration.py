# SPDX-License-Identifier: GPL-3.0-or-later
"""Base loss and delay per link, measured once in a scenario of 0 dB and no delay, kept by name and version, and applied later."""

import math
import os
from dataclasses import dataclass, field
from pathlib import Path

from ..core.documents import Reader, json_file
from ..core.errors import CastError
from ..core.files import NAME_RULE, is_name, write_json


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """`base_loss_db` maps a link (tx, rx) to its loss in dB; `default_db` stands in for a link that was not measured.
    `base_delay_s` maps those that were measured with one axis of time at both ends to their delay."""

    name: str
    base_loss_db: dict[tuple[str, str], float]
    version: int = 0
    default_db: float | None = None
    base_delay_s: dict[tuple[str, str], float] = field(default_factory=dict)

    def of(self, link: tuple[str, str]) -> float:
        loss = self.base_loss_db.get(link, self.default_db)
        if loss is None:
            raise CastError(f"calibration {self.name}: link {link[0]}>{link[1]} was not measured")
        return loss


def store_folder() -> Path:
    """Where calibrations live: $CAST_CALIBRATIONS, else the user's data folder."""
    data = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local/share")
    return Path(os.environ.get("CAST_CALIBRATIONS") or data / "gr_cast/calibrations")


def save(calibration: Calibration, about: dict) -> Path:
    """Store as the next version of its name; no version is ever overwritten. Returns the file."""
    if not is_name(calibration.name):
        raise CastError(f"calibration name: got {calibration.name!r}, needs {NAME_RULE}")
    folder = store_folder() / calibration.name
    folder.mkdir(parents=True, exist_ok=True)
    version = max(_versions(folder), default=0) + 1
    path = folder / f"v{version}.json"
    measured = {"base_loss_db": calibration.base_loss_db, "base_delay_s": calibration.base_delay_s}
    links = {name: {f"{tx}>{rx}": value for (tx, rx), value in sorted(of.items())} for name, of in measured.items()}
    write_json(path, {"cast_calibration": 1, "name": calibration.name, "version": version, **about, **links})
    return path


def _versions(folder: Path) -> list[int]:
    return sorted(int(path.stem[1:]) for path in folder.glob("v*.json") if path.stem[1:].isdecimal())


def load(text: str) -> Calibration:
    """A calibration by `NAME` (its newest version), `NAME@VERSION`, or a plain number of dB for every link."""
    try:
        loss_db = float(text)
    except ValueError:
        pass
    else:
        if not math.isfinite(loss_db):
            raise CastError(f"base loss: got {text}, needs a finite number of dB or a calibration's name")
        return Calibration(name=text, base_loss_db={}, default_db=loss_db)
    name, _, wanted = text.partition("@")
    folder = store_folder() / name
    versions = _versions(folder) if is_name(name) and folder.is_dir() else []
    if not versions:
        known = sorted(path.name for path in store_folder().glob("*") if path.is_dir())
        raise CastError(f"base loss: no calibration named {name!r} in {store_folder()}; known: {', '.join(known) or 'none'}")
    if wanted and (not wanted.isdecimal() or int(wanted) not in versions):
        raise CastError(f"base loss: {name} has no version {wanted!r}, it has {', '.join(map(str, versions))}")
    return _read(folder / f"v{wanted or versions[-1]}.json")


def _read(path: Path) -> Calibration:
    get = json_file(path)
    get.version("cast_calibration", 1)
    losses = _of_links(get, "base_loss_db", "dB")
    delays = _of_links(get, "base_delay_s", "s") if "base_delay_s" in get.document else {}
    name = get.name(get.document.get("name"), "name")
    get.faults.raise_if_any()
    return Calibration(name=name, base_loss_db=losses, version=int(path.stem[1:]), base_delay_s=delays)


def _of_links(get: Reader, key: str, unit: str) -> dict[tuple[str, str], float]:
    found = {}
    for link, value in get.mapping(get.document.get(key), key).items():
        place = f"{key}: {link}"
        if link.count(">") != 1:
            get.faults.add(place, "needs the form TX>RX")
        found[tuple(link.split(">"))] = get.number(value, place, unit)
    return found
