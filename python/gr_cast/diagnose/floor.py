# SPDX-License-Identifier: GPL-3.0-or-later
"""The noise against the twin's figure of it: a raised floor, noise that follows the signal, or neither."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft as sp_fft
from scipy.optimize import minimize_scalar

from ..twin.effects import FAMILIES, Effect, Role, plays, stage_of, with_role
from ..twin.effects.base import RX_LO, TX_LO, start
from . import flatness, heldout, noise
from .finding import Finding, Worth
from .fit import Fit, gain_of_receiver, in_band, off_the_rails, rounding_of_grids
from .next_recording import Hypothesis, record_next
from .policy import (
    ALIKE_NATS,
    COURSE_DB,
    DITHERS,
    EVEN_P,
    EVEN_SHARE,
    FAINT,
    FLOOR_LEAST_NATS,
    FORM_SHARE,
    HIDES,
    SHAPED_DB,
    TOLD_DB,
    WANDERS_DB,
)


@dataclass(frozen=True, kw_only=True)
class Heard:
    """What is left of a recording where the rails do not touch it, over the noise that the twin tells: `energy` and the
    `level` of what is received by sample, as many independent samples as `count`, the same of the vault (2, m) `unseen`, and what
    that noise is over the twin's figure (`rounded`) if the figure lacks the rounding of the file, and the dither of a grid.
    `gained`: what a receiver's gain that changes makes of the power of noise, on average, over what it was at first."""

    energy: np.ndarray
    level: np.ndarray
    count: float
    unseen: np.ndarray
    uneven: list
    rounded: float = 1.0
    gained: float = 1.0

    @property
    def ratio(self) -> float:
        return float(self.energy.mean())

    @property
    def nats(self) -> float:
        log = float(np.log(self.ratio))
        return self.count * min(self.ratio - 1 - log, abs(log))


def compare(finding: Finding) -> None:
    """Add to what was found that the noise is another one than the twin's, where nothing else is left of the recording, and what
    is heard either has one level or follows the signal."""
    fit = finding.fit
    heard = None if finding.left else _heard(finding)
    if heard is not None and (tied := _all_follows(finding, heard)):
        finding.fit = tied
        return
    if (
        heard is None
        or heard.nats < 0.5 * np.log(heard.count) + FLOOR_LEAST_NATS
        or abs(10 * np.log10(heard.ratio)) < _doubt_db(fit)
    ):
        return
    told, lead = _raised(heard), np.inf
    if heard.ratio > 1 and fit.model.index_of(Role.FOLLOWING) is None:
        other, lead = _following(fit, heard)
        told = other if lead < -ALIKE_NATS else told
    if plays(told.effect, Role.FLOOR) and _uneven(heard):
        return
    if abs(lead) < ALIKE_NATS:
        finding.ambiguous.append(
            {
                "families": [with_role(role).name for role in (Role.FLOOR, Role.FOLLOWING)],
                "why": "The wanted power hardly changes here: more noise everywhere and noise following "
                f"the signal fit alike ({abs(lead):.1f} nats apart).",
                "record_next": _experiment(fit, heard, other.effect, lead),
            }
        )
    level = fit.sigma2 / (heard.ratio if plays(told.effect, Role.FOLLOWING) else 1.0)
    effect = replace(told.effect, aux={"nats": told.worth.evidence, "_floor": level})
    finding.fit = replace(fit, model=fit.model.adding(effect))
    finding.worths[effect.key] = told.worth
    finding.stds[effect.family] = told.stds


def without_rounding(fit: Fit) -> Fit:
    """The fit with noise that follows the signal told over the floor without what the steps of the file add to it, of which the
    twin's figure may hold some; as it is where next to nothing else would be left."""
    at = fit.model.index_of(Role.FOLLOWING, found=True)
    if at is None:
        return fit
    own, rounding = fit.model.effects[at], fit.data.rounding
    floor = own.aux["_floor"]
    alone = max(floor - rounding, min(fit.data.noise_power or 0.0, floor))
    if HIDES * rounding > alone:
        return fit
    aux = {**own.aux, "_floor": alone}
    if "_std" in aux:  # the power of so many samples is known so well, and what is left of it the worse
        aux["_std"] = [float(np.hypot(aux["_std"][0], (floor / alone - 1) / np.sqrt(fit.data.count)))]
    return replace(fit, model=fit.model.replacing(at, replace(own, p=own.p + np.log(floor / alone), aux=aux)))


def _all_follows(finding: Finding, heard: Heard) -> Fit | None:
    """The fit with all noise beyond the twin's own following the signal, where that is nearly as likely as what follows over
    another floor: of noise far above the floor next to nothing tells how high the floor is."""
    fit, at = finding.fit, finding.fit.model.index_of(Role.FOLLOWING, found=True)
    if at is None:
        return None
    own = fit.model.effects[at]
    strength = heard.ratio * (1 + np.exp(own.p[0])) - 1
    if strength <= 0:
        return None
    tied = replace(own, p=np.log([strength]))
    used = fit.data.use > 0

    def shape(effect) -> np.ndarray:
        return FAMILIES[effect.family].variance(fit.data.scene, effect, fit.chain.wanted)[used]

    power = np.abs(fit.data.whitened(fit.residual)[used]) ** 2 * shape(own) / fit.sigma2  # evened by all other laws

    def cost(effect, floor: float) -> float:
        v = floor * shape(effect)
        return float((np.log(v) + power / v).sum())

    behind = cost(tied, 1 / heard.ratio) - cost(own, 1.0)
    if behind > max(ALIKE_NATS, FORM_SHARE * finding.gain_of(at)):
        return None
    # As well as the level of so many samples is known, and worse by what the form misses.
    std = (1 + strength) / strength / np.sqrt(heard.count) * np.sqrt(max(1.0, 2 * behind))
    aux = {**own.aux, "_floor": own.aux["_floor"] / heard.ratio, "_std": [float(std)]}
    return replace(fit, model=fit.model.replacing(at, replace(tied, aux=aux)))


@dataclass(frozen=True, kw_only=True)
class Told:
    effect: Effect
    worth: Worth
    stds: dict[str, float]


def _raised(heard: Heard) -> Told:
    """One other level everywhere, over the figure as it is told: noise by sample, of which nobody knows how much
    is rounding and dither, nor whether it is meant before or behind a gain that changes."""
    ratio, change = heard.ratio, heard.ratio * heard.rounded
    doubt = np.hypot((heard.rounded - 1) / change / np.sqrt(12), np.log(heard.gained) / np.sqrt(3))
    return Told(
        effect=start(with_role(Role.FLOOR), [10 * np.log10(change)], free=[False]),
        worth=Worth(evidence=heard.nats, held_out=heldout.of_variance(heard.unseen[0], np.full(heard.unseen.shape[1], ratio))),
        stds={"change_db": 10 / np.log(10) * float(np.hypot(1 / np.sqrt(heard.count), doubt))},
    )


def _following(fit: Fit, heard: Heard) -> tuple[Told, float]:
    """(noise that follows the signal over the twin's floor, nats by which one other level is likelier)."""
    mean = max(float(np.mean(heard.level**2)), 1e-300)
    strength, likelihood = _strength(heard.energy, heard.level**2 / mean)
    lead = -heard.count * (np.log(heard.ratio) + 1 + likelihood / len(heard.energy))
    unseen, level = heard.unseen
    variance = 1 + np.exp(strength) * level**2 / mean
    told = Told(
        effect=start(with_role(Role.FOLLOWING), [strength], free=[False]),
        worth=Worth(evidence=heard.nats - lead, held_out=heldout.of_variance(unseen, variance)),
        stds={"slope_db": 10 / np.log(10) / np.sqrt(heard.count) * heard.ratio / (heard.ratio - 1)},
    )
    return told, float(lead)


def _strength(energy: np.ndarray, power: np.ndarray) -> tuple[float, float]:
    """(ln strength, ln L) of noise 1 + k·power, `energy` and `power` relative to a floor that is known and
    to their mean."""

    def cost(k):
        v = 1 + np.exp(k) * power
        return float(np.log(v).sum() + (energy / v).sum())

    best = minimize_scalar(cost, bounds=(-9, 7), method="bounded", options={"xatol": 1e-3})
    return float(best.x), -float(best.fun)


def _experiment(fit: Fit, heard: Heard, following: Effect, lead: float) -> str:
    """What tells one other level from noise that follows the signal."""
    raised = Hypothesis.of(fit)
    told = replace(raised, model=fit.model.adding(following), floor=raised.floor / heard.ratio)
    return record_next([raised, replace(told, likelihood=raised.likelihood - lead)])


def _uneven(heard: Heard) -> bool:
    """Whether what is heard is no floor: more in one time, band or level than in another."""
    return any(u.p_value < EVEN_P and u.nats > EVEN_SHARE * heard.nats for u in heard.uneven)


def _heard(finding: Finding) -> Heard | None:
    """None where the floor cannot be told: the twin says none, or a filter, whose own gain is unknown, or a coarse quantiser or
    rails are between it and the recording."""
    fit, told = finding.fit, finding.data.noise_power
    if told is None or fit.model.index_of(Role.FILTER) is not None:
        return None
    rounding = rounding_of_grids(fit)
    if rounding > HIDES * told:
        return None
    # The noise of the recording is told, on average, but for what the twin's own gain makes of it.
    gain = gain_of_receiver(fit, replace(fit.model, effects=tuple(fit.model.found)))
    gained = 1.0 if gain is None else float(gain.mean())
    told = told / gained + rounding
    inside, data = off_the_rails(fit), fit.data
    if not inside.any():
        return None
    shape = np.ones(data.scene.count) if data.variance is None else data.variance
    power = np.abs(data.even(fit.residual, (data.use > 0) | data.vault)) ** 2 / shape
    # The dither of a grid, none or of one step or two; the rounding of the file itself, which the twin's figure may hold or not.
    more = float(np.mean(power[inside])) - told
    dither = rounding * min(DITHERS, key=lambda times: abs(more - times * rounding))
    rounded = 1 + (dither + float(np.clip(more - dither, 0.0, data.rounding))) / told
    told *= rounded
    energy, count, level = power / told, float(inside.sum()), np.abs(fit.chain.wanted)
    if wanders := _wanders(fit):  # what it leaves over is across the signal
        inside = inside & (level**2 > FAINT * np.mean(level[inside] ** 2))
        along = (fit.residual * np.conj(fit.chain.wanted)).real / np.maximum(level, 1e-300)
        energy, count = 2 * along**2 / shape / told, inside.sum() / 2
        uneven = flatness.along(energy[inside], level[inside])
    else:
        uneven = flatness.over_all(fit, inside)
    if data.spectrum is not None and not wanders and not any(FAMILIES[e.family].noise_like for e in fit.model.effects):
        # of noise that a filter coloured, what is told is the floor where the signal is
        energy = energy * (_beside_signal(fit) / told / energy[inside].mean())
        count *= float(np.mean(data.scene.occupied))
    aside = off_the_rails(fit, data.vault)
    unseen = np.stack([power[aside] / told, level[aside]])
    return Heard(
        energy=energy[inside], level=level[inside], count=count, unseen=unseen, uneven=uneven, rounded=rounded, gained=gained
    )


def _wanders(fit: Fit) -> list[Effect]:
    """Found random courses of the phase of all that is received."""
    one = len(fit.data.scene.sources) == 1
    return [e for e in fit.model.found if e.prior is not None and (stage_of(e) == RX_LO or one and stage_of(e) == TX_LO)]


def _doubt_db(fit: Fit) -> float:
    """By how much the level of noise may seem another one for other reasons than its own."""
    # A gain that changes has no level of its own: how far it moves from 1 is how well the floor is known.
    moved, doubt_db = gain_of_receiver(fit, fit.model), TOLD_DB
    if moved is not None:
        doubt_db += 10 * np.log10(max(moved.max(), 1.0) / min(moved.min(), 1.0))
    if any(FAMILIES[e.family].noise_like for e in fit.model.effects):
        doubt_db += SHAPED_DB * max(len(noise.laws(fit.model)), 1) ** 2  # each shapes what others leave
    wanders = _wanders(fit)
    for e in fit.model.effects:
        doubt_db += FAMILIES[e.family].noise_gain_db(e)
        if e.prior is not None and FAMILIES[e.family].flexible:
            doubt_db += WANDERS_DB if any(e is wander for wander in wanders) else COURSE_DB
        if jitter := e.aux.get("_jitter"):  # its square is along the signal, and a course as random
            doubt_db += 10 * np.log10(
                1 + jitter**2 * np.mean(np.abs(fit.chain.wanted) ** 2) / (fit.data.noise_power or fit.sigma2)
            )
    return float(doubt_db)


def _beside_signal(fit: Fit) -> float:
    """Power per sample of the residual, if it were everywhere as dense as in the signal's band."""
    used = fit.data.use > 0
    power = np.abs(sp_fft.fft(fit.residual * used)) ** 2
    return float(np.mean(power[in_band(fit, len(power))]) / used.sum())
