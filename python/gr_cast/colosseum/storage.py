# SPDX-License-Identifier: GPL-3.0-or-later
"""A team's network storage: /share/nas/TEAM with batch, config and images; common images beside it."""

import re
from dataclasses import dataclass
from pathlib import Path

from ..core.documents import short
from ..core.errors import CastError
from ..experiments.traffic import flows
from ..scenario import catalogue

IMAGE_SUFFIXES = (".tar.gz", ".tar.xz", ".tar.zst", ".tar")
IMAGE_RULE = "letters, digits and dashes, none of them first or last, at most 31 characters"
_IMAGE_NAME = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9-]{0,29}[A-Za-z0-9])?")
TEAM_RULE = "letters, digits and dashes, none of them first or last, at most 31 characters"
NO_TRAFFIC = 0


def is_image_name(text) -> bool:
    """Whether a text can name an image: it becomes part of a host name."""
    return isinstance(text, str) and _IMAGE_NAME.fullmatch(text) is not None


@dataclass(frozen=True, kw_only=True)
class Storage:
    """The folders of one team."""

    folder: Path

    @property
    def team(self) -> str:
        return self.folder.resolve().name

    @property
    def config(self) -> Path:
        return self.folder / "config"

    @property
    def image_folders(self) -> tuple[Path, ...]:
        """Where images are looked for, in this order."""
        return (self.folder / "images", self.folder.resolve().parent / "common" / "images")

    def images(self) -> dict[str, Path]:
        """Every image by its name; the team's own come before the common ones."""
        found = {}
        for folder in reversed(self.image_folders):
            for path in sorted(folder.iterdir()) if folder.is_dir() else []:
                name, suffix = split_suffix(path.name)
                if suffix and is_image_name(name):
                    found[name] = path
        return found

    def traffic(self) -> dict[int, Path | None]:
        """Every traffic scenario by its number; 0 is none. The team's own stand in `traffic/NUMBER.yaml`."""
        folders = (shipped_traffic(), self.folder / "traffic")
        own = {int(p.stem): p for f in folders if f.is_dir() for p in sorted(f.glob("*.yaml")) if p.stem.isdecimal()}
        return {NO_TRAFFIC: None} | own


def shipped_traffic() -> Path:
    return Path(__file__).resolve().parent / "traffic"


def traffic_nodes(path: Path | None) -> tuple[str, ...]:
    """The nodes of a traffic scenario, numbered from 1. Raises CastError."""
    nodes = flows.read(path).nodes if path else ()
    wrong = [node for node in nodes if not (node.isdecimal() and node[0] != "0" and int(node) <= 128)]
    if wrong:
        raise CastError(*(f"{path}: flows: node {short(node)}: needs a number of 1 to 128" for node in wrong))
    return nodes


def rf_scenarios() -> dict[int, Path]:
    """The catalogue's scenarios that have a number, as Colosseum's have."""
    return {int(name): path for name, path in catalogue.catalogue_entries().items() if name.isdecimal()}


def split_suffix(name: str) -> tuple[str, str]:
    """A file's name as that of an image and its suffix; no suffix where it is none of an image."""
    suffix = next((s for s in IMAGE_SUFFIXES if name.endswith(s)), "")
    return name.removesuffix(suffix), suffix


def storage_of(job: Path, folder: Path | None) -> Storage:
    """The storage that a job belongs to: `folder`, else the team's folder that the job lies in (TEAM/batch/JOB.json), else the
    job's own folder."""
    if folder is None:
        folder = job.absolute().parent
        folder = folder.parent if folder.name == "batch" else folder
    if not folder.is_dir():
        raise CastError(f"{folder}: no such folder: it is the team's storage, with batch, config and images")
    if not is_image_name(folder.resolve().name):
        raise CastError(f"{folder}: got the team {folder.resolve().name!r}, needs {TEAM_RULE}: containers are named TEAM-srn001")
    return Storage(folder=folder)
