# SPDX-License-Identifier: GPL-3.0-or-later
"""A model of one recording: delay, gain and phase that are always fitted, and effects; its prediction and
derivatives."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np

from .chain import Chain
from .columns import Courses, Dense, Lags
from .effects import CHANNEL_AFTER, FAMILIES, Effect, Role, plays, stage_of
from .effects.base import ENVIRONMENT, INVERSION

RIDGE = 0.1  # precision of taps and coefficients of which nothing is known: they are not far above 1
STEP = 1e-5  # of a finite difference; every internal parameter is scaled to be of order 1


@dataclass(frozen=True, kw_only=True)
class Model:
    """`base`: delay in samples, Re and Im of the gain, then Re and Im of the gain of every free port."""

    base: np.ndarray
    effects: tuple[Effect, ...] = ()

    def adding(self, effect: Effect) -> "Model":
        """The model with one more effect; of one that it has, with another like it."""
        if any(e.key == effect.key for e in self.effects):
            effect = effect.another()
        model = self._facing_round() if stage_of(effect) == INVERSION else self
        return replace(model, effects=tuple(sorted((*model.effects, effect), key=stage_of)))

    def without(self, index: int) -> "Model":
        model = self._facing_round() if stage_of(self.effects[index]) == INVERSION else self
        return replace(model, effects=model.effects[:index] + model.effects[index + 1 :])

    def _facing_round(self) -> "Model":
        """The model as it is behind an inversion more or less: gains and all that turns are told of what came in."""
        base = self.base.copy()
        base[2::2] *= -1
        return replace(self, base=base, effects=tuple(FAMILIES[e.family].mirrored(e) for e in self.effects))

    def replacing(self, index: int, effect: Effect) -> "Model":
        """The model with another effect of the same stage in the place of one."""
        return replace(self, effects=(*self.effects[:index], effect, *self.effects[index + 1 :]))

    @property
    def inverted(self) -> bool:
        return self.index_of(Role.ORIENTATION) is not None

    def index_of(self, role: Role, *, found: bool = False) -> int | None:
        """The number of the first effect that plays a part, of those that were `found` alone; None without one."""
        return next((i for i, e in enumerate(self.effects) if plays(e, role) and not (found and e.fixed)), None)

    @property
    def found(self) -> list[Effect]:
        return [e for e in self.effects if not e.fixed]

    @property
    def flexible(self) -> bool:
        """Whether a family is in it that fits much, or a row of taps."""
        return any(FAMILIES[e.family].flexible or FAMILIES[e.family].linear for e in self.found)

    @property
    def families(self) -> tuple[str, ...]:
        return tuple(sorted(e.family + str(e.aux.get("side", "")) for e in self.found))

    @property
    def signature(self) -> tuple:
        """What makes two models the same but for their numbers: families, what they act on, what is free."""
        told = []
        for e in self.effects:
            aux = sorted((k, str(v)) for k, v in e.aux.items() if not k.startswith("_"))
            told.append((e.family, str(aux), str(e.free), round(_place(e))))
        return tuple(sorted(told))

    def vector(self) -> np.ndarray:
        """Every free number: the base, then the free parameters of each effect in order."""
        return np.concatenate([self.base, *(e.p[e.free] for e in self.effects)])

    def at(self, vector: np.ndarray) -> "Model":
        base, at, effects = vector[: len(self.base)], len(self.base), []
        for e in self.effects:
            count = int(e.free.sum())
            if count:
                p = e.p.copy()
                p[e.free] = vector[at : at + count]
                e = e.moved(p)
                at += count
            effects.append(e)
        return replace(self, base=base, effects=tuple(effects))

    def span(self, index: int) -> slice:
        """Where the free parameters of effect `index` stand in `vector`."""
        start = len(self.base) + sum(int(e.free.sum()) for e in self.effects[:index])
        return slice(start, start + int(self.effects[index].free.sum()))

    def prior_precision(self) -> np.ndarray:
        parts = [np.zeros(len(self.base))]
        for e in self.effects:
            plain = RIDGE if FAMILIES[e.family].linear else 0.0
            parts.append(np.full(int(e.free.sum()), plain) if e.prior is None else 1.0 / np.maximum(e.prior[e.free], 1e-30))
        return np.concatenate(parts)


def _place(effect: Effect) -> float:
    """Where a free effect stands among several of its kind: the number that is searched for."""
    family = FAMILIES[effect.family]
    return 0.0 if family.place is None else float(effect.p[family.place]) / family.place_step


def _ports(scene, base) -> dict[int, complex]:
    return {i: complex(base[3 + 2 * k], base[4 + 2 * k]) for k, i in enumerate(scene.free_ports)}


def _start_chain(scene, base) -> Chain:
    return Chain(
        scene=scene,
        delay=base[0],
        ports=_ports(scene, base),
        u=scene.u,
        waves=[s.samples for s in scene.sources],
        paths=list(scene.taps),
    )


def _run(scene, base, effects, chain: Chain, first: int, snapshots=None) -> Chain:
    """The steps from number `first` on: effects up to the channel, the channel, its surroundings, the gain,
    the receiver."""
    steps = _steps(effects)
    for k in range(first, len(steps)):
        if snapshots is not None:
            snapshots.append(chain.copy())
        step = steps[k]
        if step == "channel":
            chain.run_channel()
        elif step == "gain":
            chain.y = chain.y * complex(base[1], base[2])
            chain.wanted = chain.wanted * complex(base[1], base[2])
            if chain.noise is not None:
                chain.y = chain.y + chain.noise(chain)
        else:
            FAMILIES[effects[step].family].apply(chain, effects[step])
    if chain.silent is not None:
        chain.y, chain.wanted = (np.where(chain.silent, 0.0, part) for part in (chain.y, chain.wanted))
    return chain


def _steps(effects) -> list:
    before = [i for i, e in enumerate(effects) if stage_of(e) <= CHANNEL_AFTER]
    around = [i for i, e in enumerate(effects) if CHANNEL_AFTER < stage_of(e) <= ENVIRONMENT]
    after = [i for i, e in enumerate(effects) if stage_of(e) > ENVIRONMENT and not FAMILIES[e.family].noise_like]
    return [*before, "channel", *around, "gain", *after]


def predict(scene, model: Model, noise=None) -> Chain:
    """The chain at its end: `y` (count,) is the predicted recording, `wanted` its part from the wanted
    transmitters; `noise(chain)` (count,) comes in front of the receiver."""
    chain = _start_chain(scene, model.base)
    chain.noise = noise
    return _run(scene, model.base, model.effects, chain, 0)


def traced(scene, model: Model) -> tuple[Chain, list[Chain]]:
    """`predict`, and the chain in front of each of its steps and behind the last."""
    before: list[Chain] = []
    chain = _run(scene, model.base, model.effects, _start_chain(scene, model.base), 0, before)
    return chain, [*before, chain]


def added(scene, model: Model, before: list[Chain], effect: Effect) -> tuple[Chain, Callable[[], Dense | Lags | Courses]]:
    """(the prediction with one more effect, its derivatives by the numbers of that); `before`: what `traced` has of the model
    without."""
    more = model.adding(effect)
    index = next(i for i, e in enumerate(more.effects) if e is effect)
    step = _steps(more.effects).index(index)
    if stage_of(effect) == INVERSION:  # all others face the other way
        before = traced(scene, more)[1]
    chain = _run(scene, more.base, more.effects, before[step].copy(), step)
    return chain, lambda: effect_columns(scene, more, index, chain, before[step])


def jacobian(scene, model: Model) -> tuple[Chain, list]:
    """The prediction and its derivatives by the vector of the model, one set for the base and one per effect."""
    chain, before = traced(scene, model)
    return chain, derivatives(scene, model, before)


def derivatives(scene, model: Model, before: list[Chain], of: Collection[int] | None = None) -> list:
    """Those of `jacobian`, or of the base and the effects numbered in `of` alone; `before` as `traced` has it."""
    chain, steps = before[-1], _steps(model.effects)
    blocks = [Dense(signals=np.array([_difference(scene, model, steps, before, k) for k in range(len(model.base))]))]
    for i, effect in enumerate(model.effects):
        if effect.free.any() and (of is None or i in of):
            blocks.append(effect_columns(scene, model, i, chain, before[steps.index(i)]))
    return blocks


def _difference(scene, model, steps, before, base_index: int) -> np.ndarray:
    """The derivative by one number of the base: the gain comes behind the channel, all others come in with it."""
    base, of_gain = model.base.copy(), base_index in (1, 2)
    step = STEP * (max(abs(complex(base[1], base[2])), 1e-12) if of_gain else 1.0)
    base[base_index] += step
    first = steps.index("gain" if of_gain else "channel")
    chain = before[first].copy()
    chain.delay, chain.ports = base[0], _ports(scene, base)
    return (_run(scene, base, model.effects, chain, first).y - before[-1].y) / step


def effect_columns(scene, model: Model, index: int, chain: Chain, before: Chain):
    """Derivatives of the prediction by the free parameters of one effect; `before` is the chain in front of
    its step."""
    effect = model.effects[index]
    family = FAMILIES[effect.family]
    columns = family.columns(scene, effect, chain, before, lambda c, e, extra=None: _rest(scene, model, index, c, e, extra))
    if columns is not None:
        return columns
    rows = []
    for k in np.flatnonzero(effect.free):
        p = effect.p.copy()
        p[k] += STEP
        rows.append((_rest(scene, model, index, before.copy(), effect.moved(p)).y - chain.y) / STEP)
    return Dense(signals=np.array(rows))


def _rest(scene, model, index, chain, effect, extra=None) -> Chain:
    """Run the chain from the step of effect `index` on, with `effect` in its place; `extra` (source, wave)
    is then sent too."""
    effects = list(model.effects)
    effects[index] = effect
    first = _steps(effects).index(index)
    if extra is not None:
        FAMILIES[effect.family].apply(chain, effect)
        chain.waves[extra[0]] = chain.waves[extra[0]] + extra[1]
        first += 1
    return _run(scene, model.base, tuple(effects), chain, first)
