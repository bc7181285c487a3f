# SPDX-License-Identifier: GPL-3.0-or-later
"""From a case to its diagnosis: every recording on its own, then all of them together."""

import time
from dataclasses import dataclass, field, replace

import numpy as np

from ..effects import FAMILIES
from ..effects.base import start
from . import align, gate, residual
from .fit import Fit, gain_of_receiver
from .search import refit, search

BUDGET_S = 240.0
UNEXPLAINED_P = 1e-5
UNEXPLAINED_NATS = 40.0
UNEXPLAINED_SHARE = 0.01


@dataclass(kw_only=True)
class Finding:
    """What one recording says: its best fit, the twin's fit, the standard deviations of discrete
    parameters, what is left."""

    observation: object
    scene: object
    data: object
    twin: Fit
    fits: list[Fit]
    stds: dict = field(default_factory=dict)
    left: list = field(default_factory=list)
    missing: list = field(default_factory=list)

    @property
    def fit(self) -> Fit:
        return self.fits[0]


def nmse(data, y: np.ndarray, inside: np.ndarray) -> float:
    """Residual power on the samples `inside` over recorded power."""
    return float(
        np.mean(np.abs(data.y[inside] - y[inside]) ** 2)
        / np.mean(np.abs(data.y[data.use + data.vault > 0]) ** 2)
    )


def examine(case, observation, *, deadline: float) -> Finding:
    """Search one recording."""
    scene, data, model = align.build(case, observation)
    plain = replace(model, effects=tuple(e for e in model.effects if e.fixed))
    stds = {}
    for effect, std in gate.discrete(observation.samples.astype(complex), observation.datatype):
        model = model.adding(effect)
        stds[effect.family] = std
    twin = refit(data, plain)
    scene.rms = float(np.sqrt(np.mean(np.abs(refit(data, model).chain.wanted) ** 2)))
    fits = search(data, model, deadline=deadline)
    finding = Finding(observation=observation, scene=scene, data=data, twin=twin, fits=fits, stds=stds)
    finding.fits[0] = _settle(finding.fit)
    _floor(finding)
    _look_for_rest(finding)
    return finding


def _settle(fit: Fit) -> Fit:
    """Effects by search carry the floor that noise families are told against."""
    effects = tuple(
        replace(e, aux={**e.aux, "_floor": fit.sigma2}) if FAMILIES[e.family].noise_like else e
        for e in fit.model.effects
    )
    return replace(fit, model=replace(fit.model, effects=effects))


def _floor(finding: Finding) -> None:
    """Compare the floor with the twin's, on samples that the rails do not touch."""
    fit, told = finding.fit, finding.data.noise_power
    if told is None:
        return
    inside = off_the_rails(fit)
    shape = np.ones(fit.data.scene.count) if fit.data.variance is None else fit.data.variance
    n = float(inside.sum())
    floor = float(np.mean(np.abs(fit.residual[inside]) ** 2 / shape[inside]))
    for e in fit.model.effects:
        if e.family == "quantization":
            floor = max(floor - e.p[0] ** 2 / 6, floor * 1e-3)
    ratio = floor / told
    nats = n * (ratio - 1 - np.log(ratio))
    # A gain that changes has no level of its own: how far it moves is how well the floor is known.
    moved = gain_of_receiver(fit, fit.model)
    doubt_db = 0.05 if moved is None else 0.05 + 10 * np.log10(moved.max() / moved.min())
    if nats > 0.5 * np.log(n) + 8 and abs(10 * np.log10(ratio)) > doubt_db:
        effect = start(
            FAMILIES["noise_floor"],
            [10 * np.log10(ratio)],
            free=[False],
            aux={"_floor": floor, "nats": float(nats)},
        )
        finding.fits[0] = replace(fit, model=fit.model.adding(effect))
        finding.stds["noise_floor"] = {"change_db": 10 / np.log(10) / np.sqrt(n)}


def off_the_rails(fit: Fit) -> np.ndarray:
    """(n,) bool: used samples whose prediction stays three noise deviations inside the rails."""
    inside = fit.data.use > 0
    for e in fit.model.effects:
        if e.family == "adc_clipping":
            level = e.p[0] - 3 * np.sqrt(fit.sigma2 / 2)
            inside = inside & (np.abs(fit.chain.y.real) < level) & (np.abs(fit.chain.y.imag) < level)
    return inside if inside.sum() > 100 else fit.data.use > 0


def _look_for_rest(finding: Finding) -> None:
    fit = finding.fit
    explained = max(0.0, finding.twin.sigma2 / fit.sigma2 - 1) * fit.data.count
    for rest in residual.leftovers(fit, off_the_rails(fit)):
        if rest.p_value < UNEXPLAINED_P and rest.nats > max(UNEXPLAINED_NATS, UNEXPLAINED_SHARE * explained):
            finding.left.append(rest)


@dataclass(kw_only=True)
class Diagnosis:
    """What `write` turns into files: the contract's document and the findings behind it."""

    case: object
    document: dict
    findings: list[Finding]


def numbers(finding: Finding, index: int) -> tuple[dict, dict]:
    """Contract parameters of one effect: {name: {value, std}} and constants."""
    fit, effect = finding.fit, finding.fit.model.effects[index]
    family, scene = FAMILIES[effect.family], finding.scene
    values = family.values(scene, effect, effect.p)
    variance = {name: 0.0 for name in values}
    span = fit.model.span(index) if len(fit.model.vector()) == len(fit.hessian) else None
    free = np.flatnonzero(effect.free)
    if len(free) and span is not None:
        cov = fit.covariance[span, span]
        gradient = {name: np.zeros(len(free)) for name in values}
        for j, k in enumerate(free):
            h = 1e-4 * max(np.sqrt(cov[j, j]), 1e-12)
            p = effect.p.copy()
            p[k] += h
            moved = family.values(scene, effect, p)
            for name in values:
                change = moved[name] - values[name]
                if name.endswith("_rad"):
                    change = (change + np.pi) % (2 * np.pi) - np.pi
                gradient[name][j] = change / h
        variance = {name: float(g @ cov @ g) for name, g in gradient.items()}
    stds = finding.stds.get(effect.family, {})
    out = {}
    for name, value in values.items():
        std = stds.get(name, np.sqrt(max(variance[name], 0.0)) * INFLATION)
        if not std:
            std = default_std(effect.family, name, value, scene)
        out[name] = {"value": float(value), "std": float(std)}
    return out, family.constants(scene, effect)


INFLATION = 1.1


def default_std(family: str, name: str, value: float, scene) -> float:
    """For numbers found by search: the resolution of the search."""
    if name == "delay_s":
        return 0.0
    if name == "time_s":
        return 2.0 / scene.sample_rate_hz
    if name == "samples":
        return 0.0
    return abs(value) * 0.05


def diagnose(case, *, budget_s: float = BUDGET_S) -> Diagnosis:
    """Diagnose a case within about `budget_s` seconds."""
    begun = time.monotonic()
    fitted = [o for o in case.observations if not o.vault]
    findings = []
    for k, observation in enumerate(fitted):
        share = (budget_s - (time.monotonic() - begun)) / (len(fitted) - k)
        findings.append(examine(case, observation, deadline=time.monotonic() + share))
    from .verdict import conclude

    document = conclude(case, findings)
    document["seconds"] = round(time.monotonic() - begun, 3)
    return Diagnosis(case=case, document=document, findings=findings)
