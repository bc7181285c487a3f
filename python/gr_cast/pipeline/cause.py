# SPDX-License-Identifier: GPL-3.0-or-later
"""Why a site differs from the twin: its recordings are diagnosed with the twin's scenario as what is believed."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..core.units import db_from_power
from ..diagnose import diagnose, read_case, write
from ..scenario import Scenario
from ..signals import recording
from ..twin import make
from .document import GAIN, RESIDUAL
from .site import Site
from .trial import Trial

CASE, DIAGNOSIS = "case", "diagnosis"
LEVEL_DB = 0.5  # between two sites that is worth a word


@dataclass(frozen=True, kw_only=True)
class Cause:
    """`kind`: radio, channel, stack, open (two causes fit alike) or unexplained. `families` are effects, the loudest first;
    `record` is what would decide an open one, `folder` the stage that holds the diagnosis."""

    kind: str
    families: tuple[str, ...] = ()
    sentences: tuple[str, ...] = ()
    record: str | None = None
    folder: str | None = None

    def sentence(self, site: str) -> str:
        if self.kind == "stack":
            return f"the stack itself: {' '.join(self.sentences)}"
        named = " and ".join(family.replace("_", " ") for family in self.families)
        whose = {"radio": f"{site}'s radio", "channel": f"{site}'s channel"}.get(self.kind, self.kind)
        return f"{named or 'nothing known'} ({whose})" + (f". {' '.join(self.sentences)}" if self.sentences else "")


def case_of(folder: Path, trial: Trial, scenario: Scenario, noise_db: dict[str, float]) -> Path:
    """A case of a repeat's recordings: what was sent is known, the scenario is what the twin believes."""
    recordings = []
    for stem in trial.recordings.values():
        one = make.heard(stem)
        sent = {tx: entry | {"file": str(stem.parent / entry["file"])} for tx, entry in one.sent.items()}
        recordings.append(replace(one, sent=sent))
    taps = {key: make.believed_of(scenario, key, 0.0, one.duration_s)[0] for one in recordings for key in one.links}
    make.write(folder, recordings, make.document(recordings, taps, noise_db))
    return folder


def noise_of(twin: Site, trial: Trial) -> dict[str, float]:
    """The floor of every receiver that the twin believes: told in its inventory, else what its recordings leave unexplained."""
    if twin.noise_power_db is not None:
        return {rx: twin.noise_power_db for rx in trial.recordings}
    levels = {rx: np.mean(np.abs(recording.read(stem).samples) ** 2) for rx, stem in trial.recordings.items()}
    return {rx: float(db_from_power(level)) + trial.metrics[f"{rx} {RESIDUAL}"] for rx, level in levels.items()}


def diagnosed(folder: Path, budget_s: float, render: Callable | None) -> dict:
    """The diagnosis of the case in `folder`/case, written beside it where a page can be rendered."""
    found = diagnose(read_case(folder / CASE), budget_s=budget_s)
    if render:
        write(found, folder / DIAGNOSIS, render(found))
    return found.document


def concluded(site: dict, twin: dict, level_db: float, sends_alike: bool) -> Cause:
    """The cause from two diagnoses with one belief, of a site's recordings and, as a control, of the twin's own; `level_db` is
    how much louder the site receives, which a diagnosis leaves open."""
    common = {(effect["family"], effect["owner"]["name"]) for effect in twin["effects"]}
    own = [effect for effect in site["effects"] if (effect["family"], effect["owner"]["name"]) not in common]
    own.sort(key=lambda effect: -(effect.get("evidence") or {}).get("delta_loglik", 0.0))
    told = dict(
        families=tuple(dict.fromkeys(effect["family"] for effect in own)),
        sentences=tuple(effect["sentence"] for effect in own),
    )
    if site["ambiguous"]:
        pair = site["ambiguous"][0]
        return Cause(kind="open", **(told | {"families": tuple(pair["families"])}), record=pair["record_next"])
    if own:
        levels = {effect["owner"]["level"] for effect in own[:1]}
        return Cause(kind="radio" if levels & {"tx", "rx"} else "channel", **told)
    if site["verdict"] == "no_mismatch" and abs(level_db) > LEVEL_DB:
        told = f"What arrives is {level_db:+.2f} dB of the twin's over a noise that is alike."
        return Cause(kind="channel", families=("level",), sentences=(told,))
    if site["verdict"] == "no_mismatch":
        what = "its recordings agree with the twin down to their noise" + ("" if sends_alike else ", what it sends does not")
        return Cause(kind="stack", sentences=(f"{what}.",))
    return Cause(kind="unexplained", record=site["residual"]["record_next"])


def level_db(twin: Trial, here: Trial) -> float:
    """How much louder a site receives than the twin, dB: of the receiver where that is most."""
    return max((here.metrics[f"{rx} {GAIN}"] - twin.metrics[f"{rx} {GAIN}"] for rx in here.recordings), key=abs)


def sends_alike(a: Trial, b: Trial) -> bool:
    """Whether nodes sent the same samples in two repeats."""
    told = []
    for trial in (a, b):
        folders = {stem.parent for stem in trial.recordings.values()}
        stems = {name.name.removesuffix(".sigmf-meta"): name for folder in folders for name in folder.glob("tx_*.sigmf-meta")}
        told.append({name: recording.read_metadata(path)["global"].get("core:sha512") for name, path in stems.items()})
    return told[0] == told[1]
