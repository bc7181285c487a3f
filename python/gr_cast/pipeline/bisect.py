# SPDX-License-Identifier: GPL-3.0-or-later
"""The first bad commit between a good one and a bad one: what is worse there is looked for, and nothing else."""

from dataclasses import dataclass

from ..core.errors import CastError
from . import judge
from .run import Bench, Commit

GOOD, BAD, UNKNOWN = "good", "bad", "unknown"


@dataclass(frozen=True, kw_only=True)
class Found:
    """`suspects`: the first bad commit, or several where those between cannot be tried. `tried`: commit → what it was."""

    suspects: tuple[str, ...]
    symptoms: tuple[str, ...]
    tried: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class Symptom:
    """What makes a commit bad: metrics that are beyond against the good one or between sites, or that it fails."""

    good: Commit
    keys: frozenset[tuple]
    sentences: tuple[str, ...]

    def of(self, commit: Commit) -> str:
        """Whether a commit has it."""
        trials = commit.usable()
        if commit.stopped(trials):
            return UNKNOWN
        if trials is None or judge.failures(trials):
            return UNKNOWN if self.keys else BAD
        if not self.keys:
            return GOOD
        says = {_key(c): c.says for c in judge.comparisons(commit.pipeline, trials, self.good.trials()) if _key(c) in self.keys}
        if "beyond" in says.values():
            return BAD
        return GOOD if says and set(says.values()) == {"within"} else UNKNOWN


def _key(c: judge.Comparison) -> tuple:
    return c.against, c.site, c.experiment, c.node, c.metric


def symptom(good: Commit, bad: Commit) -> Symptom:
    """What is worse at `bad`. Raises CastError where nothing is, or where `good` does not come to its end itself."""
    before = good.usable()
    if stopped := good.stopped(before):
        raise CastError(*(f"{good.short}: {why}" for why in stopped))
    if before is None or judge.failures(before):
        raise CastError(f"{good.short}: is to be good, but fails: cast_pipeline run {good.short} says why")
    after = bad.usable()
    if stopped := bad.stopped(after):
        raise CastError(*(f"{bad.short}: {why}" for why in stopped))
    if after is None or judge.failures(after):
        return Symptom(good=good, keys=frozenset(), sentences=(f"{bad.short} fails",))
    alike = {_key(c) for c in judge.comparisons(good.pipeline, before) if c.says == "within"}
    beyond = [
        c
        for c in judge.comparisons(bad.pipeline, after, before)
        if c.says == "beyond" and (c.against == judge.BEFORE or _key(c) in alike)
    ]
    if not beyond:
        raise CastError(f"{bad.short}: no metric is worse than at {good.short}, nor do sites differ that were alike there")
    return Symptom(good=good, keys=frozenset(map(_key, beyond)), sentences=tuple(f"at {c.site}: {c.sentence()}" for c in beyond))


def bisect(bench: Bench, good: str, bad: str) -> Found:
    """Halve the commits between two until one is left. One that cannot be tried, or decided, is passed by."""
    first, last = bench.commit(good), bench.commit(bad)
    commits = bench.source.between(first.hash, last.hash)
    if not commits:
        raise CastError(f"{first.short} and {last.short} are one commit: nothing lies between them")
    what = symptom(first, last)
    low, high, tried = -1, len(commits) - 1, {commits[-1]: BAD}
    while untried := [k for k in range(low + 1, high) if tried.get(commits[k]) != UNKNOWN]:
        at = min(untried, key=lambda k: abs(2 * k - low - high))
        said = tried[commits[at]] = what.of(Commit(bench=bench, hash=commits[at]))
        bench.progress(f"{commits[at][:10]}: {said}, {len(untried) - 1} left to choose from")
        low, high = (at, high) if said == GOOD else (low, at) if said == BAD else (low, high)
    return Found(suspects=tuple(commits[low + 1 : high + 1]), symptoms=what.sentences, tried=tried)
