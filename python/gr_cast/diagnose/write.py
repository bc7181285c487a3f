# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a diagnosis folder: whole, or not at all."""

import copy
import json
import shutil
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..core.arrays import plain_values
from ..core.documents import yaml_file, yaml_text
from ..core.errors import CastError
from ..core.files import written_aside
from ..core.units import db_from_amplitude, db_from_power
from ..signals.recording import data_path, meta_path
from ..twin.places.write import MESH_FILE, SPEC_FILE
from .maps import before_and_after

_MARK, _TWIN = "diagnosis.json", "twin_corrected.yaml"
_FILES = (_MARK, _TWIN, "report.html", "residual.npz", SPEC_FILE, MESH_FILE)  # of a link and of a place
_LITTER = (".DS_Store", "Thumbs.db")  # what desktops leave


def corrected_twin(diagnosis) -> dict:
    """The twin's document with the found physics in `effects`, runnable by `playback`.

    A twin does not claim a recording's gain, but levels of full scale (rails, quantiser, noise) hold only with it:
    `model.gain_db` of an effect is the gain that was measured in each of its recordings, `model.noise_power_db` the noise
    of those whose noise the twin does not tell.
    """
    document = copy.deepcopy(diagnosis.case.document)
    gains, noises = {}, {}
    for finding in diagnosis.findings:
        name = finding.observation.name
        gains.setdefault(name, []).append(db_from_amplitude(abs(complex(*finding.fit.model.base[1:3]))))
        if finding.observation.receiver not in diagnosis.case.noise_db:
            noises.setdefault(name, []).append(db_from_power(finding.fit.sigma2))
    found = []
    for e in diagnosis.document["effects"]:
        names = e["where"]["recording"]
        names = [names] if isinstance(names, str) else names
        model = {**e["model"], "gain_db": {n: np.mean(gains[n]) for n in names}}
        if noises:
            model["noise_power_db"] = {n: np.mean(noises[n]) for n in names if n in noises}
        found.append({"family": e["family"], "owner": e["owner"], "parameters": e["parameters"], "model": model})
    document["effects"] = list(document.get("effects") or []) + found
    return plain_values(document)


def maps(diagnosis) -> dict[str, np.ndarray]:
    """Every map of `maps.Maps`, in absolute power, as RECORDING[@first sample]/before or after/map."""
    out = {}
    for finding in diagnosis.findings:
        first = finding.observation.first
        name = finding.observation.name + (f"@{first}" if first else "")
        for label, both in zip(("before", "after"), before_and_after(finding, 1.0), strict=True):
            for key, value in asdict(both).items():
                out[f"{name}/{label}/{key}"] = value.astype(np.complex64 if np.iscomplexobj(value) else np.float32)
    return out


def check_replaceable(folder: str | Path) -> None:
    """Raises CastError where a folder that a diagnosis would replace as a whole holds what no diagnosis put there: a case, or
    notes."""
    folder = Path(folder)
    own = {*_FILES, *_LITTER, *_waveform_files(folder)} if (folder / _MARK).is_file() else {*_LITTER}
    try:
        others = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir() or path.is_symlink())
    except OSError as error:
        raise CastError(f"{folder}: {error.strerror or error}") from None
    if others := [name for name in others if name not in own]:
        more = f" and {len(others) - 1} more" if len(others) > 1 else ""
        raise CastError(f"{folder}: would be replaced, and it holds {others[0]}{more}, of no diagnosis: choose another folder")


def _waveform_files(folder: Path) -> list[str]:
    """The waveforms that a link's diagnosis has beside its corrected twin."""
    try:
        waveforms = yaml_file(folder / _TWIN).document.get("waveforms", {})
        stems = [Path(one["file"]) for one in waveforms.values() if "file" in one]
    except (CastError, AttributeError, KeyError, TypeError):  # there is none, or none that was written here
        return []
    return [str(path(stem)) for stem in stems for path in (meta_path, data_path)]


def write(diagnosis, folder: Path, html: str) -> None:
    """Write diagnosis.json, report.html, twin_corrected.yaml and residual.npz into `folder`, in the place of the diagnosis that
    it may hold. Raises CastError where it holds anything else."""
    folder = Path(folder)
    check_replaceable(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with written_aside(folder) as aside:
        aside.mkdir()
        text = json.dumps(plain_values(diagnosis.document), indent=1, ensure_ascii=False)
        (aside / _MARK).write_text(text + "\n", encoding="utf-8")
        (aside / _TWIN).write_text(yaml_text(corrected_twin(diagnosis)), encoding="utf-8")
        for waveform in diagnosis.case.document["waveforms"].values():
            if "file" in waveform:  # the corrected twin needs them beside it
                for path in (meta_path, data_path):
                    target = path(aside / waveform["file"])
                    target.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(path(diagnosis.case.folder / waveform["file"]), target)
        (aside / "report.html").write_text(html, encoding="utf-8")
        np.savez_compressed(aside / "residual.npz", **maps(diagnosis))
