# SPDX-License-Identifier: GPL-3.0-or-later
"""Which instant of the scenario a stack heard when it measured: it runs slower than the wall clock, which its metrics keep."""

import numpy as np

from . import stack
from .stack import METRICS_S, Member


class Clock:
    """The wall's time and the scenario's side by side, as often as they are looked at; and when the times of each terminal's
    metrics began, by the line that was seen the soonest after its own time."""

    def __init__(self, terminals: list[Member]):
        self._metrics = {member.node: member.metrics for member in terminals}
        self._wall_s: list[float] = []
        self._scenario_s: list[float] = []
        self._began_s: dict[str, float] = {}

    def look(self, wall_s: float, scenario_s: float) -> None:
        self._wall_s.append(wall_s)
        self._scenario_s.append(scenario_s)
        for node, path in self._metrics.items():
            time_s = stack.last_time_s(path)
            if time_s is not None:
                self._began_s[node] = min(self._began_s.get(node, np.inf), wall_s - time_s)

    def scenario_s(self, node: str, time_s: np.ndarray) -> np.ndarray:
        """The scenario's time in the middle of the periods that ended at the times `time_s` of a terminal's metrics, (n,); NaN
        where no line of its was seen."""
        if node not in self._began_s:
            return np.full(len(time_s), np.nan)
        middle_s = self._began_s[node] + np.asarray(time_s) - METRICS_S / 2
        return np.interp(middle_s, self._wall_s, self._scenario_s)
