# SPDX-License-Identifier: GPL-3.0-or-later
"""Base loss per link, measured once in a 0 dB scenario, kept by name and version, and applied later."""

import math
import os
from dataclasses import dataclass
from pathlib import Path

from ..core.documents import json_file
from ..core.errors import CastError
from ..core.files import NAME_RULE, is_name, write_json


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """`base_loss_db` maps a link (tx, rx) to its loss in dB; `default_db` stands in for a link that was not measured."""

    name: str
    base_loss_db: dict[tuple[str, str], float]
    version: int = 0
    default_db: float | None = None

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
    links = {f"{tx}>{rx}": loss for (tx, rx), loss in sorted(calibration.base_loss_db.items())}
    write_json(path, {"cast_calibration": 1, "name": calibration.name, "version": version, **about, "base_loss_db": links})
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
    losses = {}
    for link, loss in get.mapping(get.document.get("base_loss_db"), "base_loss_db").items():
        place = f"base_loss_db: {link}"
        if link.count(">") != 1:
            get.faults.add(place, "needs the form TX>RX")
        losses[tuple(link.split(">"))] = get.number(loss, place, "dB")
    name = get.name(get.document.get("name"), "name")
    get.faults.raise_if_any()
    return Calibration(name=name, base_loss_db=losses, version=int(path.stem[1:]))
