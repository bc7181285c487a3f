# SPDX-License-Identifier: GPL-3.0-or-later
"""Which instant of the scenario a stack heard when it measured: it runs slower than the wall clock, which its metrics keep."""

import numpy as np

from . import stack
from .stack import METRICS_S, SINR_AGE_S, Member

LOOK_S = METRICS_S / 10
_APART_S = METRICS_S / 2  # of looks between which it is known when a line came


class Clock:
    """The scenario's time at which each line of the terminals' metrics came, by looking at the files as often as can be.

    Not by the lines' own times alone: srsUE leaves out of them what it takes to write a line, and so loses tens of ms with each
    on a busy machine.
    """

    def __init__(self, terminals: list[Member]):
        self._metrics = {member.node: member.metrics for member in terminals}
        self._seen: dict[str, set[float]] = {member.node: set() for member in terminals}
        self._came: dict[str, dict[float, float]] = {member.node: {} for member in terminals}
        self._looked = (-np.inf, 0.0)

    def look(self, wall_s: float, scenario_s: float) -> None:
        before_wall_s, before_s = self._looked
        self._looked = (wall_s, scenario_s)
        for node, path in self._metrics.items():
            time_s = stack.last_time_s(path)
            if time_s is not None and time_s not in self._seen[node]:
                self._seen[node].add(time_s)
                if wall_s - before_wall_s <= _APART_S:
                    self._came[node][time_s] = (before_s + scenario_s) / 2

    def scenario_s(self, node: str, time_s: np.ndarray) -> np.ndarray:
        """The scenario's time of what is in the SINR of a terminal's lines of the times `time_s`, (n,); interpolated where a line
        was not seen to come, and NaN before the first that was seen and after the last."""
        came = self._came[node]
        if not came:
            return np.full(len(time_s), np.nan)
        came_s = np.interp(time_s, list(came), list(came.values()), left=np.nan, right=np.nan)
        return np.maximum(came_s - SINR_AGE_S, 0.0)
