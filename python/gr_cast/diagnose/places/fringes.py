# SPDX-License-Identifier: GPL-3.0-or-later
"""At which height a ground that the mesh leaves out would draw the fringes that are left in received power."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...core.units import db_from_power
from ...scenario.create.fields import surface_of
from ...scenario.create.geometry import Solid
from ...scenario.create.media import Medium
from ...twin.places.predict import Predictor
from ...twin.places.world import Mesh, World
from . import scan
from .ears import evenly
from .power import PowerEar

_WELLS, _FINER = 40, 5  # heights that are tried in the place, and at how many around each they are looked at more finely
_PERMITTIVITIES = (3.0, 8.0, 20.0)
_WIDE_M, _DEEP_M = 3000.0, 1e3
_LEAST_M, _NEAR_M, _FAR_M = 0.05, 12.0, 100.0  # below the lowest node, looked at finely down to the second, coarsely beyond
_AROUND_ZERO_M = 0.5  # where meshes have their ground
_MOST = 1600  # heights on each fine grid,
_AT_ONCE = 200  # of them in memory
_DEEP = 24
_READINGS, _TONES = 480, 8  # of a campaign that are looked at
_TURN = 0.12  # of a fringe, from one height to the next
_FAINT = 1e-30


def grounds(ears, world: World, lowest_m: float) -> list[tuple[float, float]]:
    """(height, permittivity), best first: paths that are there stay, each link gets one more from a plane under all nodes."""
    own = [_thinned(ear) for ear in ears if not ear.has_responses]
    tried = _tried_m(own, world, lowest_m)
    found = []
    for permittivity in _PERMITTIVITIES:  # of another, echoes may turn round, and no well of this one be there
        wells = scan.minima(tried, _energies(own, world, tried, permittivity), _WELLS)
        step_m = np.interp(wells, tried, np.gradient(tried))
        near = np.add.outer(wells, np.zeros(_FINER)) + np.outer(step_m, np.linspace(-1, 1, _FINER))
        energies = _energies(own, world, near.ravel(), permittivity).reshape(near.shape)
        best = np.argmin(energies, axis=1)
        found += [(energies[row, place], near[row, place], permittivity) for row, place in enumerate(best)]
    return [(float(height_m), permittivity) for _, height_m, permittivity in sorted(found)]


def _tried_m(ears, world: World, lowest_m: float) -> np.ndarray:
    """As densely as the steepest paths need, below the lowest node and where meshes have their ground."""
    top_m = lowest_m - _LEAST_M
    deep = lowest_m - np.geomspace(_NEAR_M, _FAR_M, _DEEP)
    ranges_m = (top_m, lowest_m - _NEAR_M), (min(top_m, _AROUND_ZERO_M), -_AROUND_ZERO_M)
    fine = [height_m for range_m in ranges_m for height_m in down(ears, world, *range_m, _MOST)]
    return np.unique(np.concatenate([fine, deep]))


def down(ears, world: World, height_m: float, end_m: float, most: int) -> Iterator[float]:
    """At most so many heights from one down to another, as densely as the steepest paths' phases need."""
    ends = [ear.predictor.ends_m(world, index) for ear in ears for index in range(len(ear.predictor.links))]
    tx_m, rx_m = (np.concatenate(side) for side in zip(*ends, strict=True))
    level_m = np.linalg.norm((tx_m - rx_m)[:, :2], axis=1)
    for _ in range(most):
        if height_m <= end_m:
            return
        yield height_m
        up_m = tx_m[:, 2] + rx_m[:, 2] - 2 * height_m
        height_m -= _TURN * world.wavelength_m / (2 * float(np.quantile(up_m / np.hypot(up_m, level_m), 0.9)))


def _thinned(ear: PowerEar) -> PowerEar:
    own = ear.predictor
    t = evenly(len(own.time_s), max(_READINGS // len(own.links), 2))
    k = evenly(len(own.frequency_hz), _TONES)
    tracked = {name: at_m[t] for name, at_m in own.tracked.items()}
    predictor = Predictor(*zip(*own.links, strict=True), own.time_s[t], own.frequency_hz[k], tracked)
    return replace(ear, predictor=predictor, power_db=ear.power_db[:, t], weight=ear.weight[:, t])


def _energies(ears, world: World, tried_m: np.ndarray, permittivity: float) -> np.ndarray:
    total = np.zeros(len(tried_m))
    for ear in ears:
        here, expected = ear.predictor.response(world), ear.predicted(world)
        power = np.maximum((np.abs(here) ** 2).mean(axis=2), _FAINT)
        for begin in range(0, len(tried_m), _AT_ONCE):
            more = reflected(ear.predictor, world, tried_m[begin : begin + _AT_ONCE], permittivity)
            for number in range(more.shape[1]):
                change = (np.abs(here + more[:, number]) ** 2).mean(axis=2) / power
                mean_db = expected.mean_db + db_from_power(np.maximum(change, _FAINT))
                total[begin + number] += ear.profiled(replace(expected, mean_db=mean_db)).energy
    return total


def reflected(own: Predictor, world: World, heights_m: np.ndarray, permittivity: float) -> np.ndarray:
    """(L, heights, T, K) over a ground at each height and nothing else: the nodes are lifted instead, one after another."""
    medium = Medium(own_permittivity=permittivity, own_conductivity_s_per_m=0.01, thickness_m=_DEEP_M)
    corners_m = _WIDE_M * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    ground = Solid(name="ground", vertices_m=corners_m, faces=[[0, 1, 2], [0, 2, 3]], medium=medium)
    many, instants = len(heights_m), len(own.time_s)
    lift_m = np.repeat(heights_m, instants)[:, None] * [0.0, 0.0, 1.0]
    lifted = {}
    for index, link in enumerate(own.links):
        for name, at_m in zip(link, own.ends_m(world, index), strict=True):
            lifted[name] = np.tile(at_m, (many, 1)) - lift_m
    predictor = Predictor(*zip(*own.links, strict=True), np.tile(own.time_s, many), own.frequency_hz, lifted)
    radios = {name: replace(radio, offset_m=(0.0, 0.0, 0.0)) for name, radio in world.radios.items()}
    above_m = np.concatenate([*lifted.values()])
    alone = replace(
        world, mesh=Mesh.of((ground,), above_m[:1]), media={"ground": medium}, surface=surface_of([medium], world.carrier_hz),
        radios=radios, diffraction=False, person=None, frozen=None,
    )  # fmt: skip
    both, direct = (predictor.response(replace(alone, max_depth=depth)) for depth in (1, 0))
    return (both - direct).reshape(len(own.links), many, instants, -1)
