# SPDX-License-Identifier: GPL-3.0-or-later
"""The verdict of a commit in the words that people act on."""

from dataclasses import dataclass

from . import judge
from .cause import Cause

SAME, WORSE, DIFFER, OPEN, FAILS = "same on both", "worse than its parent", "twin and testbed differ", "not decidable", "fails"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One thing to say: its kind, a sentence, the site that it is of, since which commit, and the cause of a difference."""

    kind: str
    sentence: str
    site: str | None = None
    since: str | None = None
    cause: dict | None = None


def _since(commit, known: dict | None, kind: str, site: str) -> str:
    """Since when it is so: the parent's word where it says the same, else this commit."""
    for one in (known or {}).get("verdicts", []):
        if one["kind"] == kind and one["site"] == site and one["since"]:
            return one["since"]
    return commit.hash


def verdicts(commit, trials: judge.Trials, found: list[judge.Comparison], baseline, known: dict | None) -> list[Verdict]:
    """All that is to be said, the worst first; one `same on both` where nothing is."""
    told = _failed(commit, trials)
    for site in trials:
        worse = [c for c in found if c.against == judge.BEFORE and c.site == site and c.says == "beyond"]
        if worse:
            since = _since(commit, known, WORSE, site)
            sentences = "; ".join(c.sentence() for c in worse)
            told.append(Verdict(kind=WORSE, site=site, since=since, sentence=f"at {site}: {sentences}, since {since[:10]}"))
    were_alike = baseline is not None and not judge.failures(baseline)
    before = judge.comparisons(commit.pipeline, baseline) if were_alike else []
    for site in commit.pipeline.sites[1:]:
        apart = [c for c in found if c.against == judge.BETWEEN and c.site == site and c.says == "beyond"]
        if not apart:
            continue
        cause = commit.explained(trials, found, site)
        was_same = were_alike and all(c.says == "within" for c in before if c.site == site)
        since = commit.hash if was_same else _since(commit, known, DIFFER, site) if known else None
        told.append(_apart(site, apart, cause, since, was_same))
    still = {c.experiment: c for c in sorted((c for c in found if c.says == "open"), key=_wanted)}
    if still:
        todo = "; ".join(f"{_wanted(c)} repeats of {name} for {c.sentence()}" for name, c in still.items())
        told.append(Verdict(kind=OPEN, sentence=f"record this: {todo}"))
    return told or [Verdict(kind=SAME, sentence="no metric differs beyond its tolerance")]


def _wanted(c: judge.Comparison) -> int:
    return c.difference.repeats_wanted(c.tolerance)


def _failed(commit, trials: judge.Trials) -> list[Verdict]:
    fails: dict[str, dict[str, str]] = {}
    unknown: dict[str, dict[str, str]] = {}
    for site, name, why, is_stopped in judge.failures(trials):
        (unknown if is_stopped else fails).setdefault(name, {})[site] = why
    told = []
    for name, reasons in unknown.items():
        told += [Verdict(kind=OPEN, site=site, sentence=f"{name} at {site}: {why}") for site, why in reasons.items()]
    for name, reasons in fails.items():
        if {*reasons, *unknown.get(name, ())} == set(trials):
            told.append(Verdict(kind=FAILS, sentence=f"{name}: {next(iter(reasons.values()))}"))
            continue
        for site, why in reasons.items():
            told.append(_apart(site, [], Cause(kind="stack", sentences=(why,)), None, False, name))
    return told


def _apart(site: str, apart, cause: Cause, since: str | None, was_same: bool, name: str = "") -> Verdict:
    sentence = f"{site}: {cause.sentence(site)}"
    if apart:
        sentence += f" [{'; '.join(c.sentence() for c in apart)}]"
    if name:
        sentence += f" [{name} fails there alone]"
    if was_same:
        sentence += f"; the commit brings it out: before {since[:10]} both were the same"
    elif since:
        sentence += f", since {since[:10]}"
    if cause.kind == "open" or (cause.kind == "unexplained" and cause.record):
        return Verdict(kind=OPEN, site=site, since=since, cause=vars(cause), sentence=f"record this: {cause.record}. {sentence}")
    return Verdict(kind=DIFFER, site=site, since=since, cause=vars(cause), sentence=sentence)
