# SPDX-License-Identifier: GPL-3.0-or-later
"""The residual as noise: what a receiver's own faults make of it is no law of the noise."""

import numpy as np
import pytest
from conftest_world import noise
from gr_cast.diagnose.noise import circular
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.noise_family import NoiseView


def _view(energy):
    return NoiseView(use=np.ones(len(energy), bool), energy=energy, wanted_power=np.ones(len(energy)), weighted=energy + 0j)


def test_noise_behind_unequal_gains_holds_no_impulses_that_were_not_there():
    """Its energies are those of two unequal Gaussians; of impulses that are there, as many are found."""
    rng, family, count, beta = np.random.default_rng(11), FAMILIES["impulsive_noise"], 60_000, 0.2 * np.exp(0.4j)
    even, hit, inside = noise(rng, count), rng.random(count) < 1e-3, np.ones(count, bool)
    loud = even + hit * noise(rng, count, 10.0)

    def found(samples):
        return family.find(_view(np.abs(samples) ** 2))

    behind, behind_loud = (one + beta * one.conj() for one in (even, loud))
    assert found(behind)[0] > 30 > 8 > found(circular(behind, inside))[0]
    assert np.abs(circular(even, inside) - even).max() < 0.05  # what is circular stays as it is
    for one in (loud, behind_loud):
        gain, effect = found(circular(one, inside))
        assert gain > 500 and np.exp(effect.p[1]) == pytest.approx(1e-3, rel=0.3)
