# SPDX-License-Identifier: GPL-3.0-or-later
"""A sample clock that wanders: y(t + w(t)), w on a cosine basis (its mean and its rate left to others). Internal: coefficients in
samples.

No family of the contract, so never a cause in a diagnosis: found, it is told as what is left. A clock whose rate jitters evenly
has coefficients of variance 1/k² (Wiener process), one whose rate wanders freely of 1/k⁴ (integrated once more).
"""

import numpy as np
from scipy import fft as sp_fft

from ..basis import course_orders
from ..columns import Courses
from ..interpolate import TAU, frequencies, moved
from .base import SAMPLER, Family, Multiplicity, start
from .phase_noise import mean_square

LAWS = 2, 4  # powers of the order by which coefficients become rarer
MOST = 24  # cosines
ORDERS = 6  # of the series: -46 dB off at half a sample and half the rate
WIDEST = 0.35  # samples rms that it is good for


class ClockWander(Family):
    name = "clock_wander"
    multiplicity = Multiplicity.ONE
    lasting = False
    stage = SAMPLER
    flexible = True
    linear = True
    random = True
    least_error = {"rms_s": 0.1}
    beyond = True

    def apply(self, chain, effect):
        if not effect.p.any():  # as it is where a search begins
            return
        shift = chain.scene.course(effect.p)
        alone = chain.wanted is chain.y
        chain.y = moved(sp_fft.fft(chain.y), shift, ORDERS)
        chain.wanted = chain.y if alone else moved(sp_fft.fft(chain.wanted), shift, ORDERS)

    def nest(self, scene, effect):
        size = course_orders(scene, MOST)[-1]
        all_of_it = start(self, np.zeros(size), trials=effect.trials)
        return "course", all_of_it, np.arange(len(effect.p))

    def columns(self, scene, effect, chain, before, rest):
        slope = sp_fft.ifft(sp_fft.fft(chain.y) * (1j * TAU * frequencies(len(chain.y))))
        return Courses(signals=slope[None], orders=len(effect.p), scene=scene)

    def starts(self, view):
        if view.scene.at is not None:  # between samples that are left out there is no derivative
            return
        for size in course_orders(view.scene, MOST):
            for law in LAWS:
                yield start(self, np.zeros(size), prior=np.arange(1.0, size + 1) ** -law, trials=4, aux={"law": law})

    def values(self, scene, effect, p):
        return {"rms_s": float(np.sqrt(mean_square(scene, p))) / scene.sample_rate_hz}

    def plausible(self, effect):
        return float(np.linalg.norm(effect.p)) < WIDEST

    def describe(self, number):
        return f"The sample clock wanders: {number('rms_s')} rms after its mean rate is taken out."
