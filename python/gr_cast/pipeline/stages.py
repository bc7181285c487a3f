# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages of a run, kept by the fingerprint of all that they depend on: what was done once is not done again, after a kill too."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

from ..core.documents import json_file
from ..core.files import sweep_dead, write_json, written_aside

RESULT = "result.json"


def fingerprint(*inputs) -> str:
    """Hexadecimal SHA-256 of plain values."""
    return hashlib.sha256(json.dumps(inputs, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()).hexdigest()


def histories(folder: Path) -> dict[str, list[dict]]:
    """Repository → verdicts kept in a storage, parents before their children, else by date."""
    found = {}
    for repository in sorted(path for path in (folder / "verdicts").glob("*") if path.is_dir()):
        left = {one["commit"]: one for one in (json_file(path).document for path in repository.glob("[!.]*.json"))}
        order = []
        while left:
            ready = [one for one in left.values() if one["parent"] not in left]
            order.append(min(ready, key=lambda one: (one["time_s"], one["commit"])))
            del left[order[-1]["commit"]]
        if order:
            found[repository.name] = order
    return found


class Storage:
    """A folder that keeps images, results of stages and verdicts; on a network storage where builders and sites share one."""

    def __init__(self, folder: Path):
        self.folder = folder.resolve()
        for name in ("stages", "images", "verdicts", "repositories"):
            (self.folder / name).mkdir(parents=True, exist_ok=True)
            sweep_dead(self.folder / name)
        for verdicts in (self.folder / "verdicts").iterdir():
            sweep_dead(verdicts)

    def stage(self, kind: str, inputs, work: Callable[[Path], dict]) -> tuple[dict, Path]:
        """(result, its folder) of a stage: as it is kept, or else of `work(folder)`, which may leave files beside its result."""
        folder = self.folder / "stages" / f"{kind}-{fingerprint(kind, inputs)[:32]}"
        if not (folder / RESULT).is_file():
            sweep_dead(folder.parent)
            with written_aside(folder) as aside:
                aside.mkdir()
                result = work(aside)
                write_json(aside / RESULT, result)
        return json_file(folder / RESULT).document, folder
