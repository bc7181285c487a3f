# SPDX-License-Identifier: GPL-3.0-or-later
"""What one recording says: its fit, what every effect of it is worth, its numbers with their intervals."""

from dataclasses import dataclass, field, replace

import numpy as np

from ..twin.effects import FAMILIES, stage_of
from ..twin.effects.base import RX_FILTER
from ..twin.model import predict
from . import heldout
from .fit import Fit, invert
from .policy import LEAST_TOLD
from .search import refit_or_known
from .throughout import is_throughout


@dataclass(frozen=True, kw_only=True)
class Worth:
    """What an effect is worth in one recording, in nats: `evidence` on the samples fitted, `held_out` on the vault, `by_chance`
    either way where impulses hold it; and its rivals."""

    evidence: float
    held_out: float | None  # None: not worked out
    by_chance: float = 0.0
    throughout: bool = True  # explains something outside the few stretches in which it explains most
    rivals: tuple = ()


@dataclass(kw_only=True)
class Finding:
    """What one recording says: its best fit, the twin's fit, the standard deviations of discrete
    parameters, what is left; `complete`: the search ended, and all it found was weighed, before its deadline."""

    observation: object
    scene: object
    data: object
    twin: Fit
    fit: Fit
    known: list = field(default_factory=list)  # other fits that the search made
    complete: bool = True
    later: bool = False  # a further part of a recording whose first part was searched
    elsewhere_nats: float = 0.0  # by which such a part is likelier where it is than where the first one lets expect it
    stds: dict = field(default_factory=dict)
    tested: list = field(default_factory=list)  # every test of the residual, with what it holds
    explained_nats: float = 0.0  # by all that was found, bands of noise aside
    left: list = field(default_factory=list)  # what of it, and of the courses, is more than noise
    ambiguous: list = field(default_factory=list)
    worths: dict[int, Worth] = field(default_factory=dict)  # by the effect's key
    steps: list | None = None  # what each effect explains after the louder ones (`maps.steps`)
    absent: bool = False  # the twin's waveform is not in it, and no effect of that was looked for

    def part_of_another(self, effect) -> bool:
        """Whether an effect is a part of another one, as the mean of a tap that fades is, and no cause of its own."""
        return any(FAMILIES[e.family].holds(self.scene, e, effect) for e in self.fit.model.found)

    def is_cause(self, effect) -> bool:
        """Whether an effect is a cause that a diagnosis names, and neither the twin's own nor what no twin plays."""
        passing = "_passing" in effect.aux  # a course that moves in one stretch alone
        return not (effect.fixed or passing or FAMILIES[effect.family].beyond or self.part_of_another(effect))

    def gain_of(self, index: int) -> float:
        """Evidence that is lost without an effect."""
        return self.worth_of(index).evidence

    def refitted(self, fit: Fit) -> None:
        """Take another fit: of effects that moved it is open again what they are worth."""
        before = {e.key: e.p for e in self.fit.model.effects}
        still = {e.key for e in fit.model.effects if e.key in before and np.array_equal(before[e.key], e.p)}
        self.worths = {key: worth for key, worth in self.worths.items() if key in still}
        self.fit = fit

    def worth_of(self, index: int) -> Worth:
        """What `_compare` found, made now where it was not asked before."""
        effect = self.fit.model.effects[index]
        key = effect.key
        if key not in self.worths:
            model = replace(self.fit.model, effects=tuple(e for e in self.fit.model.effects if "nats" not in e.aux))
            at = next(i for i, e in enumerate(model.effects) if e.key == key)
            known = self.later and not FAMILIES[effect.family].beyond  # by the first part, which a thing of one stretch is not
            told = None if known or self.data.late else worth(self.fit, refit_or_known(self.data, model.without(at), self.known))
            if told is None or self.data.late:  # a fit that the time cut short is not the best one without the effect
                most = self.data.count * np.log(max(self.twin.sigma2 / self.fit.sigma2, 1.0)) + LEAST_TOLD
                plain = predict(self.scene, self.fit.model.without(index)).y  # no better than the best one without it
                told = Worth(
                    evidence=min(told_by_curvature(self.fit, index), most),
                    held_out=None,
                    throughout=is_throughout(self.fit, plain),
                )
                self.complete = self.complete and self.later  # there was no time to prove it
            self.worths[key] = told
        return self.worths[key]


def worth(fit: Fit, without: Fit, rivals=()) -> Worth:
    """What the effect is worth that `fit` has and `without` lacks."""
    return Worth(
        evidence=float(fit.evidence - without.evidence),
        held_out=heldout.gained(fit, without),
        by_chance=0.0 if fit.data.impulses is None else heldout.spread(fit, without),
        throughout=is_throughout(fit, without.chain.y),
        rivals=tuple(replace(r, fit=None) for r in rivals),
    )


def told_by_curvature(fit: Fit, index: int) -> float:
    """Evidence that is lost without an effect, by the curvature of ln L alone (Wald's statistic) and with no fit."""
    effect, span = fit.model.effects[index], fit.model.span(index)
    if FAMILIES[effect.family].noise_like or not effect.free.any() or len(fit.model.vector()) != len(fit.hessian):
        return LEAST_TOLD
    p, covariance, n = effect.p[effect.free], fit.covariance[span, span], fit.data.count
    gain = 0.5 * p @ invert(covariance) @ p
    held = 0.0 if effect.prior is None else np.sum(np.diag(covariance) / effect.prior[effect.free])  # by the prior alone
    return float(n / 2 * np.log1p(2 * gain / n) - 0.5 * (len(p) - held) * np.log(n))


def nmse(data, y: np.ndarray, inside: np.ndarray) -> float:
    """Residual power on the samples `inside` over recorded power."""
    return float(np.mean(np.abs(data.y[inside] - y[inside]) ** 2) / np.mean(np.abs(data.y[data.use + data.vault > 0]) ** 2))


def numbers(finding: Finding, index: int) -> tuple[dict, dict]:
    """Contract parameters of one effect: {name: {value, std}} and constants."""
    fit, effect = finding.fit, finding.fit.model.effects[index]
    family, scene = FAMILIES[effect.family], finding.scene
    scene.front_end = front_end(fit.model)
    predict(scene, fit.model)  # leaves in the scene what its amplifiers and quantisers were driven with
    values = _told(scene, effect, effect.p)
    variance = {name: 0.0 for name in values}
    span = fit.model.span(index) if len(fit.model.vector()) == len(fit.hessian) else None
    beside = _left_open(fit, effect)
    moves = np.flatnonzero(effect.free | (beside > 0))
    if len(moves) and span is not None:
        cov, own = np.diag(beside[moves] ** 2), np.flatnonzero(effect.free[moves])
        cov[np.ix_(own, own)] += fit.covariance[span, span]
        gradient = {name: np.zeros(len(moves)) for name in values}
        for j, k in enumerate(moves):
            h = 1e-4 * max(np.sqrt(cov[j, j]), 1e-12)
            p = effect.p.copy()
            p[k] += h
            moved = _told(scene, effect, p)
            for name in values:
                change = moved[name] - values[name]
                if name.endswith("_rad"):
                    change = (change + np.pi) % (2 * np.pi) - np.pi
                gradient[name][j] = change / h
        variance = {name: float(g @ cov @ g) for name, g in gradient.items()}
    if "_std" in effect.aux:
        for name in values:
            h = 1e-4
            moved = [family.values(scene, effect, effect.p + h * np.eye(len(effect.p))[k])[name] for k in range(len(effect.p))]
            variance[name] = sum(((m - values[name]) / h * std) ** 2 for m, std in zip(moved, effect.aux["_std"], strict=True))
    found = family.spread(scene, effect, fit.sigma2, float(np.mean(np.abs(fit.chain.wanted) ** 2)))
    variance |= {name: variance[name] + std**2 for name, std in found.items()}
    stds = effect.aux.get("_stds") or finding.stds.get(effect.family, {})
    out = {}
    for name, value in values.items():
        std = stds.get(name, np.sqrt(max(variance[name], 0.0)))
        if effect.prior is not None:
            std = max(std, family.least_error.get(name, 0.0) * (1.0 if name.endswith("_db") else abs(value)))
        if not std:
            std = family.resolution(scene, name, value)
        out[name] = {"value": float(value), "std": float(std)}
    return out, family.constants(scene, effect)


def _left_open(fit: Fit, effect) -> np.ndarray:
    """Standard deviations that the twin tells of its own effects beside which one of the same family was found."""
    own = [e.aux["_told"] for e in fit.model.effects if e.fixed and e.family == effect.family and "_told" in e.aux]
    return np.linalg.norm(own, axis=0) if own else np.zeros(len(effect.p))


def front_end(model) -> np.ndarray:
    """Taps of the receiver's filter in a model."""
    filters = [e for e in model.effects if stage_of(e) == RX_FILTER]
    return FAMILIES[filters[0].family].impulse_response(filters[0], filters[0].p) if filters else np.ones(1)


def _told(scene, effect, p: np.ndarray) -> dict[str, float]:
    """Contract parameters of an effect's numbers `p`, with the time of the whole recording."""
    family = FAMILIES[effect.family]
    whole = family.since_the_beginning(scene, effect.moved(p))
    return family.values(scene, whole, whole.p)
