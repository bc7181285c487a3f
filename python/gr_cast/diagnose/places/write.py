# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the diagnosis of a place: a folder, whole or not at all."""

from pathlib import Path

import numpy as np

from ...core.arrays import plain_values
from ...core.files import write_json, written_aside
from ...scenario.create.families import FAMILIES
from ...twin.places import families
from ...twin.places.correct import corrected_solids, corrected_spec
from ...twin.places.write import document as spec_document
from ...twin.places.write import write_spec
from ..write import check_replaceable
from .run import PlaceDiagnosis

_IN_SPEC = {family.name for family in families.FAMILIES if family.is_in_spec}  # a SPEC's keys say them


def write(diagnosis: PlaceDiagnosis, folder: str | Path, page: str) -> None:
    """`diagnosis.json`, `report.html`, `spec_corrected.yaml` with its mesh, `residual.npz`, in the place of the diagnosis that
    the folder may hold. Raises CastError where it holds anything else."""
    folder = Path(folder)
    check_replaceable(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with written_aside(folder) as aside:
        aside.mkdir()
        write_json(aside / "diagnosis.json", plain_values(diagnosis.document))
        (aside / "report.html").write_text(page, encoding="utf-8")
        correct(diagnosis, aside)
        np.savez_compressed(aside / "residual.npz", **residuals(diagnosis))


def correct(diagnosis: PlaceDiagnosis, folder: Path) -> None:
    """The corrected SPEC: found physics in its keys where it has one, all of it in `effects` for what has none."""
    world, spec = diagnosis.model.world, diagnosis.place.spec
    solids = corrected_solids(world)
    entries = [
        {"family": entry["family"], "owner": entry["owner"], "parameters": _known(entry)}
        for entry in diagnosis.document["effects"]  # causes: what was found in pieces is one
        if entry["family"] not in _IN_SPEC
    ]
    write_spec(folder, spec_document(corrected_spec(spec, world)), solids, plain_values(entries))


def _known(entry: dict) -> dict:
    """The parameters that a SPEC's effects have."""
    return {key: told for key, told in entry["parameters"].items() if key in FAMILIES[entry["family"]].parameters}


def residuals(diagnosis: PlaceDiagnosis) -> dict:
    """The maps behind the pictures: per campaign the residual before and after, its links and times."""
    out = {}
    for number, (one, before, after) in enumerate(
        zip((*diagnosis.ears, *diagnosis.vault), diagnosis.before, diagnosis.after, strict=True)
    ):
        out[f"before_{number}"], out[f"after_{number}"] = (fit.residual.astype(np.complex64) for fit in (before, after))
        out[f"links_{number}"] = np.array([f"{tx}>{rx}" for tx, rx in one.predictor.links])
        out[f"time_s_{number}"], out[f"frequency_hz_{number}"] = one.predictor.time_s, one.predictor.frequency_hz
    return out
