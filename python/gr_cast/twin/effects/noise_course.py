# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise that is not as loud all the time: some stretches, each of one level. Internal: ln of each stretch's power over the
quietest one's, then the samples at which the levels change.

No family of the contract, so never a cause in a diagnosis: found, it is told as what is left. It keeps a stretch in which
something else happens (a receiver that settles, another station) from speaking for causes that hold throughout.

The stretches are those of the highest likelihood of all that cells of time can be joined to (Jackson et al., "An algorithm for
optimal partitioning of data on an interval", IEEE SPL 2005).
"""

import numpy as np

from .base import start
from .noise_family import NoiseFamily

CELLS = 128  # of time
LEAST_CELL = 24  # samples in a cell: levels of fewer are chance
MOST = 6  # stretches: what needs more comes and goes
LOUDER = 0.1  # nepers of power over the quietest stretch from which one counts as louder


class NoiseCourse(NoiseFamily):
    name = "noise_course"
    owners = ("environment",)
    lasting = False
    beyond = True

    @staticmethod
    def _parts(p):
        """(levels, moments) of the numbers of an effect."""
        return np.split(p, [(len(p) + 1) // 2])

    def hidden(self, effect):
        return len(effect.p) - 1  # the floor is one level's

    def variance(self, scene, effect, wanted):
        levels, moments = self._parts(effect.p)
        return np.exp(levels[np.searchsorted(moments, scene.index, side="right")])

    def in_time(self, scene, effect, later, longer):
        levels, moments = self._parts(effect.p)
        return effect.moved(np.concatenate([levels, moments - later * scene.span]))

    def values(self, scene, effect, p):
        return {"change_db": 10 / np.log(10) * float(np.ptp(self._parts(p)[0]))}

    def where(self, scene, effect, values):
        levels, moments = self._parts(effect.p)
        edges, loud = np.concatenate([[0.0], moments, [scene.span]]), np.flatnonzero(levels > levels.min() + LOUDER)
        first, last = (loud[0], loud[-1] + 1) if len(loud) else (0, len(levels))
        return {"time_s": (edges[[first, last]] / scene.sample_rate_hz).tolist()}

    def describe(self, number):
        return f"What is not explained is louder by {number('change_db')} for a while."

    def find(self, view, near=None):
        at = np.flatnonzero(view.use)
        cells = min(CELLS, len(at) // LEAST_CELL)
        if cells < 2:
            return 0.0, None
        edges = np.arange(cells + 1) * len(at) // cells
        energy = np.concatenate([[0.0], np.cumsum(view.energy[at])])[edges]
        count, price = np.diff(edges), np.log(len(at)) + np.log(cells)
        ways = _partitions(energy, edges)
        gains = [cost - price * k for k, (cost, _) in enumerate(ways)]
        k = int(np.argmax(gains))
        if not k:
            return 0.0, None
        cuts = ways[k][1]
        level = np.log(np.maximum(np.diff(energy[cuts]) / np.diff(edges[cuts]), 1e-300))
        p = np.concatenate([level - level.min(), at[edges[cuts[1:-1]]]])
        spread = [*(1 / np.sqrt(np.diff(edges[cuts]))), *np.full(k, count.mean())]
        return ways[k][0], start(self, p, free=[False] * len(p), trials=float(cells) ** k, aux={"_std": spread})


def _partitions(energy: np.ndarray, edges: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """[(gain in ln L over one level, bounds of the stretches)] of one, two … stretches, with the `energy` up to the `edges` of
    cells (cells + 1,)."""
    e, n = (np.maximum(x[None, :] - x[:, None], 0.0) for x in (energy, edges))
    with np.errstate(divide="ignore", invalid="ignore"):
        alone = np.where(n > 0, -n * np.log(np.maximum(e, 1e-300) / n), -np.inf)  # from one edge to another, one level
    best, back, ways = alone[0].copy(), [], []
    for _ in range(MOST):
        cuts = [len(edges) - 1]
        for origin in reversed(back):
            cuts.append(int(origin[cuts[-1]]))
        ways.append((float(best[-1] - alone[0, -1]), np.array([0, *cuts[::-1]])))
        joined = best[:, None] + alone
        back.append(np.argmax(joined, axis=0))
        best = joined.max(axis=0)
    return ways
