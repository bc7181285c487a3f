# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether what an effect explains lies all over the recording, as what a radio does throughout must: with what is true no
stretch is less likely than without, however little a few others hold of something else."""

import numpy as np

from .fit import Fit
from .policy import AGAINST_SIGMA, APART, STRETCHES


def is_throughout(fit: Fit, without: np.ndarray) -> bool:
    """Whether an effect of `fit`, the prediction `without` (n,) which is given, explains something outside the stretches in which
    it explains most; stretches of equal energy of the signal, so that its ramps are few of them. What is true gains on average
    the energy by which the two predictions differ, with twice that as variance."""
    data, used = fit.data, fit.data.use > 0
    shape = 1.0 if data.variance is None else data.variance[used]

    def energy(signal):
        return np.abs(data.even(signal, used)[used]) ** 2 / shape / fit.sigma2

    sent = np.cumsum(np.abs(fit.chain.wanted[used]) ** 2)
    stretch = np.minimum((STRETCHES * sent / max(sent[-1], 1e-300)).astype(int), STRETCHES - 1)
    change = fit.chain.y - without
    gained = np.bincount(stretch, energy(fit.residual + change) - energy(fit.residual), STRETCHES)
    promised = np.bincount(stretch, energy(change), STRETCHES)
    others = np.argsort(gained)[: STRETCHES - int(APART * STRETCHES)]
    got, due = gained[others].sum(), promised[others].sum()
    return not (got < 0 and due - got > AGAINST_SIGMA * np.sqrt(2 * due))
