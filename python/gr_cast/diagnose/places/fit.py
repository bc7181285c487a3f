# SPDX-License-Identifier: GPL-3.0-or-later
"""Joint fit of effects to all soundings: Levenberg-Marquardt over their numbers, what is unknown profiled out."""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ...twin.places.families.base import Effect
from ...twin.places.world import World, frozen
from . import bending, diffuse, policy
from .ears import PowerEar, ResponseEar
from .likelihood import Fitted

_RIDGE = 1e-10  # of a unit row
_DAMPING = 1e-3  # of the first step, times the diagonal
_WORTH = 0.05  # nats: less than this is no step forward
_LEAST_POWER = 1e-300
_WORLDS_KEPT = 200
_worlds: OrderedDict = OrderedDict()  # by what was applied to which base; with what the key has by its number in memory


Ear = ResponseEar | PowerEar


@dataclass(frozen=True, eq=False, kw_only=True)
class Model:
    """A twin with effects, fitted. `energy` is −ln p, `whitened` what noise keeps at its count but for `slack`: scattered fields
    may be off their law. `tempered`: −ln p where each response may have more noise than it is known to have: what a model leaves
    of causes that it lacks is no reason for or against those that it has. Random fields are such noise, and are not given it
    twice. `loose`: nats that edges gain by bending more or less than the theory has it, and the same tempered; both 0 where
    none is heard."""

    base: World
    effects: tuple[Effect, ...]
    energy: float
    whitened: float
    slack: float
    loose: tuple[float, float]
    tempered: float
    fits: tuple[Fitted, ...]

    @property
    def offset(self) -> float:
        return sum(fit.offset for fit in self.fits)

    @property
    def world(self) -> World:
        return applied(self.base, self.effects)

    def left_nats(self, count: float) -> float:
        """Above what noise has in `count` numbers."""
        return self.whitened - self.offset - count

    def deviations(self, count: float) -> float:
        """`left_nats` in standard deviations of what noise has."""
        return float(self.left_nats(count) / (np.sqrt(max(count, 1.0)) + self.slack))


def applied(base: World, effects: Sequence[Effect]) -> World:
    """The world with effects, in their families' order: what changes the mesh or its nodes goes before what reads them."""
    return _applied(base, sorted(effects, key=lambda e: e.family.order))


def _applied(base: World, effects: Sequence[Effect]) -> World:
    """The same world again where nothing changed: what was traced in it is remembered by its mesh."""
    if not effects:
        return base
    key = id(base), *((one.family, one.owner, one.values.tobytes(), id(one.choice)) for one in effects)
    if key not in _worlds:
        _worlds[key] = base, effects, effects[-1].family.apply(_applied(base, effects[:-1]), effects[-1])
    _worlds.move_to_end(key)
    while len(_worlds) > _WORLDS_KEPT:
        _worlds.popitem(last=False)
    return _worlds[key][-1]


def heard_in(ears: Sequence[Ear], world: World) -> tuple[list[Fitted], list[tuple[Fitted, Fitted]]]:
    """Fits of each sounding by a world whose edges bend as the theory has it, and those where they may bend otherwise."""
    theory = [ear.profiled(ear.predicted(world)) for ear in ears]
    return theory, [bending.loosened(ear, fit, world) for ear, fit in zip(ears, theory, strict=True)]


def evaluated(ears: Sequence[Ear], base: World, effects: Sequence[Effect]) -> Model:
    world = applied(base, effects)
    theory, bent = heard_in(ears, world)
    fits, apart = (tuple(pair[part] for pair in bent) for part in (0, 1))
    plain = sum(fit.energy for fit in fits)
    spared = _tempered(ears, apart)
    is_bent = any(one is not other for one, other in zip(theory, apart, strict=True))
    loose = sum(fit.energy for fit in theory) - plain, _tempered(ears, theory) - spared if is_bent else 0.0
    scattered = [diffuse.gain(ear, fit, world) for ear, fit in zip(ears, fits, strict=True)]
    nats, saved, count = (sum(one[part] for one in scattered) for part in range(3))
    slack = min(policy.DIFFUSE_SHARE * saved, policy.DIFFUSE_NUMBERS * count)
    noisier = not any(effect.family.is_flexible for effect in effects)
    more = plain - spared if noisier else 0.0
    return Model(
        base=base, effects=tuple(effects), energy=plain - nats, whitened=plain - saved, slack=slack, loose=loose,
        tempered=plain - nats - more, fits=fits,
    )  # fmt: skip


def _tempered(ears: Sequence[Ear], fits: Sequence[Fitted]) -> float:
    """−ln p of fits without what is scattered, where each response may have more noise."""
    return sum(fit.energy - ear.tempered_nats(fit) for ear, fit in zip(ears, fits, strict=True))


def _split(effects: Sequence[Effect], vector: np.ndarray) -> tuple[Effect, ...]:
    """The effects with other numbers: the same again where these are."""
    out, at = [], 0
    for effect in effects:
        own = vector[at : at + len(effect.values)]
        out.append(effect if (own == effect.values).all() else effect.moved(own))
        at += len(effect.values)
    return tuple(out)


def _vector(effects: Sequence[Effect]) -> np.ndarray:
    return np.concatenate([effect.values for effect in effects]) if effects else np.zeros(0)


def normal_equations(ears: Sequence[Ear], model: Model, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(A, b) of the free numbers of all effects, what is unknown eliminated: a step is A⁻¹b, the covariance A⁻¹/2."""
    values = _vector(model.effects)
    steps = np.concatenate([effect.family.steps(model.base, effect) for effect in model.effects])
    here = model.world
    top, side = np.zeros((len(free), len(free))), np.zeros(len(free))
    shifted = []
    for number in free:
        moved = values.copy()
        moved[number] += steps[number]
        shifted.append(frozen(applied(model.base, _split(model.effects, moved)), here))
    for ear, fit in zip(ears, model.fits, strict=True):
        base = ear.predicted(frozen(here, here))
        columns = []
        for number, world in zip(free, shifted, strict=True):
            columns.append(ear.columns(fit, base, ear.predicted(world), steps[number]))
        others = ear.nuisance(fit)
        bent = bending.edges(ear, fit, here)
        residual = bending.whitened(bent, ear.rows(fit)[None], left=True)
        residual = diffuse.whitened(ear, fit, here, residual)[0]
        j, others = (
            diffuse.whitened(ear, fit, here, bending.whitened(bent, np.array(rows))) if len(rows) else np.array(rows)
            for rows in (columns, others)
        )
        if len(others):
            rows = _apart(others, np.vstack([residual, j]))
            residual, j = rows[0], rows[1:]
        top += j @ j.T
        side += j @ residual
    return top, side


def _apart(others: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """What of the rows the others do not span, a little ridge aside: gains per node may not all be told apart."""
    scale = np.linalg.norm(others, axis=1, keepdims=True)
    others = others / np.where(scale > 0, scale, 1)
    gram = others @ others.T
    gram[np.diag_indices(len(gram))] += _RIDGE * len(gram)
    return rows - cho_solve(cho_factor(gram), others @ rows.T).T @ others


def fitted(ears: Sequence[Ear], model: Model, *, rounds: int = 8, free: Sequence[int] | None = None) -> Model:
    """The model at its least energy near where it is; `free`: which effects may move (default: all)."""
    which = range(len(model.effects)) if free is None else free
    index, at = [], 0
    for number, effect in enumerate(model.effects):
        if number in which:
            index += range(at, at + len(effect.values))
        at += len(effect.values)
    index = np.array(index, int)
    if not len(index):
        return model
    damping = _DAMPING
    for _ in range(rounds):
        a, b = normal_equations(ears, model, index)
        before = model
        for _ in range(4):
            scale = np.diag(a) + _LEAST_POWER
            try:
                step = np.linalg.solve(a + np.diag(damping * scale), b)
            except np.linalg.LinAlgError:
                return model
            values = _vector(model.effects)
            values[index] += step
            trial = evaluated(ears, model.base, _split(model.effects, values))
            if trial.energy < model.energy:
                model, damping = trial, damping / 5
                break
            damping = max(damping * 20, 1e-3)
        if before.energy - model.energy < _WORTH:
            break
    return model


def deviations(ears: Sequence[Ear], model: Model) -> list[np.ndarray]:
    """Covariance of every effect's own numbers, from the curvature of the energy with all others free."""
    values = _vector(model.effects)
    if not len(values):
        return [np.zeros((0, 0)) for _ in model.effects]
    a, _ = normal_equations(ears, model, np.arange(len(values)))
    scale = 1 / np.sqrt(np.diag(a) + _LEAST_POWER)
    covariance = 0.5 * np.linalg.pinv(a * scale[:, None] * scale, rcond=1e-10) * scale[:, None] * scale
    out, at = [], 0
    for effect in model.effects:
        part = slice(at, at + len(effect.values))
        out.append(covariance[part, part])
        at = part.stop
    return out


def shows_in(part: Sequence[Ear], ears: Sequence[Ear], model: Model) -> bool:
    """Whether what a model leaves of soundings shows in a part of them just as well."""
    count, some = (sum(ear.count for ear in these) for these in (ears, part))
    return model.left_nats(count) * some / max(count, 1) >= policy.SCREENED_NATS


def with_effect(ears: Sequence[Ear], model: Model, effect: Effect) -> Model:
    return evaluated(ears, model.base, (*model.effects, effect))


def without_effects(ears: Sequence[Ear], model: Model, numbers: Sequence[int]) -> Model:
    return evaluated(ears, model.base, tuple(e for i, e in enumerate(model.effects) if i not in numbers))


def replaced(ears: Sequence[Ear], model: Model, number: int, effect: Effect) -> Model:
    effects = list(model.effects)
    effects[number] = effect
    return evaluated(ears, model.base, tuple(effects))
