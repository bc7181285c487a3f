# SPDX-License-Identifier: GPL-3.0-or-later
"""What a recording says of a phase over time, in cells: slope and curvature of ln L by the phase of each."""

from dataclasses import dataclass

import numpy as np

from .policy import LEAST_RAMP


@dataclass(frozen=True, kw_only=True)
class PhaseCells:
    """Cells between `knots` (cells + 1,), shares of the recording; the first `known` of phase, frequency and its drift are fitted
    by others."""

    knots: np.ndarray
    slope: np.ndarray
    curve: np.ndarray
    known: int

    @property
    def middle(self) -> np.ndarray:
        return (self.knots[1:] + self.knots[:-1]) / 2

    def explained(self, courses: np.ndarray) -> tuple[np.ndarray, float]:
        """Nats of courses (k, cells) of a phase, each alone, and the nats of any course; besides what is known."""
        slope, energy = self.slope, self.curve
        whole = (courses**2) @ energy
        total = 0.5 * float(np.sum(slope**2 / np.maximum(energy, 1e-300)))
        for known in self._known():
            power = max(known @ (known * energy), 1e-300)
            total -= 0.5 * (known @ slope) ** 2 / power
            slope = slope - energy * known * (known @ slope) / power
            courses = courses - np.outer(courses @ (known * energy) / power, known)
        own, along = (courses**2) @ energy, courses @ slope
        heard = own > LEAST_RAMP * whole
        return np.where(heard, 0.5 * along**2 / np.maximum(own, 1e-300), 0.0), total

    def _known(self) -> list[np.ndarray]:
        """Phase, frequency and drift, as far as they are known, each without those before it."""
        rows = []
        for degree in range(self.known):
            row = (self.middle - 0.5) ** degree
            for other in rows:
                row = row - other * (other @ (self.curve * row)) / max(other @ (self.curve * other), 1e-300)
            rows.append(row)
        return rows
