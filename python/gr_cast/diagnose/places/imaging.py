# SPDX-License-Identifier: GPL-3.0-or-later
"""What the residual shows of things that no path of the twin meets: planes by mirror echoes, something that passes."""

from dataclasses import dataclass, replace

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S
from .ears import ResponseEar
from .likelihood import Fitted

_FINER = 8  # of the grid of delays over the resolution of the band
CHANCE = 2.0  # of a cell: less is noise
_AT_ONCE = 50_000  # rows times planes, which stay near the processor
_STRONGEST = 40.0  # nats that one row may give a place: one strong echo is no plane


@dataclass(frozen=True, kw_only=True)
class Echoes:
    """Residual rows (n): where both ends are, when, and the nats (n, bins) of one more echo at each delay from 0 on."""

    tx_m: np.ndarray
    rx_m: np.ndarray
    time_s: np.ndarray
    link: np.ndarray
    nats: np.ndarray
    bins_per_s: float

    def at(self, which: np.ndarray) -> "Echoes":
        """Those rows alone."""
        rows = {name: getattr(self, name)[which] for name in ("tx_m", "rx_m", "time_s", "link", "nats")}
        return replace(self, **rows)


def echoes(ear: ResponseEar, fit: Fitted, world) -> Echoes:
    """Nats of an echo at a delay: |Σ r·conj(e)|²/Σ|e|² with both weighted by the noise."""
    heard, predictor = ear.heard, ear.predictor
    count = len(heard.frequency_hz)
    size = 1 << int(np.ceil(np.log2(_FINER * count)))
    spacing = heard.frequency_hz[1] - heard.frequency_hz[0]
    gain = np.abs(fit.factor)
    unit = fit.factor / np.maximum(gain, 1e-300)
    profile = np.fft.ifft(fit.residual * unit.conj() * heard.weight, size, axis=2) * size
    nats = np.abs(profile) ** 2 / np.maximum(heard.weight.sum(axis=2, keepdims=True), 1e-300)
    links, instants, _ = nats.shape
    ends = [predictor.ends_m(world, index) for index in range(links)]
    tx_m, rx_m = (np.concatenate([np.broadcast_to(end[side], (instants, 3)) for end in ends]) for side in (0, 1))
    return Echoes(
        tx_m=tx_m, rx_m=rx_m, time_s=np.tile(predictor.time_s, links), link=np.repeat(np.arange(links), instants),
        nats=nats.reshape(links * instants, size), bins_per_s=size * spacing,
    )  # fmt: skip


def looked_up(seen: Echoes, length_m: np.ndarray) -> np.ndarray:
    """Nats (..., n) of echoes of given lengths (..., n), noise taken off."""
    place = np.mod(np.round(length_m / SPEED_OF_LIGHT_M_PER_S * seen.bins_per_s).astype(np.int64), seen.nats.shape[1])
    weight = np.minimum(1, _STRONGEST / np.maximum(seen.nats.max(axis=1), 1e-300))  # clipped, side lobes would be as high
    return np.maximum(seen.nats[np.arange(len(seen.nats)), place] - CHANCE, 0) * weight


def mirrored(seen, normal: np.ndarray, level_m: float):
    """Lengths (n,) over one plane's mirror images, where (n, 3) they meet it, and which (n,) have both ends on one side of it."""
    tx_m, rx_m = seen
    a, b = tx_m @ normal - level_m, rx_m @ normal - level_m
    length_m = np.sqrt(((tx_m - rx_m) ** 2).sum(axis=1) + 4 * np.maximum(a * b, 0))
    return length_m, met_m(tx_m, rx_m, a, b, normal), a * b > 0


def met_m(tx_m: np.ndarray, rx_m: np.ndarray, before_m: np.ndarray, after_m: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Where (..., 3) ways between ends so far before planes meet these, if both ends are on one side."""
    one_side = before_m * after_m > 0
    share = np.where(one_side, before_m / np.where(one_side, before_m + after_m, 1), 0.5)[..., None]
    foot_m = tx_m - before_m[..., None] * normal
    return foot_m + share * (rx_m - after_m[..., None] * normal - foot_m)


def plane_scores(seen: list[Echoes], normal: np.ndarray, level_m: np.ndarray) -> np.ndarray:
    """Nats (P,) of planes normal·x = level: normals (P, 3); both ends must be on one side of a plane."""
    total = np.zeros(len(level_m))
    for one in seen:
        for part in np.array_split(np.arange(len(level_m)), 1 + len(level_m) * len(one.nats) // _AT_ONCE):
            total[part] += _seen(one, normal[part], level_m[part])
    return total


def _seen(one: Echoes, normal: np.ndarray, level_m: np.ndarray) -> np.ndarray:
    both = (one.tx_m @ normal.T - level_m) * (one.rx_m @ normal.T - level_m)  # (n, P)
    apart, on_side = ((one.tx_m - one.rx_m) ** 2).sum(axis=1)[:, None], both > 0
    length_m = np.sqrt(apart + 4 * both * on_side)
    return (looked_up(one, length_m.T) * on_side.T).sum(axis=1)


def passer_maps(seen: list[Echoes], foot_m: np.ndarray, height_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Nats (instants, P) of something at `foot_m` (P, 2), all links of an instant together; and the instants (s)."""
    maps, times = [], []
    for one in seen:
        for time_s in np.unique(one.time_s):
            now = one.at(one.time_s == time_s)
            maps.append(looked_up(now, _over(now, foot_m[:, None], height_m)).sum(axis=1))
            times.append(time_s)
    return np.array(maps), np.array(times)


def _over(one: Echoes, foot_m: np.ndarray, height_m: float) -> np.ndarray:
    """Lengths (..., n) from one end of each row to the other by way of a place (..., n, 2)."""
    length_m = 0.0
    for end in (one.tx_m, one.rx_m):
        length_m = length_m + np.sqrt(((foot_m - end[:, :2]) ** 2).sum(axis=-1) + (end[:, 2] - height_m) ** 2)
    return length_m


def passer_scores(seen: list[Echoes], foot_m: np.ndarray, velocity: np.ndarray, height_m: float) -> np.ndarray:
    """Nats (P, V) of something at `foot_m` (P, 2) at time 0 that goes at `velocity` (V, 2)."""
    return np.stack([sum(_along(one, foot_m, speed, height_m) for one in seen) for speed in velocity], axis=1)


def _along(one: Echoes, foot_m: np.ndarray, velocity: np.ndarray, height_m: float) -> np.ndarray:
    """The same (P,) of one campaign at one velocity."""
    return looked_up(one, _over(one, foot_m[:, None] + one.time_s[:, None] * velocity, height_m)).sum(axis=1)
