# SPDX-License-Identifier: GPL-3.0-or-later
"""From a case to its diagnosis: every recording on its own, then all of them together."""

import time
from dataclasses import dataclass, field, replace

import numpy as np

from ..effects import FAMILIES, Effect
from ..effects.base import start
from ..effects.signal_dependent_noise import told_floor
from . import align, ambiguity, gate, residual
from .fit import Fit, filters_noise, gain_of_receiver, misfit
from .model import predict
from .search import refit, refit_or_known, search

BUDGET_S = 240.0
SETTLED = {"carrier_frequency_offset", "extra_path"}  # a drift or Doppler of 0 has an error too
LONGEST_PART = 120_000  # samples that are fitted at once
MOST_PARTS = 8
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
    ambiguous: list = field(default_factory=list)
    gains: dict = field(default_factory=dict)  # effect → (evidence, rivals)

    @property
    def fit(self) -> Fit:
        return self.fits[0]

    def gain_of(self, index: int) -> float:
        """Evidence that is lost without an effect."""
        effect = self.fit.model.effects[index]
        if "nats" in effect.aux:
            return float(effect.aux["nats"])
        return self._compared(index)[0]

    def rivals_of(self, index: int) -> list:
        return [] if "nats" in self.fit.model.effects[index].aux else self._compared(index)[1]

    def _compared(self, index: int):
        """What `_compare` found, made now where it was not asked before."""
        effect = self.fit.model.effects[index]
        key = id(effect.p)
        if key not in self.gains:
            model = replace(self.fit.model, effects=tuple(e for e in self.fit.model.effects if "nats" not in e.aux))
            at = next(i for i, e in enumerate(model.effects) if e.p is effect.p)
            without = refit_or_known(self.data, model.without(at), self.fits)
            self.gains[key] = (float(self.fit.evidence - without.evidence), [])
        return self.gains[key]


def nmse(data, y: np.ndarray, inside: np.ndarray) -> float:
    """Residual power on the samples `inside` over recorded power."""
    return float(np.mean(np.abs(data.y[inside] - y[inside]) ** 2) / np.mean(np.abs(data.y[data.use + data.vault > 0]) ** 2))


def parts_of(observation) -> list:
    """A long recording in overlapping parts that are fitted one by one; a short one whole."""
    n = len(observation.samples)
    if n <= LONGEST_PART:
        return [observation]
    count = min(-(-n // LONGEST_PART), MOST_PARTS)
    size = min(n, LONGEST_PART)
    firsts = np.linspace(0, n - size, count).astype(int)
    return [observation.part(int(f), int(f) + size) for f in firsts]


def examine(case, observation, *, deadline: float) -> list[Finding]:
    """Search one recording: its first part in full, every other from what the first one showed."""
    parts, findings = parts_of(observation), []
    for k, part in enumerate(parts):
        if findings and time.monotonic() > deadline:
            break
        until = time.monotonic() + (deadline - time.monotonic()) * (0.6 if k == 0 and len(parts) > 1 else 1 / (len(parts) - k))
        findings.append(_examine_part(case, part, findings[0] if findings else None, until))
    return findings


def _examine_part(case, part, known: Finding | None, deadline: float) -> Finding:
    if known is None:
        scene, data, model = align.build(case, part)
    else:
        scene, data, model = align.build(case, part, near=_expected(known, part))
    plain = replace(model, effects=tuple(e for e in model.effects if e.fixed))
    stds = {}
    for effect, std in gate.discrete(part.samples.astype(complex), part.datatype):
        model = model.adding(effect)
        stds[effect.family] = std
    twin = refit(data, plain)
    model = _under_the_lattice(data, refit(data, model).model)
    scene.rms = float(np.sqrt(np.mean(np.abs(refit(data, model).chain.wanted) ** 2)))
    for effect in known.fit.model.found if known else ():
        if effect.family not in LOCAL and effect.family not in {e.family for e in model.effects}:
            model = model.adding(effect)
    fits = search(data, model, deadline=deadline)
    again = _under_the_lattice(data, fits[0].model)
    if again is not fits[0].model:
        fits[0] = refit(data, again)
    finding = Finding(observation=part, scene=scene, data=data, twin=twin, fits=fits, stds=stds)
    finding.fits[0] = _settle(finding.fit)
    if known is None:
        _compare(finding)
    _floor(finding)
    _look_for_rest(finding)
    return finding


def _under_the_lattice(data, model):
    """The model with the noise in front of a coarse quantiser, in steps, under which its mean output fits
    best."""
    at = next((i for i, e in enumerate(model.effects) if e.family == "quantization"), None)
    if at is None:
        return model
    tries = []
    for sigma in (0.05, 0.07, 0.09, 0.11, 0.13, 0.16, 0.2, 0.25, 0.3, 0.36, 0.45, 0.6, 1.0):
        effect = model.effects[at].moved(np.array([*model.effects[at].p[:2], sigma]))
        other = replace(model, effects=(*model.effects[:at], effect, *model.effects[at + 1 :]))
        tries.append((misfit(data, predict(data.scene, other).y), sigma, other))
    return min(tries, key=lambda t: t[:2])[2]


def _coarse(model) -> bool:
    """Whether a quantiser is so coarse that its error is no noise of its own."""
    return any(e.family == "quantization" and e.p[2] < 0.7 for e in model.effects)


# What belongs to one moment, or is judged anew in every part.
LOCAL = {
    "sample_loss",
    "gain_step",
    "gain_drift",
    "noise_floor",
    "pulsed_interference",
    "adc_clipping",
    "quantization",
}
LOCAL |= {"phase_noise", "tap_fading", "impulsive_noise"}


def _expected(known: Finding, part) -> tuple[int, bool]:
    """Where a later part of the same recording begins in the waveform."""
    clock = next((e.p[0] for e in known.fit.model.effects if e.family == "sample_clock_offset"), 0.0)
    ahead = part.first - known.observation.first
    delay = known.scene.anchor + known.fit.model.base[0] - ahead * (1 + clock / known.scene.count)
    return int(round(delay)), any(e.family == "spectral_inversion" for e in known.fit.model.found)


def _compare(finding: Finding) -> None:
    """Every found effect against its rivals."""
    fit = finding.fit
    for i, effect in enumerate(fit.model.effects):
        if effect.fixed:
            continue
        finding.gains[id(effect.p)] = _, rivals = ambiguity.rivals(fit, i, finding.fits)
        equal = [r for r in rivals if ambiguity.alike(effect, r)]
        if equal:
            families = list(dict.fromkeys([effect.family, *(r.effect.family for r in equal)]))[:3]
            apart = abs(equal[0].likelihood)
            finding.ambiguous.append(
                {
                    "families": families,
                    "why": f"{' and '.join(families)} explain this recording equally well ({apart:.1f} nats apart).",
                    "record_next": ambiguity.record_next(fit, equal[0].fit),
                }
            )


def _settle(fit: Fit) -> Fit:
    """Let every number of what was found move (a drift, a Doppler), and note the floor that noise is told
    against."""
    effects = tuple(
        replace(e, free=np.ones(len(e.p), bool)) if e.family in SETTLED and not e.fixed else e for e in fit.model.effects
    )
    if any(a is not b for a, b in zip(effects, fit.model.effects, strict=True)):
        freed = refit(fit.data, replace(fit.model, effects=effects))
        if freed.likelihood > fit.likelihood - 1.0:
            fit = freed
    covariance = fit.covariance
    effects = []
    for i, e in enumerate(fit.model.effects):
        if FAMILIES[e.family].noise_like:
            e = replace(e, aux={**e.aux, "_floor": fit.sigma2})
        elif e.prior is not None:
            e = replace(e, aux={**e.aux, "_variance": np.diag(covariance)[fit.model.span(i)].tolist()})
        effects.append(e)
    return replace(fit, model=replace(fit.model, effects=tuple(effects)))


def _floor(finding: Finding) -> None:
    """Compare the noise with the twin's, on samples that the rails do not touch."""
    fit, told = finding.fit, finding.data.noise_power
    if told is None or filters_noise(fit.model):  # a filter's own gain is unknown, and with it the floor before it
        return
    inside = off_the_rails(fit)
    shape = np.ones(fit.data.scene.count) if fit.data.variance is None else fit.data.variance
    for e in fit.model.effects:
        if e.family == "quantization":
            if e.p[0] ** 2 / 6 > 0.1 * told:
                return  # the step's own error hides the floor
            told = told + e.p[0] ** 2 / 6
    n = float(inside.sum())
    energy = np.abs(fit.residual[inside]) ** 2 / shape[inside] / told
    ratio = float(energy.mean())
    nats = n * (ratio - 1 - np.log(ratio))
    # A gain that changes has no level of its own: how far it moves is how well the floor is known.
    moved = gain_of_receiver(fit, fit.model)
    doubt_db = 0.05 if moved is None else 0.05 + 10 * np.log10(moved.max() / moved.min())
    follows = any(e.family == "signal_dependent_noise" for e in fit.model.effects)
    if follows:
        doubt_db += 0.3
    for e in fit.model.effects:
        if e.family == "iq_imbalance":  # noise passes the unequal gains too
            doubt_db += abs(FAMILIES[e.family].values(fit.data.scene, e, e.p)["gain_imbalance_db"])
    if any(e.prior is not None and FAMILIES[e.family].flexible for e in fit.model.effects):
        doubt_db += 1.0  # what a random course leaves over is not the floor's
    if nats < 0.5 * np.log(n) + 8 or abs(10 * np.log10(ratio)) < doubt_db:
        return
    floor = start(
        FAMILIES["noise_floor"],
        [10 * np.log10(ratio)],
        free=[False],
        aux={"nats": float(nats), "_floor": fit.sigma2},
    )
    std = {"change_db": 10 / np.log(10) / np.sqrt(n)}
    if ratio > 1 and not follows:
        power = np.abs(fit.chain.wanted[inside]) ** 2
        power = power / max(power.mean(), 1e-300)
        strength, likelihood = told_floor(energy, power)
        lead = float(-n * np.log(ratio) - n) - likelihood  # of a raised floor over noise that follows the signal
        other = start(FAMILIES["signal_dependent_noise"], [strength], free=[False], aux={"nats": float(nats - lead)})
        if abs(lead) < ambiguity.ALIKE_NATS:
            finding.ambiguous.append(
                {
                    "families": ["noise_floor", "signal_dependent_noise"],
                    "why": "The wanted power hardly changes here: more noise everywhere and noise following "
                    f"the signal fit alike ({abs(lead):.1f} nats apart).",
                    "record_next": ambiguity.noise_experiment(1.0, ratio - 1.0),
                }
            )
        elif lead < 0:
            floor, std = other, {"slope_db": 10 / np.log(10) / np.sqrt(n) * ratio / (ratio - 1)}
    finding.fits[0] = replace(fit, model=fit.model.adding(floor))
    finding.stds[floor.family] = std


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
        if _coarse(fit.model) and rest.test in ("amplitude", "place in the code"):
            continue
        if rest.p_value < UNEXPLAINED_P and rest.nats > max(UNEXPLAINED_NATS, UNEXPLAINED_SHARE * explained):
            finding.left.append(rest)


def predict_only(case, observation, findings) -> tuple[float, float, float]:
    """(twin, corrected, noise) NMSE of a recording for the vault: what was found elsewhere, with its own
    delay and gain."""
    part = parts_of(observation)[0]
    like = max(
        findings,
        key=lambda f: (
            f.observation.receiver == part.receiver,
            set(f.observation.on_air) == set(part.on_air),
        ),
    )
    scene, data, model = align.build(case, part)
    data = replace(data, use=data.vault.astype(float))
    twin = refit(data, model)
    ratio = scene.count / like.scene.count
    found = tuple(_rescaled(e, ratio) for e in like.fit.model.found if not FAMILIES[e.family].noise_like)
    for effect in found:
        if effect.family not in {e.family for e in model.effects}:
            model = model.adding(replace(effect, free=np.zeros(len(effect.p), bool)))
    fit = refit(data, model)
    inside = data.vault
    told = data.noise_power or like.fit.sigma2
    return (
        nmse(data, twin.chain.y, inside),
        nmse(data, fit.chain.y, inside),
        told / float(np.mean(np.abs(data.y) ** 2)),
    )


def _rescaled(effect: Effect, ratio: float) -> Effect:
    """An effect on a recording `ratio` times as long: what counts cycles or samples over the recording
    grows with it."""
    power = {
        "carrier_frequency_offset": (1, 2),
        "sample_clock_offset": (1,),
        "extra_path": (0, 0, 0, 1),
        "tap_doppler": (1, 0),
    }
    grow = power.get(effect.family)
    return effect if grow is None else effect.moved(effect.p * ratio ** np.array(grow, float))


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
        if effect.prior is not None:
            std = max(std, LEAST_OF_COURSES.get(name, 0.0) * (1.0 if name.endswith("_db") else abs(value)))
        if not std:
            std = default_std(effect.family, name, value, scene)
        out[name] = {"value": float(value), "std": float(std)}
    return out, family.constants(scene, effect)


INFLATION = 1.1
# What one realisation of a random course leaves open: a share of the number, or dB.
LEAST_OF_COURSES = {
    "rms_rad": 0.1,
    "k_factor_db": 0.6,
    "doppler_spread_hz": 0.2,
    "decay_s": 0.15,
    "power_db": 0.3,
}


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
        findings += examine(case, observation, deadline=time.monotonic() + share)
    from .verdict import conclude

    document = conclude(case, findings, [predict_only(case, o, findings) for o in case.observations if o.vault])
    document["seconds"] = round(time.monotonic() - begun, 3)
    return Diagnosis(case=case, document=document, findings=findings)
