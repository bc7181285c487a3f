# SPDX-License-Identifier: GPL-3.0-or-later
"""At which height a ground that the mesh leaves out would send the echoes that responses lack."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...twin.places.predict import Predictor
from ...twin.places.world import World
from . import fringes, scan
from .ears import ResponseEar, evenly
from .likelihood import Fitted, tempered

_PERMITTIVITIES = 2.5 * 1.4 ** np.arange(9)  # of near ones, echoes about Brewster's angle are turned round
_LEAST_M, _DOWN_M, _MOST = 0.05, 12.0, 6500  # below the lowest node; heights that are tried, at 28 GHz to 6 m
_WELLS = 20  # of each permittivity
_LINKS, _ROWS, _TONES = 12, 24, 12  # that are looked at: links, their instants together where any moves, tones of each response
_AT_ONCE = 200  # heights in memory
_STEPS, _STRIDE = 2, 0.3  # towards the delay of each link, of so much of the resolution at most
_MOVES_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class _Told:
    """Responses of few instants and tones, all (L, T, K): what was `heard` as a fit turns it, times `weight`, 1 over noise; what
    paths give that are `here`; by how much the fit weakens these (`size`)."""

    predictor: Predictor
    here: np.ndarray
    heard: np.ndarray
    weight: np.ndarray
    size: np.ndarray
    unknown: tuple[str, str, str]  # phase, delay, gain

    @classmethod
    def of(cls, ear: ResponseEar, fit: Fitted, world: World) -> "_Told":
        own, heard, which = ear.predictor, ear.heard, evenly(len(ear.heard.links), _LINKS)
        k = slice(None, None, -(-len(own.frequency_hz) // _TONES))  # in equal steps, as phasors go on
        factor, size = fit.factor[which][:, :, k], np.abs(fit.factor[which][:, :, k])
        turned = heard.weighted[which][:, :, k] * np.where(size > 0, factor, 1).conj() / np.where(size > 0, size, 1)
        here, weight = own.response(world)[which][:, :, k], heard.weight[which][:, :, k]
        ends_m = [end_m for index in which for end_m in own.ends_m(world, index)]
        if world.person is not None or any(np.ptp(end_m, axis=0).max() > _MOVES_M for end_m in ends_m):
            told = np.flatnonzero(weight.any(axis=(0, 2)))
            t = told[evenly(len(told), max(2, _ROWS // len(which)))]
            here, turned, weight, size = (one[:, t] for one in (here, turned, weight, size))
        else:
            t = np.zeros(1, int)
            here, turned, weight = here[:, :1], turned.sum(axis=1, keepdims=True), weight.sum(axis=1, keepdims=True)
            size = size.mean(axis=1, keepdims=True)
        links = [own.links[index] for index in which]
        return cls(
            predictor=Predictor(*zip(*links, strict=True), own.time_s[t], own.frequency_hz[k]),
            here=here, heard=turned, weight=weight, size=size, unknown=(heard.phase, heard.delay, heard.gain),
        )  # fmt: skip

    def energies(self, world: World, heights_m: np.ndarray, permittivity: float) -> np.ndarray:
        """(2, heights): tempered, for other causes may spoil some of the links, and as it is."""
        phase, delay, gain = self.unknown
        more = fringes.reflected(self.predictor, world, heights_m, permittivity)
        model = (self.here[:, None] + more) * self.size[:, None]
        power = ((model.real**2 + model.imag**2) * self.weight[:, None]).sum(axis=3)
        cross = model.conj() * self.heard[:, None]
        known = self.weight > 0
        whole = np.abs(self.heard) ** 2 / np.where(known, self.weight, 1)
        total, count = whole.sum(axis=2), known.sum(axis=2)
        if phase == "link":  # instants are as one
            power, cross = power.sum(axis=2, keepdims=True), cross.sum(axis=2, keepdims=True)
            total, count = total.sum(axis=1, keepdims=True), count.sum(axis=1, keepdims=True)
        if delay != "none" and cross.shape[3] > 1:
            cross = _nearer(cross, 2 * np.pi * self.predictor.frequency_hz, phase != "none")
        sums = cross.sum(axis=3)
        along = sums.real if phase == "none" else np.abs(sums)
        if gain != "none":
            axes = (0, 2) if gain == "common" else (2,)
            power_of, along_of = (one.sum(axis=axes, keepdims=True) for one in (power, along))
            scale = np.maximum(along_of, 0) / np.maximum(power_of, 1e-300)
            power, along = scale**2 * power, scale * along
        over = total[:, None] + power - 2 * along
        return np.stack([one.sum(axis=(0, 2)) for one in (tempered(over, count[:, None]), over)])


def _nearer(cross: np.ndarray, omega: np.ndarray, is_free: bool) -> np.ndarray:
    """Products (L, heights, T, K) of model and sounding, turned by the delay of each link that suits: Newton steps from none.
    The bend is that of their size where their phase `is_free`."""
    powers, most_s = np.stack([np.ones_like(omega), omega, omega**2], axis=1), 2 * np.pi * _STRIDE / max(np.ptp(omega), 1e-300)
    for _ in range(_STEPS):
        none, one, two = np.moveaxis(cross @ powers, -1, 0)
        size = np.maximum(np.abs(none), 1e-300)
        turn = none.conj() / size if is_free else 1.0
        slope, bend = (turn * one).imag, (turn * two).real - ((turn * one).real ** 2 / size if is_free else 0.0)
        slope, bend = slope.sum(axis=2), bend.sum(axis=2)
        step_s = np.where(bend > 0, np.clip(slope / np.where(bend > 0, bend, 1), -most_s, most_s), 0.0)
        cross = cross * np.exp(-1j * step_s[:, :, None, None] * omega)
    return cross


def by_echoes(ears: Sequence, fits: Sequence[Fitted], world: World, lowest_m: float) -> list[tuple[float, float]]:
    """(height, permittivity) of level planes under all nodes: paths that are there stay, and each link gets one more. Some
    thousand heights are cheap where nothing else is traced."""
    told = [_Told.of(ear, fit, world) for ear, fit in zip(ears, fits, strict=True) if ear.has_responses]
    tried_m = np.array(list(fringes.down(ears, world, lowest_m - _LEAST_M, lowest_m - _DOWN_M, _MOST)))
    parts = np.array_split(tried_m, 1 + len(tried_m) // _AT_ONCE)
    # Where nodes carry bodies, these turn with the nodes' ways, of which few instants tell.
    bare = replace(world, radios={name: replace(radio, body=None) for name, radio in world.radios.items()})
    found = []
    for permittivity in _PERMITTIVITIES.tolist():
        energies = np.concatenate([sum(one.energies(bare, part, permittivity) for one in told) for part in parts], axis=1)
        found += [(height_m, permittivity) for height_m in scan.minima(tried_m, energies, _WELLS)]
    return found
