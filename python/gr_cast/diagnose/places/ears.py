# SPDX-License-Identifier: GPL-3.0-or-later
"""Soundings as the engine hears them: what a world would give, and how well that explains what was measured."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...twin.places.predict import Predictor
from ...twin.places.soundings import Sounding
from ...twin.places.world import World
from . import policy
from .likelihood import Fitted, Heard, profiled, tangents, tempered, without_phases
from .power import PowerEar

_MOST_READINGS = 2400  # of powers in a campaign that are heard: a search in seconds
_BURST = 40  # instants in a row
_NOTHING_DB, _ABOVE = -250.0, 5.0  # what no path leaves of the power; errors of the meter over where it is blind
_REFITTED = 4  # times
_POWER_STEPS = 64  # of the band whose mean power a meter reads (the contract)


@dataclass(frozen=True, eq=False)
class ResponseEar:
    """Complex responses; `field_of`: the world whose scattered field is heard whatever else is asked, None for that one's own."""

    predictor: Predictor
    heard: Heard
    field_of: World | None = field(default=None, kw_only=True)

    has_responses = True

    @property
    def count(self) -> int:
        return self.heard.count

    @property
    def root(self) -> np.ndarray:
        return self.heard.root

    def predicted(self, world: World) -> np.ndarray:
        return self.predictor.response(world)

    def profiled(self, predicted: np.ndarray) -> Fitted:
        return profiled(self.heard, predicted)

    def row_nats(self, fit: Fitted) -> np.ndarray:
        """(L, T) energy of each response."""
        return ((fit.residual.real**2 + fit.residual.imag**2) * self.heard.weight).sum(axis=2)

    def nats(self, fit: Fitted) -> np.ndarray:
        """(L,) energy of each link."""
        return self.row_nats(fit).sum(axis=1)

    left = nats

    def undisturbed(self, fit: Fitted) -> np.ndarray:
        """(L, T) weights of responses where all that is left of each is taken for noise."""
        return np.minimum(1.0, self.heard.counts / np.maximum(self.row_nats(fit), 1e-300))

    def tempered_nats(self, fit: Fitted) -> float:
        """By which `tempered` is less than the energy of all responses."""
        energy = self.row_nats(fit)
        return float((energy - tempered(energy, self.heard.counts)).sum())

    def rows(self, fit: Fitted) -> np.ndarray:
        return _real(fit.residual * self.root)

    def columns(self, fit: Fitted, here: np.ndarray, moved: np.ndarray, step: float) -> np.ndarray:
        return _real(without_phases(self.heard, fit.model, (moved - here) / step * fit.factor) * self.root)

    def nuisance(self, fit: Fitted) -> list[np.ndarray]:
        return [*map(_real, without_phases(self.heard, fit.model, tangents(self.heard, fit.model)) * self.root)]


def _real(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values.real.ravel(), values.imag.ravel()])


def ear(sounding: Sounding, unknown: dict[str, str], bandwidth_hz: float):
    """The ear of one campaign."""
    if sounding.kind == "response":
        known = np.isfinite(sounding.response)
        heard = Heard(
            links=tuple(zip(sounding.tx, sounding.rx, strict=True)),
            y=np.where(known, sounding.response, 0).astype(complex),
            weight=known / sounding.noise_power[:, None, None],
            frequency_hz=sounding.frequency_hz,
            **unknown,
        )
        return ResponseEar(Predictor(sounding.tx, sounding.rx, sounding.time_s, sounding.frequency_hz), heard)
    grid_hz = bandwidth_hz * ((np.arange(_POWER_STEPS) + 0.5) / _POWER_STEPS - 0.5)
    chosen = bursts(len(sounding.time_s), max(_MOST_READINGS // len(sounding.tx), _BURST))
    power_db = sounding.power_db[:, chosen]
    known = np.isfinite(power_db)
    tracked = {name: at_m[chosen] for name, at_m in sounding.position_m.items()}
    return PowerEar(
        Predictor(sounding.tx, sounding.rx, sounding.time_s[chosen], grid_hz, tracked),
        np.where(known, power_db, 0)[:, :, None],
        (known / (2 * sounding.std_db[:, None] ** 2))[:, :, None],
        None if sounding.limits_db is None else tuple(sounding.limits_db),
        unknown["gain"],
    )


def told_of(one, world: World):
    """The sounding without powers that the twin has no path for at all: no number of decibels leads there. And how many these
    are, of all."""
    if one.has_responses:
        return one, 0, 0
    nothing = one.predicted(world).mean_db < _NOTHING_DB
    heard = one.weight[:, :, 0] > 0
    above = np.inf if one.limits_db is None else (one.power_db[:, :, 0] - one.limits_db[0]) * one.root[:, :, 0] * np.sqrt(2)
    lost = heard & nothing & (above > _ABOVE)
    return replace(one, weight=np.where(lost[:, :, None], 0.0, one.weight)), int(lost.sum()), int(heard.sum())


def bursts(instants: int, most: int) -> np.ndarray:
    """Which instants of a long campaign are heard: evenly spread runs of neighbours, which show how fading is correlated."""
    if instants <= most:
        return np.arange(instants)
    begin = np.linspace(0, instants - _BURST, most // _BURST).astype(int)
    return np.unique(begin[:, None] + np.arange(_BURST))


@functools.lru_cache(maxsize=64)
def thinned(one, instants: int, frequencies: int):
    """The same sounding with fewer instants and frequencies, for what is only to be ranked. The same again for the same ear: what
    was traced for it is remembered by its predictor."""
    if not one.has_responses:  # few numbers, and their order in time says something
        return one
    t = evenly(len(one.predictor.time_s), instants)
    tx, rx = zip(*one.predictor.links, strict=True)
    k = slice(None, None, max(1, -(-len(one.predictor.frequency_hz) // frequencies)))
    predictor = Predictor(tx, rx, one.predictor.time_s[t], one.predictor.frequency_hz[k])
    heard = replace(
        one.heard, y=one.heard.y[:, t][:, :, k], weight=one.heard.weight[:, t][:, :, k], frequency_hz=predictor.frequency_hz
    )  # fmt: skip
    return ResponseEar(predictor, heard)


def holding(ears: Sequence, world: World) -> list:
    """The same soundings, what is scattered as a world has it: for candidates that are to be ranked by what they reflect."""
    return [replace(one, field_of=world) if one.has_responses and world.surface.scatters else one for one in ears]


def thinned_as_fitted(ears: Sequence, fits: Sequence, times: int = 1) -> list:
    """Soundings on which first guesses are ranked, without the delays of links that fits found: fewer frequencies could not tell
    long ones from others. Of so many `times` as many instants and frequencies as are told of a family."""
    return [_without_delays(one, fit, times) for one, fit in zip(ears, fits, strict=True)]


def _without_delays(one, fit: Fitted, times: int):
    thin = thinned(one, times * policy.THIN_INSTANTS, times * policy.THIN_FREQUENCIES)
    if not one.has_responses or one.heard.delay == "none":
        return thin
    turn = (fit.factor[:, :, 1:] * fit.factor[:, :, :-1].conj()).sum(axis=(1, 2))
    delay_s = -np.angle(turn) / (2 * np.pi * one.heard.spacing_hz)
    y = thin.heard.y * np.exp(2j * np.pi * delay_s[:, None] * thin.heard.frequency_hz)[:, None]
    return replace(thin, heard=replace(thin.heard, y=y))


def undisturbed_fit(ear: ResponseEar, world: World) -> Fitted:
    """What is unknown fitted to the responses that are as they should be, more than to those that someone spoils."""
    heard, predicted = ear.heard, ear.predicted(world)
    fit = ear.profiled(predicted)
    for _ in range(_REFITTED):
        fit = profiled(replace(heard, weight=heard.weight * ear.undisturbed(fit)[:, :, None]), predicted)
    return fit


@functools.lru_cache(maxsize=8)
def of_links(one: ResponseEar, indices: tuple[int, ...]) -> ResponseEar:
    """Some links of a sounding."""
    heard, links, own = one.heard, tuple(one.predictor.links[index] for index in indices), list(indices)
    predictor = Predictor(*zip(*links, strict=True), one.predictor.time_s, one.predictor.frequency_hz)
    return replace(one, predictor=predictor, heard=replace(heard, links=links, y=heard.y[own], weight=heard.weight[own]))


def alone(one):
    """The same sounding, each link with a gain, a phase and, where one is unknown, a delay of its own."""
    if not one.has_responses:
        return one
    own = {"gain": "link", "delay": one.heard.delay if one.heard.delay == "none" else "link"}
    return replace(one, heard=replace(one.heard, **own, phase="link" if one.heard.phase == "none" else one.heard.phase))


def without_phase(one):
    """The same sounding, its phases not believed."""
    return replace(one, heard=replace(one.heard, phase="snapshot")) if one.has_responses else one


def evenly(count: int, wanted: int) -> np.ndarray:
    """At most so many of `count` indices, from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(count, wanted)).round().astype(int))
