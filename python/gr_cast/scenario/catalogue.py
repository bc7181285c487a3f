# SPDX-License-Identifier: GPL-3.0-or-later
"""The catalogue: scenarios found by id or name, those that ship and those that were installed."""

import os
from pathlib import Path

from ..core.errors import CastError
from ..core.programs import called
from . import colosseum, yaml_file, zarr_file
from .model import Scenario

_READERS = {".yaml": yaml_file.read, ".yml": yaml_file.read, ".mat": colosseum.read, ".zarr": zarr_file.read}
_WRITERS = {".yaml": yaml_file.write, ".yml": yaml_file.write, ".mat": colosseum.write, ".zarr": zarr_file.write}


def shipped_folder() -> Path:
    return Path(__file__).resolve().parent / "catalogue"


def examples_folder() -> Path:
    """SPECs that ship, with their geometry."""
    return Path(__file__).resolve().parent / "examples"


def data_folder() -> Path:
    """The user's own data: installed scenarios, and the ray tracer's Python."""
    return Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local/share") / "gr_cast"


def installed_folder() -> Path:
    """Where `cast_scenario.py create` installs: $CAST_CATALOGUE, else the user's data folder."""
    return Path(os.environ.get("CAST_CATALOGUE") or data_folder() / "catalogue")


def catalogue_entries() -> dict[str, Path]:
    """Every scenario of the catalogue: id (the file's stem) to its path. An installed one comes before a shipped one."""
    entries = {}
    for folder in (shipped_folder(), installed_folder()):
        for path in sorted(folder.glob("[!.]*")) if folder.is_dir() else []:
            if path.suffix in _READERS:
                entries[path.stem] = path
    return entries


def read(path: str | Path) -> Scenario:
    """Read a scenario file by its suffix."""
    path = Path(path)
    if path.suffix.lower() not in _READERS:
        raise CastError(f"{path}: suffix: got {path.suffix!r}, needs one of {', '.join(_READERS)}")
    return _READERS[path.suffix.lower()](path)


def save(path: str | Path, scenario: Scenario, **options) -> None:
    """Write a scenario file by its suffix, whole or not at all."""
    path = Path(path)
    if path.suffix.lower() not in _WRITERS:
        raise CastError(f"{path}: suffix: got {path.suffix!r}, needs one of {', '.join(_WRITERS)}")
    if not path.parent.is_dir():
        raise CastError(f"{path}: no such folder: {path.parent}")
    _WRITERS[path.suffix.lower()](path, scenario, **options)


def is_scenario(name_or_path: str | Path) -> bool:
    """Whether `load` would take it: an id of the catalogue or a scenario file's suffix."""
    return str(name_or_path) in catalogue_entries() or Path(name_or_path).suffix.lower() in _READERS


def load(name_or_path: str | Path) -> Scenario:
    """The scenario of that catalogue id (`four_tap`, `1009`), or of that file."""
    entries = catalogue_entries()
    if str(name_or_path) in entries:
        return read(entries[str(name_or_path)])
    if Path(name_or_path).suffix.lower() in _READERS:
        return read(name_or_path)
    if (examples_folder() / f"{name_or_path}.yaml").exists():
        raise CastError(f"{name_or_path}: not made yet: {called('cast_scenario')} create {name_or_path} makes it")
    raise CastError(
        f"{name_or_path}: no such scenario: not a file (.yaml, .mat, .zarr) and not in the catalogue: {', '.join(entries)}"
    )
