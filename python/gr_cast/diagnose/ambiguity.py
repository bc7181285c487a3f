# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be told apart: every found effect is swapped for its rivals; where the fit stays alike, the
experiments that
could be recorded next are simulated under both models, and the one that separates them most is named.
"""

import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft as sp_fft

from ..twin.effects import FAMILIES, Effect, Role, with_role
from ..twin.effects.base import start
from ..twin.model import Model, predict
from ..twin.scene import Source
from .fit import Fit
from .search import REFITS, candidates, claim_the_same, plausible, refit_or_known, roughness

ALIKE_NATS = 3.0  # in ln L: two fits that differ by less are alike
ALIKE_TAPS_NATS = 12.0  # in evidence: what the priors of two rows of taps may differ by
NEAR_SHARE = 0.3  # or this share of what the effect brings
NEAR_NATS = 25.0  # predicted evidence within which a rival is worth a fit


@dataclass(frozen=True, kw_only=True)
class Rival:
    """The best other explanation of one effect: evidence behind it, ln L behind it, its fit where one was
    made."""

    effect: Effect
    evidence: float
    likelihood: float
    fit: Fit | None


def rivals(fit: Fit, index: int, known: list[Fit]) -> tuple[Fit, list[Rival]]:
    """(the fit without effect `index`, the rivals of that effect, the nearest first). `known`: fits that the search
    made."""
    effect = fit.model.effects[index]
    bare = refit_or_known(fit.data, fit.model.without(index), known)
    # A search prices what it fitted, a fit of what was found all that has an error.
    told = max((f.evidence for f in known if _what(f.model) == _what(fit.model)), default=fit.evidence)
    lost = max(told, fit.evidence) - bare.evidence
    found = []
    for s in candidates(bare) if not fit.data.late else ():
        family = FAMILIES[s.effect.family]
        if _same(effect, s.effect) or s.net < 0 or family.beyond:
            continue
        far = s.net < lost - max(NEAR_NATS, NEAR_SHARE * lost)  # a score is rough where an effect is strong
        promises = s.net > lost - roughness(lost) or _two_rows(effect, s.effect)
        if far or family.flexible and not promises:
            if not found:
                found.append(Rival(effect=s.effect, evidence=lost - s.net, likelihood=lost - s.net, fit=None))
            continue
        if sum(r.fit is not None and FAMILIES[r.effect.family].flexible == family.flexible for r in found) >= REFITS:
            continue
        if fit.data.late:
            break
        near = bare if family.noise_like else None
        # With all that has an error free, as what was found is.
        settled = replace(s.effect, free=family.settled(fit.data.scene, s.effect))
        other = refit_or_known(fit.data, bare.model.adding(settled), known, near=near)
        if plausible(other.model):
            found.append(
                Rival(
                    effect=s.effect,
                    evidence=bare.evidence + lost - other.evidence,
                    likelihood=fit.likelihood - other.likelihood,
                    fit=other,
                )
            )
    return bare, sorted(found, key=lambda r: r.evidence)


def _what(model: Model) -> list[tuple]:
    """What a model claims, whatever the numbers and whichever of them are free."""
    return sorted((e.family, *(str(e.aux.get(name)) for name in ("tap", "side", "source", "held"))) for e in model.found)


def _same(a: Effect, b: Effect) -> bool:
    return claim_the_same(a, b) or b.family in FAMILIES[a.family].same_as or a.family in FAMILIES[b.family].same_as


def _two_rows(a: Effect, b: Effect) -> bool:
    """Whether two effects are rows of taps of different kinds."""
    return a.family != b.family and FAMILIES[a.family].row_of_taps and FAMILIES[b.family].row_of_taps


def all_alike(effect: Effect, rivals: list[Rival]) -> list[Rival]:
    """The rivals that the data leave open beside an effect, and what the data leave open beside those."""
    open_ones = [r for r in rivals if alike(effect, r)]
    for r in rivals:
        rows = [o for o in open_ones if _two_rows(o.effect, r.effect)]
        if r.fit and not any(r is o for o in open_ones) and any(abs(r.evidence - o.evidence) <= ALIKE_TAPS_NATS for o in rows):
            open_ones.append(r)
    return open_ones


def alike(effect: Effect, rival: Rival) -> bool:
    """Whether the data leave both open: as good a fit with no more freedom, both simple; or, where the rival is flexible,
    evidence that is alike."""
    if rival.fit is None:
        return False
    if _two_rows(effect, rival.effect):
        return rival.evidence <= ALIKE_TAPS_NATS
    if FAMILIES[rival.effect.family].flexible:
        return rival.evidence <= ALIKE_NATS
    if abs(rival.likelihood) > ALIKE_NATS or effect.prior is not None or _holds(rival, effect):
        return False
    return int(rival.effect.free.sum()) <= int(effect.free.sum()) and rival.effect.prior is None


def _holds(rival: Rival, effect: Effect) -> bool:
    """Whether a rival explains the same only by what it has of the effect's own family."""
    less = FAMILIES[rival.effect.family].less(rival.fit.data.scene, rival.effect, rival.fit.model.effects)
    return any(e.family == effect.family for e in less)


def record_next(first: Fit, second: Fit) -> str:
    """The experiment under which the two models differ most (nats per recording of this length)."""
    gains = {name: _separation(first, second, name) for name in EXPERIMENTS}
    best = max(gains.values())
    return next(name for name in EXPERIMENTS if gains[name] >= 0.9 * best)


# In the order in which a user would rather do them.
EXPERIMENTS = (
    "absolute_calibration",
    "mute_transmitter",
    "offset_carrier",
    "second_power",
    "other_code_length",
    "shaped_waveform",
    "complex_waveform",
    "second_link",
    "move_carrier",
)


def _separation(first: Fit, second: Fit, experiment: str) -> float:
    """Nats between the predictions of two models in an experiment; delay and gain stay free unless
    calibrated."""
    if experiment == "absolute_calibration":  # the gain is one number, whichever model is right
        base = np.concatenate([second.model.base[:1], first.model.base[1:3], second.model.base[3:]])
        second = replace(second, model=replace(second.model, base=base))
    a, b = _predicted(first, experiment), _predicted(second, experiment)
    unknown = any(f.model.index_of(Role.FILTER) is not None for f in (first, second))  # a filter's own gain is
    if unknown or experiment not in ("absolute_calibration", "mute_transmitter"):
        a = _free_gain(a, b)
    n = first.data.scene.count
    signal = float(np.sum(np.abs(a.y - b.y) ** 2)) / first.sigma2
    return signal * first.data.count / n


def _free_gain(a, b):
    a = a.copy()
    a.y = a.y * (np.vdot(a.y, b.y) / max(np.vdot(a.y, a.y).real, 1e-300))
    return a


def _predicted(fit: Fit, experiment: str):
    """The chain that a model predicts in an experiment."""
    scene, model = copy.copy(fit.data.scene), fit.model
    scene.forget()
    rng = np.random.default_rng(7)
    if experiment == "mute_transmitter":
        scene.sources = [replace(s, samples=np.zeros_like(s.samples), power=0.0, peak=0.0) for s in scene.sources]
    elif experiment == "offset_carrier":
        model = model.adding(replace(start(with_role(Role.CARRIER), [200.0 * scene.duration_s + 3.3, 0.0]), fixed=True))
    elif experiment == "second_power":
        scene.sources = [replace(s, samples=0.5 * s.samples, power=0.25 * s.power, peak=0.5 * s.peak) for s in scene.sources]
    elif experiment == "other_code_length":
        scene.sources = [
            _with(s, np.resize(s.samples, len(s.samples) // 2 * 2 + 7)) for s in scene.sources if s.repeat
        ] or scene.sources
    elif experiment == "shaped_waveform":
        scene.sources = [_with(s, _shaped(s.samples, rng)) for s in scene.sources]
    elif experiment == "complex_waveform":
        scene.sources = [_with(s, s.samples + 1j * np.roll(s.samples, len(s.samples) // 3)) for s in scene.sources]
    elif experiment in ("second_link", "move_carrier"):
        # The channel is another one; what transmitter, receiver and surroundings do stays.
        scene.taps = [
            replace(t, delay=t.delay + 3.4 * (k + 1), gain=t.gain * np.exp(2j * (k + 1))) for k, t in enumerate(scene.taps)
        ] + [replace(scene.taps[0], delay=scene.taps[0].delay + 7.7, gain=0.6j * scene.taps[0].gain)]
        model = replace(model, effects=tuple(e for e in model.effects if FAMILIES[e.family].level != "link"))
    return predict(scene, model)


def _shaped(samples: np.ndarray, rng) -> np.ndarray:
    """(n,) samples of varying envelope in the band of those given."""
    draw = rng.normal(size=len(samples)) + 1j * rng.normal(size=len(samples))
    return sp_fft.ifft(sp_fft.fft(draw) * np.abs(sp_fft.fft(samples)))


def _with(source: Source, samples: np.ndarray) -> Source:
    """A waveform of the same power with other samples."""
    samples = samples * np.sqrt(source.power / np.mean(np.abs(samples) ** 2))
    return replace(source, samples=samples, known=np.ones(len(samples), bool), peak=float(np.abs(samples).max()))


def noise_experiment(told: float, excess: float) -> str:
    """For a raised floor against noise that follows a constant power: the experiment with the largest
    divergence."""
    floor, scaled = told + excess, {"mute_transmitter": told, "second_power": told + excess / 4}
    divergence = {name: abs(floor / v - 1 - np.log(floor / v)) for name, v in scaled.items()}
    return max(divergence, key=divergence.get)
