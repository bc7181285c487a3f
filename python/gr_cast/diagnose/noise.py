# SPDX-License-Identifier: GPL-3.0-or-later
"""The law of the noise: what every noise family says of the residual of a fit."""

import numpy as np

from ..twin.effects import FAMILIES, Role, is_coarse
from ..twin.effects.base import around_circle
from ..twin.effects.noise_family import NoiseView
from .fit import off_the_rails, shape_of_receiver
from .policy import PASSBAND

TESTED = tuple(f.name for f in FAMILIES.values() if f.noise_like and f.role is not Role.FLOOR)  # laws of the noise, not its level


def view_of(fit) -> NoiseView:
    """The residual where it is the noise's: off the rails."""
    shape, spread, inside = shape_of_receiver(fit, fit.model), fit.data.scene.spread, off_the_rails(fit)
    return NoiseView(
        use=spread(inside),
        energy=spread(np.abs(fit.residual) ** 2 / (1.0 if shape is None else shape)),
        wanted_power=spread(np.abs(fit.chain.wanted) ** 2),
        weighted=spread(fit.came(fit.residual) * fit.data.root**2 * inside),
    )


def starts(fit, beyond_alone: bool = False):
    """[(net gain in nats, effect)] of every noise family that is not in the model yet; `beyond_alone`: of those that are no
    cause, which hold what is not explained apart while the signal still promises more."""
    have = {FAMILIES[e.family].told for e in fit.model.effects}
    if any(is_coarse(e) for e in fit.model.effects):
        return []  # behind a coarse quantiser the noise has no law of its own
    if have & set(TESTED):
        return []
    out, view = [], view_of(fit)
    if not view.use.any():
        return []
    for name in (n for n in TESTED if FAMILIES[n].beyond or not beyond_alone):
        gain, effect = FAMILIES[name].find(view)
        if effect is not None and not _is_passband(fit.data.scene, effect):
            cost = 0.5 * FAMILIES[name].hidden(effect) * np.log(view.use.sum()) + np.log(effect.trials)
            out.append((gain - cost, effect))
    return out


def _is_passband(scene, effect) -> bool:
    """Whether a band of noise is just the signal's: what a receiver's filter leaves of all noise, and no interference."""
    filled = FAMILIES[effect.family].band(effect)
    if filled is None:
        return False
    middle, width = filled
    signal = scene.occupied
    f = np.arange(len(signal)) / len(signal)
    band = around_circle(f, middle) < width / 2
    return (band & signal).sum() > PASSBAND * (band | signal).sum()
