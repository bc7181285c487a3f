# SPDX-License-Identifier: GPL-3.0-or-later
"""What repeats of a commit say: against its baseline at each site, and between the sites. Numbers only; causes come later."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np

from ..comparing import series as cs
from ..comparing.similarity import as_document, compare
from ..core.errors import CastError
from .document import Pipeline
from .intervals import Difference, paired
from .trial import Trial

Trials = dict[str, dict[str, list[Trial]]]  # site → experiment → repeats
BETWEEN, BEFORE = "sites", "baseline"


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One metric of one experiment: a `site` against the twin, or against the baseline at the same site."""

    against: str
    site: str
    experiment: str
    node: str
    metric: str
    unit: str
    tolerance: float
    difference: Difference
    says: str  # within, beyond, open

    def document(self) -> dict:
        return asdict(self)

    def sentence(self) -> str:
        d, unit = self.difference, f" {self.unit}" if self.unit else ""
        return (
            f"{self.metric} of node {self.node} in {self.experiment}: {d.mean:+.3g}{unit}"
            f" ({d.low:+.3g} to {d.high:+.3g}, tolerance {self.tolerance:g})"
        )


def failures(trials: Trials) -> list[tuple[str, str, str, bool]]:
    """(site, experiment, why, whether a limit stopped it): the first repeat of each experiment that did not come to its end."""
    return [
        (site, name, first.fails, first.is_stopped)
        for site, experiments in trials.items()
        for name, repeats in experiments.items()
        if (first := next((t for t in repeats if t.fails), None))
    ]


def comparisons(pipeline: Pipeline, trials: Trials, baseline: Trials | None = None) -> list[Comparison]:
    """Every comparison that a commit's repeats allow, with intervals that hold all at once."""
    pairs = [*_between_sites(pipeline, trials), *(_with_baseline(pipeline, trials, baseline) if baseline else ())]
    found = []
    for against, site, experiment, key, a, b in pairs:
        node, _, name = key.rpartition(" ")
        metric = pipeline.metrics[name]
        d = paired(a, b, len(pairs))
        says = d.said(metric.tolerance) if against == BETWEEN else d.worse(metric.tolerance, metric.better)
        found.append(
            Comparison(
                against=against, site=site, experiment=experiment, node=node, metric=name, unit=metric.unit,
                tolerance=metric.tolerance, difference=d, says=says,
            )
        )  # fmt: skip
    return found


def _between_sites(pipeline: Pipeline, trials: Trials) -> Iterator[tuple]:
    twin, *others = pipeline.sites
    for site in others:
        for name, repeats in trials[site].items():
            for key, a, b in _figures(pipeline, trials[twin][name], repeats):
                yield BETWEEN, site, name, key, a, b


def _with_baseline(pipeline: Pipeline, trials: Trials, baseline: Trials) -> Iterator[tuple]:
    for site, experiments in trials.items():
        for name, repeats in experiments.items():
            for key, a, b in _figures(pipeline, baseline.get(site, {}).get(name, []), repeats):
                if pipeline.metrics[key.rpartition(" ")[2]].better != "neither":
                    yield BEFORE, site, name, key, a, b


def _figures(pipeline: Pipeline, before: list[Trial], after: list[Trial]) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """(key, values before, values after) of every judged metric that all repeats of both tell."""
    every = [*before, *after]
    if len(before) != len(after) or not every or any(t.fails for t in every):
        return
    for key in every[0].metrics:
        if key.rpartition(" ")[2] in pipeline.metrics and all(key in t.metrics for t in every):
            yield key, np.array([t.metrics[key] for t in before]), np.array([t.metrics[key] for t in after])


def figures(trials: Trials) -> list[dict]:
    """Every figure that repeats told, one list per site, experiment and metric."""
    return [
        {"site": site, "experiment": name, "metric": key, "values": [t.metrics[key] for t in repeats if key in t.metrics]}
        for site, experiments in trials.items()
        for name, repeats in experiments.items()
        for key in repeats[0].metrics
    ]


def similarities(pipeline: Pipeline, trials: Trials) -> list[dict]:
    """Similarity ρ of every series of the first repeat, twin against site, with what ρ does not see."""
    twin, *others = pipeline.sites
    found = []
    for site in others:
        for name, repeats in trials[site].items():
            a, b = trials[twin][name][0].series, repeats[0].series
            for key in (key for key in a if key in b):
                about = {"site": site, "experiment": name, "series": key}
                try:
                    told = [cs.Series(name=who, **one[key]) for who, one in ((twin, a), (site, b))]
                    found.append(about | as_document(compare(*told, max_lag=0)))
                except CastError as error:
                    found.append(about | {"rho": None, "blind_spots": list(error.faults)})
    return found
