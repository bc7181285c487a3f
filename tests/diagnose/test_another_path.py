# SPDX-License-Identifier: GPL-3.0-or-later
"""A path that is gone takes no delay with it: what is found where it was looked for may be another one."""

import numpy as np
import pytest
from gr_cast.diagnose import align, read_case
from gr_cast.diagnose.search import beginnings


@pytest.mark.parametrize(("left", "family"), [(0.0, "missing_path"), (0.06, "tap_gain_error")])
def test_a_strongest_path_that_is_gone_or_weak_is_named_though_another_is_found_at_its_delay(world, tmp_path, left, family):
    world.taps = [(0, 1.0), (9, 0.3 * np.exp(0.7j)), (25, 0.2 * np.exp(-1.1j))]
    world.taps[0] = (0, left * np.exp(2j))
    y = world.noisy(world.clean())
    world.taps[0] = (0, 1.0)
    case = read_case(world.write(tmp_path / "case", y))
    _, data, model = align.build(case, case.observations[0])
    best = beginnings(data, model)[0]
    assert [e.family for e in best.model.effects] == [family]
    assert best.model.base[0] == pytest.approx(37.0, abs=0.05)
    assert best.sigma2 < 1.2 * world.noise_rms**2
