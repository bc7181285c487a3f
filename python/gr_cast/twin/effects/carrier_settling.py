# SPDX-License-Identifier: GPL-3.0-or-later
"""An oscillator that settles: its frequency relaxes to where it stays, as a crystal does that warms up. Internal: A in rad and
ln τ, of a phase A·exp(−u/τ) without its mean and slope over the recording, u its share; what is left of it is a carrier offset.

No family of the contract, so never a cause in a diagnosis: found, it is told as what is left. A random phase has no such law.
"""

import numpy as np
from scipy import fft as sp_fft

from ..basis import course_length
from .base import start
from .phase_law import PhaseLaw
from .phase_noise import PhaseNoise

TIME_CONSTANTS = np.geomspace(0.02, 1.0, 25)  # shares of a recording; what takes longer is a drift
POINTS = 2048  # of a course
CARRIER = (lambda u: 2 * np.pi * (u - 0.5), lambda u: np.pi * (u - 0.5) ** 2)  # of a cycle of offset, of drift
HEARD = 0.1  # of what is known of such a course, which the recording must tell and not the prior
RARE = 1e3  # to one: another is as likely before anything is heard


def relaxation(u, log_tau: float):
    """exp(−u/τ) less its mean and slope over 0 ≤ u ≤ 1."""
    tau = np.exp(np.clip(log_tau, -10.0, 10.0))
    end = np.exp(-1 / tau)
    mean = tau * (1 - end)
    slope = 12 * (tau**2 * (1 - end) - tau * end - mean / 2)
    return np.exp(-np.maximum(u, -tau) / tau) - mean - slope * (u - 0.5)


def _cosines(course, scene, orders: int) -> np.ndarray:
    """(orders,) coefficients of a course of the share of the recording, on the basis of random phases."""
    v = (np.arange(POINTS) + 0.5) / POINTS  # n/L
    values = course(v * course_length(scene.span) / scene.span)
    return sp_fft.dct(values)[1 : orders + 1] / (np.sqrt(2) * POINTS)


class CarrierSettling(PhaseLaw):
    name = "carrier_settling"

    def _phase(self, p, u):
        return p[0] * relaxation(u, p[1])

    def starts(self, view):
        shapes = [relaxation(view.phase_cells.middle, log_tau) for log_tau in np.log(TIME_CONSTANTS)]
        if (k := view.phase_law(shapes)) is not None:
            yield start(self, [0.0, np.log(TIME_CONSTANTS[k])], trials=RARE * len(shapes))

    def instead_of(self, scene, effect, covariance):
        """The law that a random phase follows most, besides a frequency and a drift, which are others'."""
        if effect.family != PhaseNoise.name:
            return
        # Information of the recording, whatever the carrier is, and of the prior.
        own = np.linalg.pinv(covariance, hermitian=True)
        heard, slope, told = own - np.diag(1 / effect.prior), own @ effect.p, []
        for log_tau in np.log(TIME_CONSTANTS):
            row = _cosines(lambda u, at=log_tau: relaxation(u, at), scene, len(effect.p))
            if row @ heard @ row > HEARD * (row @ own @ row):
                size = (row @ slope) / (row @ heard @ row)
                told.append((size * (row @ slope), size, log_tau, effect.p - size * row))
        if not told:
            return
        _, size, log_tau, rest = max(told, key=lambda one: one[0])
        carrier = np.array([_cosines(course, scene, len(effect.p)) for course in CARRIER])
        yield start(self, [size, log_tau], trials=RARE * len(TIME_CONSTANTS)), np.linalg.lstsq(carrier.T, rest, rcond=None)[0]

    def values(self, scene, effect, p):
        tau_s = np.exp(p[1]) * scene.duration_s
        return {"offset_hz": -p[0] / (2 * np.pi * tau_s), "time_constant_s": tau_s}

    def plausible(self, effect):
        return TIME_CONSTANTS[0] / 2 < np.exp(effect.p[1]) < 2 * TIME_CONSTANTS[-1]

    def describe(self, number):
        return (
            f"The oscillator settles: off by {number('offset_hz')} at first, with a time constant of {number('time_constant_s')}."
        )
