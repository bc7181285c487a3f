# SPDX-License-Identifier: GPL-3.0-or-later
"""Soundings as the engine hears them: what a world would give, and how well that explains what was measured."""

from dataclasses import dataclass

import numpy as np

from ...core.units import db_from_power
from ...twin.places.predict import Predictor
from ...twin.places.soundings import Sounding
from ...twin.places.world import World
from .likelihood import Fitted, Heard, incidence, profiled, tangents, without_phases

_POWER_STEPS = 64  # of the band whose mean power a meter reads (the contract)
_FAINT = 1e-30


@dataclass(frozen=True, eq=False)
class ResponseEar:
    """Complex responses."""

    predictor: Predictor
    heard: Heard

    has_responses = True

    @property
    def count(self) -> int:
        return self.heard.count

    @property
    def root(self) -> np.ndarray:
        return np.sqrt(self.heard.weight)

    def predicted(self, world: World) -> np.ndarray:
        return self.predictor.response(world)

    def profiled(self, predicted: np.ndarray) -> Fitted:
        return profiled(self.heard, predicted)

    def column(self, fit: Fitted, change: np.ndarray) -> np.ndarray:
        return without_phases(self.heard, fit.model, change * fit.factor)

    def nuisance(self, fit: Fitted) -> list[np.ndarray]:
        return [without_phases(self.heard, fit.model, column) for column in tangents(self.heard, fit.model)]


@dataclass(frozen=True, eq=False)
class PowerEar:
    """Powers in dB with Gaussian errors; energy Σ(residual²)/(2·std²), so that it counts in nats like the other."""

    predictor: Predictor
    power_db: np.ndarray  # (L, T, 1)
    weight: np.ndarray
    limits_db: tuple[float, float] | None
    gain: str

    has_responses = False

    @property
    def count(self) -> float:
        return float((self.weight > 0).sum()) / 2

    @property
    def root(self) -> np.ndarray:
        return np.sqrt(self.weight)

    def predicted(self, world: World) -> np.ndarray:
        power = (np.abs(self.predictor.response(world)) ** 2).mean(axis=2, keepdims=True)
        return db_from_power(np.maximum(power, _FAINT))

    def profiled(self, predicted: np.ndarray) -> Fitted:
        shift = np.zeros((len(predicted), 1, 1))
        residual = np.where(self.weight > 0, self.power_db - predicted, 0)
        if self.gain == "common":
            shift = shift + (residual * self.weight).sum() / max(self.weight.sum(), _FAINT)
        elif self.gain == "node":
            design, total = incidence(self.predictor.links), self.weight.sum(axis=(1, 2))
            mean = (residual * self.weight).sum(axis=(1, 2)) / np.maximum(total, _FAINT)
            root = np.sqrt(total)
            shift = (design @ np.linalg.lstsq(root[:, None] * design, root * mean, rcond=1e-9)[0])[:, None, None]
        model = predicted + shift
        if self.limits_db is not None:
            model = np.clip(model, min(self.limits_db), max(self.limits_db))
        residual = np.where(self.weight > 0, self.power_db - model, 0)
        return Fitted(model=model, residual=residual, energy=float((residual**2 * self.weight).sum()), factor=np.ones_like(model))

    def column(self, fit: Fitted, change: np.ndarray) -> np.ndarray:
        return change

    def nuisance(self, fit: Fitted) -> list[np.ndarray]:
        if self.gain == "common":
            return [np.ones_like(fit.model)]
        if self.gain == "node":
            return [
                np.broadcast_to(row[:, None, None], fit.model.shape).astype(float) for row in incidence(self.predictor.links).T
            ]
        return []


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
    known = np.isfinite(sounding.power_db)
    return PowerEar(
        Predictor(sounding.tx, sounding.rx, sounding.time_s, grid_hz),
        np.where(known, sounding.power_db, 0)[:, :, None],
        (known / (2 * sounding.std_db[:, None] ** 2))[:, :, None],
        None if sounding.limits_db is None else tuple(sounding.limits_db),
        unknown["gain"],
    )


def half(ear_, first: bool):
    """One of two interleaved halves of the instants of an ear: what one half finds, the other must confirm."""
    chosen = (np.arange(len(ear_.predictor.time_s)) % 2 == 0) == first
    from dataclasses import replace

    if ear_.has_responses:
        return replace(ear_, heard=replace(ear_.heard, weight=ear_.heard.weight * chosen[None, :, None]))
    return replace(ear_, weight=ear_.weight * chosen[None, :, None])
