# SPDX-License-Identifier: GPL-3.0-or-later
"""Discrete effects, looked for before everything else: the converter's quantiser grid and its rails."""

import numpy as np

from ..signals.recording import DATATYPES
from ..twin.effects import Effect, Role, with_role
from ..twin.effects.base import start


def native_step(datatype: str) -> float:
    """Grid that the file format itself has; 0 for floats."""
    _, _, full_scale = DATATYPES[datatype]
    return 0.0 if datatype == "cf32_le" else 1.0 / full_scale


def quantiser_grid(y: np.ndarray, datatype: str) -> tuple[float, float, float, float] | None:
    """(step, its standard deviation, level of a grid point in steps, nats) where I and Q lie on a grid coarser than the file's:
    so much likelier than on as many of the file's own values as lie between two points of it."""
    values = np.concatenate([y.real, y.imag])
    base = native_step(datatype)
    unit = base if base else max(np.abs(values).max(), 1e-30) * 2**-22
    # cu8 lies on half steps: rounding to even would fold them in pairs
    levels = np.unique(np.floor(values / unit + 0.25).astype(np.int64))
    if not 2 <= len(levels) <= max(64, len(values) // 16):
        return None
    gaps = np.diff(levels)
    gap = np.median(gaps[gaps <= 1.5 * gaps[gaps > 1].min()]) if (gaps > 1).any() else 1
    if gap < 1.6 or gaps.min() < 0.6 * gap:
        return None
    k = np.cumsum(np.concatenate([[0], np.round(gaps / gap)]))
    slope, origin = np.polyfit(k, levels, 1)
    miss = levels - (slope * k + origin)
    if np.abs(miss).max() > 0.6 + 0.02 * slope:
        return None
    std = max(np.sqrt(1 / 12), np.std(miss)) / np.sqrt(np.sum((k - k.mean()) ** 2) + 1e-30)  # of a level that was cut to `unit`
    step = slope * unit
    return step, std * unit, (origin / slope) % 1.0, len(values) * float(np.log(slope))


def rails(y: np.ndarray, datatype: str, step: float) -> tuple[float, float, int, bool] | None:
    """(level, its standard deviation, samples on it, whether at one end alone) where I and Q pile up at ±level."""
    unit = max(native_step(datatype), 1e-7)
    grain = max(step, unit)
    heaps, levels = [], []
    for part in (y.real, -y.real, y.imag, -y.imag):
        top = part.max()
        on = int((part >= top - 0.6 * unit).sum())
        # What a smooth distribution would hold in a cell of this width, judged from the cells just below.
        below = int(((part < top - 0.6 * unit) & (part >= top - 0.6 * unit - 3 * grain)).sum())
        expected = max(below / 3, 0.3)
        heaps.append(on > 4 * expected + 5 if step else on >= 4 and on > 3 * expected + 2)
        levels.append((top, on))
    tops = np.array([t for t, _ in levels])
    lone = sum(heaps) == 1 and not step
    if sum(heaps) < 2 - lone:
        return None
    level = float(np.median(tops[heaps]))
    close = np.abs(tops - level) <= (0.8 * grain if step else 2.1 * unit)
    good = [bool(h and c) for h, c in zip(heaps, close, strict=True)]
    if sum(good) < 2 - lone or (tops > level + (0.8 if step else 1.6) * grain).any():
        return None
    samples = int(sum(on for (_, on), g in zip(levels, good, strict=True) if g))
    level = float(np.mean(tops[good]))
    return level, max(unit * 0.5, 1e-6 * level), samples, lone


def discrete(y: np.ndarray, datatype: str) -> list[tuple[Effect, dict]]:
    """Effects that are read off the samples themselves (aux `read`), with the standard deviations of their
    parameters."""
    found = []
    grid = quantiser_grid(y, datatype)
    step = grid[0] if grid else 0.0
    top = rails(y, datatype, step)
    if top:
        level, std, samples, lone = top
        aux = {"read": 0.0} | ({"lone": True} if lone else {})  # a heap may be the signal's own
        effect = start(with_role(Role.RAILS), [level, 0.0], free=[False] * 2, aux=aux)
        found.append((effect, {"level": std, "samples": samples}))
    if grid:
        effect = start(with_role(Role.QUANTISER), [step, grid[2], 1.0], free=[False] * 3, aux={"read": grid[3]})
        found.append((effect, {"step": grid[1]}))
    return found
