# SPDX-License-Identifier: GPL-3.0-or-later
"""Path loss from one node of a SPEC to every point of an area, by mirror images."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.errors import Faults
from ...core.units import db_from_power
from ..band import in_band_power
from . import mirrors, nodes
from .geometry import Solid
from .spec import Spec
from .trace import Settings, Task

USUAL, MOST = 2000, 40_000  # points of a grid


@dataclass(frozen=True, kw_only=True)
class Area:
    """Path loss in the band from a sender at `sender_m` (3,) to isotropic antennas at x_m (X,), y_m (Y,): loss_db (Y, X), NaN
    where nothing is heard."""

    sender: str
    sender_m: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray
    height_m: float
    bandwidth_hz: float
    loss_db: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """From which node, at what time, where (the box of all nodes unless a region x0, y0, x1, y1 is given), at which height, how
    far apart the points are (None: about 2000 of them), and up to how many reflections."""

    sender: str
    time_s: float = 0.0
    region_m: tuple[float, float, float, float] | None = None
    height_m: float = 1.5
    step_m: float | None = None
    max_depth: int = 2

    def grid(self, spec: Spec) -> tuple[np.ndarray, np.ndarray]:
        """x (X,) and y (Y,) in m. CastError names every fault of what is wanted."""
        faults = Faults(spec.id)
        names = [node.name for node in spec.nodes]
        if self.sender not in names:
            faults.add("--from", f"got {self.sender!r}, the place has {', '.join(names)}")
        if not 0 <= self.time_s <= spec.duration_s:
            faults.add("--at", f"got {self.time_s:g} s, needs 0 to {spec.duration_s:g} s")
        if not np.isfinite(self.height_m):
            faults.add("--height", f"got {self.height_m:g} m, needs a finite number")
        if self.max_depth < 0:
            faults.add("--depth", f"got {self.max_depth}, needs 0 or more")
        ways_m = np.concatenate([node.waypoints_m for node in spec.nodes])
        x0, y0, x1, y1 = self.region_m or (*ways_m[:, :2].min(axis=0), *ways_m[:, :2].max(axis=0))
        if not (x0 < x1 and y0 < y1 and np.isfinite([x0, y0, x1, y1]).all()):
            faults.add("--region", f"got {x0:g} {y0:g} {x1:g} {y1:g} m, needs X0 < X1 and Y0 < Y1")
        faults.raise_if_any()
        step_m = np.sqrt((x1 - x0) * (y1 - y0) / USUAL) if self.step_m is None else self.step_m
        if not (step_m > 0 and (x1 - x0) * (y1 - y0) / step_m**2 <= MOST):
            faults.add("--step", f"got {step_m:g} m, needs more than 0 m and at most {MOST} points in the region")
        faults.raise_if_any()
        return tuple(np.linspace(a, b, max(2, round((b - a) / step_m) + 1)) for a, b in ((x0, x1), (y0, y1)))


def losses(spec: Spec, solids: Sequence[Solid], wanted: Wanted, bandwidth_hz: float, progress=lambda done, all_: None) -> Area:
    """The area, row by row."""
    x_m, y_m = wanted.grid(spec)
    node = next(node for node in spec.nodes if node.name == wanted.sender)
    at_m = nodes.position_m(node, np.array([wanted.time_s]))[0]
    settings = Settings(
        carrier_hz=spec.carrier_hz, max_depth=min(wanted.max_depth, spec.max_depth), rays=spec.rays, refraction=spec.refraction
    )
    rows = []
    for k, y in enumerate(y_m):
        points_m = np.column_stack([x_m, np.full(len(x_m), y), np.full(len(x_m), wanted.height_m)])
        rows.append(_row(solids, settings, node, np.vstack([at_m, points_m]), bandwidth_hz))
        progress(k + 1, len(y_m))
    return Area(
        sender=wanted.sender, sender_m=at_m, x_m=x_m, y_m=y_m, height_m=wanted.height_m, bandwidth_hz=bandwidth_hz,
        loss_db=np.array(rows),
    )  # fmt: skip


def _row(solids, settings: Settings, node, position_m: np.ndarray, bandwidth_hz: float) -> np.ndarray:
    """Losses (n,) from the first position to all others."""
    n, still = len(position_m) - 1, np.zeros_like(position_m)
    task = Task(
        name="row", pairs=tuple((0, k + 1) for k in range(n)), antennas=(node.antenna, *["iso"] * n),
        orientation_rad=np.vstack([node.orientation_rad, np.zeros((n, 3))]), position_m=position_m, velocity_before=still,
        velocity_after=still,
    )  # fmt: skip
    traced = mirrors.run(solids, settings, task)
    found = np.full(n, np.nan)
    for k in np.unique(traced.rx):
        own = traced.rx == k
        gain = traced.gain[own] * np.exp(-2j * np.pi * settings.carrier_hz * traced.delay_s[own])
        found[k - 1] = -db_from_power(in_band_power(traced.delay_s[own][None], gain[None], bandwidth_hz)[0])
    return np.where(np.isfinite(found), found, np.nan)
