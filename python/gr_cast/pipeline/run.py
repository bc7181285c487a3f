# SPDX-License-Identifier: GPL-3.0-or-later
"""A commit from its sources to its verdict: check out, build, image, deploy, experiments at every site, judge."""

import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

from .. import __version__
from ..core.documents import json_file
from ..core.errors import CastError
from ..core.files import is_file, passing_folder, write_json
from ..signals.recording import sha512_of
from . import cause as causes
from . import document, image, judge, site
from .clean import Room
from .document import Experiment, Pipeline
from .patience import Stopped
from .source import Source
from .stages import Storage, fingerprint
from .trial import RUN, Trial, read_trial, tried
from .verdict import FAILS, OPEN, SAME, WORSE, Verdict, verdicts

MOST_CASES = 2  # experiments whose recordings are diagnosed, the one that differs most first


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Where commits are judged: storage, sites and clean room. `render` makes a diagnosis' page, `progress` says where it is,
    all limits of a pipeline are `patience` times as long."""

    storage: Storage
    source: Source
    inventories: Path
    room: Room
    budget_s: float = 120.0
    patience: float = 1.0
    render: Callable | None = None
    progress: Callable[[str], None] = lambda line: None

    def commit(self, name: str) -> "Commit":
        return Commit(bench=self, hash=self.source.commit(name))


@dataclass(frozen=True, kw_only=True)
class Commit:
    """One commit; everything about it is made, or taken from the storage, when it is asked for."""

    bench: Bench
    hash: str

    @property
    def short(self) -> str:
        return self.hash[:10]

    @cached_property
    def tree(self) -> Path:
        """Its files, in the storage."""
        source = self.bench.source
        _, folder = self.bench.storage.stage(
            "tree", [source.name, self.hash], lambda aside: _checked_out(source, self.hash, aside)
        )
        return folder / "tree"

    @cached_property
    def pipeline(self) -> Pipeline:
        found = document.read(self.tree)
        return replace(found, limits=found.limits.times(self.bench.patience))

    @cached_property
    def sites(self) -> list[site.Site]:
        found, faults = site.read_all(self.bench.inventories, self.pipeline, self.tree)
        if faults:
            raise CastError(*faults)
        return found

    @cached_property
    def built(self) -> dict:
        self.bench.progress(f"{self.short}: build")
        return image.built(self.bench.storage, self.bench.source, self.hash, self.pipeline, self.bench.room)

    def trials(self) -> judge.Trials:
        """Repeats of all experiments at all sites."""
        return {
            one.name: {experiment.name: self._repeats(one, experiment) for experiment in self.pipeline.experiments}
            for one in self.sites
        }

    def _repeats(self, where: site.Site, experiment: Experiment) -> list[Trial]:
        """Repeats up to the first that fails: the others would say nothing."""
        found = []
        for repeat in range(experiment.repeats):
            found.append(self._trial(where, experiment, repeat))
            if found[-1].fails:
                break
        return found

    def _trial(self, where: site.Site, experiment: Experiment, repeat: int) -> Trial:
        told = {"image": self.built["image"], "site": _plain(where), "experiment": _plain(replace(experiment, repeats=2))}
        told |= {"rate_hz": self.pipeline.sample_rate_hz, "repeat": repeat, "room": self.bench.room.kind}
        told |= {"files": [sha512_of(path) for path in self._files(experiment)]}

        def work(folder: Path) -> dict:
            self.bench.progress(f"{self.short}: {experiment.name} at {where.name}, repeat {repeat + 1} of {experiment.repeats}")
            seed = int(fingerprint(told)[:15], 16)
            with passing_folder() as place:
                image.unpacked(self.bench.storage, self.built["image"], place / image.STACK)
                result = tried(self.pipeline, experiment, self.tree, where, repeat, seed, self.bench.room, place)
                shutil.move(place / RUN, folder / RUN)
            return result

        try:
            return read_trial(*self.bench.storage.stage("trial", told, work))
        except Stopped as error:
            return Trial(fails=" ".join(error.faults), is_stopped=True)

    def _files(self, experiment: Experiment) -> list[Path]:
        paths = [self.tree / name for name in (experiment.scenario, experiment.traffic) if name]
        return [path for path in paths if is_file(path)]

    def explained(self, trials: judge.Trials, comparisons: list[judge.Comparison], at: str) -> causes.Cause | None:
        """Why a site differs from the twin; None where it does not, or where no experiment has recordings of both."""
        apart = [c for c in comparisons if c.against == judge.BETWEEN and c.site == at and c.says == "beyond"]
        apart.sort(key=lambda c: -abs(c.difference.mean) / max(c.tolerance, 1e-12))
        found = None
        for name in [*dict.fromkeys(c.experiment for c in apart)][:MOST_CASES]:
            found = self._cause(trials, name, at)
            if found.families or found.kind == "open":
                return found
        return found

    def _cause(self, trials: judge.Trials, name: str, at: str) -> causes.Cause:
        experiment = next(one for one in self.pipeline.experiments if one.name == name)
        twin, here = trials[self.pipeline.sites[0]][name][0], trials[at][name][0]
        scenario, noise_db = document.scenario_of(experiment, self.tree), causes.noise_of(self.sites[0], twin)
        told = []
        for who, trial in ((at, here), (self.pipeline.sites[0], twin)):
            inputs = [[stem.parent.parent.name for stem in trial.recordings.values()], noise_db, self.bench.budget_s]

            def work(folder: Path, trial=trial, who=who) -> dict:
                self.bench.progress(f"{self.short}: diagnosis of {name} at {who}")
                causes.case_of(folder / causes.CASE, trial, scenario, noise_db)
                return causes.diagnosed(folder, self.bench.budget_s, self.bench.render)

            told.append(self.bench.storage.stage("diagnosis", inputs, work))
        both = causes.level_db(twin, here), causes.sends_alike(twin, here)
        return replace(causes.concluded(told[0][0], told[1][0], *both), folder=told[0][1].name)

    def judged(self) -> dict:
        """The verdict's document, kept in the storage."""
        path = self.bench.storage.folder / "verdicts" / self.bench.source.name / f"{self.hash}.json"
        inputs = fingerprint([_plain(one) for one in self.sites], self.bench.room.kind)
        if (kept := _verdict_of(path)) and kept.get("inputs") == inputs:
            return kept
        parent = self.bench.source.parent(self.hash)
        before = Commit(bench=self.bench, hash=parent) if parent else None
        known = _verdict_of(path.with_name(f"{parent}.json")) if parent else None
        if known and known["baseline"] and {WORSE, FAILS} & {*known["kinds"]}:
            before = Commit(bench=self.bench, hash=known["baseline"])  # what follows a bad one is held against the last good one
        found = self._judged_against(before, known)
        about = {
            "cast_verdict": 1,
            "software": f"gr-cast {__version__}",
            "commit": self.hash,
            "subject": self.bench.source.subject(self.hash),
            "time_s": self.bench.source.time_s(self.hash),
            "parent": parent,
            "baseline": before.hash if before else None,
            "sites": list(self.pipeline.sites),
            "inputs": None if found["stopped"] else inputs,  # a verdict of other sites is none of these, nor is a stopped one
        }
        path.parent.mkdir(exist_ok=True)
        write_json(path, about | found)
        return json_file(path).document

    def _judged_against(self, before: "Commit | None", known: dict | None) -> dict:
        if self.built["fails"]:
            kind = OPEN if self.stopped(None) else FAILS
            return _document([Verdict(kind=kind, sentence=self.built["fails"])], self.built, self.stopped(None))
        baseline = before.usable() if before else None
        trials = self.trials()
        unknown = [f"{before.short}, its baseline: {why}" for why in dict.fromkeys(before.stopped(baseline))] if before else []
        found = judge.comparisons(self.pipeline, trials, baseline)
        told = verdicts(self, trials, found, baseline, known)
        about = {"similarity": judge.similarities(self.pipeline, trials)} if not judge.failures(trials) else {}
        about |= {"figures": judge.figures(trials)}
        if unknown:
            told = [*(one for one in told if one.kind != SAME), Verdict(kind=OPEN, sentence="; ".join(unknown))]
        return _document(told, self.built, [*self.stopped(trials), *unknown], found, compared=baseline is not None, **about)

    def stopped(self, trials: judge.Trials | None) -> list[str]:
        """What a limit has stopped, of its repeats, or of its build where there are none."""
        if trials is None:
            try:
                return [self.built["fails"]] if self.built.get("stopped") else []
            except CastError:  # it is no pipeline
                return []
        return [why for _, _, why, is_stopped in judge.failures(trials) if is_stopped]

    def usable(self) -> judge.Trials | None:
        """Its repeats as a baseline; None where it is no pipeline, does not build or fails its tests."""
        try:
            return self.trials() if not self.built["fails"] else None
        except CastError:
            return None


def _document(told: list[Verdict], built: dict, stopped: list[str], found=(), compared: bool = False, **about) -> dict:
    return {
        "kinds": [one.kind for one in told],
        "verdicts": [asdict(one) for one in told],
        "image": built["image"],
        "room": built["room"],
        "stopped": stopped,
        "compared": compared,
        "comparisons": [one.document() for one in found],
        **about,
    }


def _plain(value) -> dict:
    """A dataclass as plain values, without the place of its file."""
    return {key: one for key, one in asdict(value).items() if key != "folder"}


def _checked_out(source: Source, commit: str, aside: Path) -> dict:
    source.check_out(commit, aside / "tree")
    return {"commit": commit}


def _verdict_of(path: Path) -> dict | None:
    return json_file(path).document if path.is_file() else None
