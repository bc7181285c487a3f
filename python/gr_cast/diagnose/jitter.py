# SPDX-License-Identifier: GPL-3.0-or-later
"""A phase that wanders too fast to be followed: noise across the signal, and none along it, as strong as the signal is."""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from ..twin.effects import FAMILIES, Role, is_coarse, stage_of, with_role
from ..twin.effects.base import RX_FILTER, start
from ..twin.effects.noise_family import profile
from . import noise
from .finding import Finding, Worth
from .fit import Fit, off_the_rails
from .policy import (
    ACROSS,
    JITTER_ALONE_NATS,
    JITTER_EVEN,
    JITTER_ORDERS,
    JITTER_STRENGTHS,
    JITTER_STRETCHES,
    JITTER_SURE,
)
from .search import refit


def of_a_wander(fit: Fit) -> Fit:
    """Phase noise with its part that is too fast to be followed; such noise is no other law's, over time or, as it lies in the
    signal's own band, over frequency, nor what a receiver's filter leaves of it."""
    at = fit.model.index_of(Role.WANDER, found=True)
    if at is None:
        return fit
    across, along, power = _directions(fit, fit.data.use > 0)
    jitter = (across.sum() - along.sum()) / power.sum()  # rad²
    if jitter < JITTER_SURE * np.sqrt(np.sum((across + along) ** 2)) / power.sum():
        return fit
    effects = fit.model.effects
    follows = fit.model.index_of(Role.FOLLOWING, found=True)
    if follows is not None:
        shape = (
            FAMILIES[effects[follows].family].variance(fit.data.scene, effects[follows], fit.chain.wanted)[fit.data.use > 0] - 1
        )
        both = profile(np.concatenate([across, along]), np.concatenate([1 + shape, 1 + shape]))
        if profile(np.concatenate([across, along]), np.concatenate([1 + 2 * shape, np.ones_like(shape)])) > both:
            return of_a_wander(refit(fit.data, fit.model.without(follows)))
    for i in (i for i, e in enumerate(effects) if not e.fixed and (FAMILIES[e.family].band(e) or stage_of(e) == RX_FILTER)):
        bare = refit(fit.data, fit.model.without(i))
        across, along, _ = _directions(bare, bare.data.use > 0)
        if across.sum() - along.sum() > ACROSS * (bare.sigma2 - fit.sigma2) * bare.data.count:
            return of_a_wander(bare)
    noisy = effects[at]
    return replace(fit, model=fit.model.replacing(at, replace(noisy, aux={**noisy.aux, "_jitter": float(jitter)})))


def alone(finding: Finding) -> None:
    """Phase noise of which no part can be followed, where noise across the signal explains more than the laws of the noise that
    were found: they know no direction."""
    fit = finding.fit
    if fit.model.index_of(Role.WANDER) is not None or fit.data.late or len(fit.data.scene.sources) > 1:
        return
    laws = noise.laws(fit.model)
    bare = refit(fit.data, replace(fit.model, effects=tuple(e for e in fit.model.effects if e not in laws))) if laws else fit
    inside, unseen = off_the_rails(bare), off_the_rails(bare, bare.data.vault)  # which take from what is along the signal
    if not inside.any() or any(is_coarse(e) for e in bare.model.effects):
        return  # of a coarse quantiser's error nobody knows the direction
    across, along, power = _directions(bare, inside)
    strength, nats = _likeliest(across, along, power)
    lost = max(fit.evidence - bare.evidence, 0.0)
    if nats - lost < JITTER_ALONE_NATS or not _is_throughout(across - along, power):
        return
    floor = float(np.mean(along))
    aux = {"law": "flat", "_jitter": strength * floor, "nats": nats - lost}
    effect = start(with_role(Role.WANDER), np.zeros(JITTER_ORDERS), free=np.zeros(JITTER_ORDERS, bool), aux=aux)
    effect = replace(effect, prior=np.full(JITTER_ORDERS, strength * floor / JITTER_ORDERS))
    finding.refitted(replace(bare, model=bare.model.adding(effect)))
    gone = {law.family for law in laws}
    finding.ambiguous = [entry for entry in finding.ambiguous if not gone & set(entry["families"])]
    held_out = _held_out(*_directions(bare, unseen), strength * floor, floor) if unseen.any() else None
    finding.worths[effect.key] = Worth(evidence=nats - lost, held_out=held_out)


def along(fit: Fit) -> Fit:
    """A fit as a test sees it, where a wander was too fast to be followed: what is across the signal says nothing."""
    at = fit.model.index_of(Role.WANDER, found=True)
    if at is None or "_jitter" not in fit.model.effects[at].aux:
        return fit
    return noise.along(fit)


def _likeliest(across: np.ndarray, along: np.ndarray, power: np.ndarray) -> tuple[float, float]:
    """(strength of noise across the signal over the floor and the signal's power, nats by which that is likelier than noise in
    both directions that is even or follows the signal)."""
    energy, bounds = np.concatenate([across, along]), np.log(np.array(JITTER_STRENGTHS) / np.mean(power))

    def best(shape):
        found = minimize_scalar(lambda k: -profile(energy, shape(np.exp(k))), bounds=bounds, method="bounded")
        return np.exp(found.x), -found.fun / 2  # of real numbers each

    strength, told = best(lambda k: np.concatenate([1 + k * power, np.ones_like(power)]))
    _, follows = best(lambda k: np.tile(1 + k * power, 2))
    return float(strength), float(told - max(follows, profile(energy, np.ones_like(energy)) / 2))


def _is_throughout(excess: np.ndarray, power: np.ndarray) -> bool:
    """Whether every stretch of the recording that has as much of the signal has a fair share of what is across it."""
    at = np.minimum((JITTER_STRETCHES * np.cumsum(power) / power.sum()).astype(int), JITTER_STRETCHES - 1)
    return bool(np.bincount(at, excess, JITTER_STRETCHES).min() > JITTER_EVEN * excess.sum() / JITTER_STRETCHES)


def _held_out(across: np.ndarray, along: np.ndarray, power: np.ndarray, jitter: float, floor: float) -> float:
    """Nats by which samples that were not fitted are likelier with noise across the signal than with as much both ways."""

    def cost(over, beside):
        return np.sum(np.log(over) + across / over + np.log(beside) + along / beside) / 2

    even = np.full_like(power, floor + jitter * np.mean(power) / 2)
    return float(cost(even, even) - cost(floor + jitter * power, np.full_like(power, floor)))


def _directions(fit: Fit, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energies of the residual across and along the wanted signal, and its power; samples `inside` (n,) bool."""
    wanted = fit.chain.wanted[inside]
    turned = fit.residual[inside] * np.conj(wanted)
    power = np.maximum(np.abs(wanted) ** 2, 1e-300)
    return turned.imag**2 / power, turned.real**2 / power, power
