# SPDX-License-Identifier: GPL-3.0-or-later
"""An impulse that a receive filter draws out is one impulse, with the energy of all its samples."""

import numpy as np
import pytest
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.noise_family import NoiseView

COUNT = 50_000


@pytest.mark.parametrize("lasting", [1, 3, 5])
def test_rate_and_power_are_those_of_impulses_however_long_a_filter_makes_them(lasting):
    rng = np.random.default_rng(6)
    gaussian = lambda n: (rng.normal(size=n) + 1j * rng.normal(size=n)) / np.sqrt(2)  # noqa: E731
    impulses = np.zeros(COUNT, complex)
    impulses[rng.choice(COUNT, 60, replace=False)] = np.sqrt(4000.0) * np.exp(2j * np.pi * rng.random(60))
    drawn_out = np.convolve(impulses, np.ones(lasting) / np.sqrt(lasting))[:COUNT]
    seen = gaussian(COUNT) + drawn_out
    view = NoiseView(use=np.ones(COUNT, bool), energy=np.abs(seen) ** 2, wanted_power=np.ones(COUNT), weighted=seen)
    _, effect = FAMILIES["impulsive_noise"].find(view)
    effect.aux["_floor"] = 1.0

    class Scene:
        sample_rate_hz = 1e6

    told = FAMILIES[effect.family].values(Scene, effect, effect.p)
    assert told["rate_hz"] == pytest.approx(60 / COUNT * 1e6, rel=0.12)
    assert told["power_db"] == pytest.approx(10 * np.log10(4000.0), abs=0.5)
