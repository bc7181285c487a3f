# SPDX-License-Identifier: GPL-3.0-or-later
"""Rails eat the noise of the samples that they hold, in step with the code: that is no law of the noise, and no other floor."""

import numpy as np
import pytest
from gr_cast.diagnose import diagnose, noise, policy, read_case, residual
from gr_cast.diagnose.fit import off_the_rails


def clipped(world, level):
    y = world.noisy(world.clean())
    return np.clip(y.real, -level, level) + 1j * np.clip(y.imag, -level, level)


@pytest.mark.parametrize(("noise_rms", "level"), [(0.06, 0.28), (0.03, 0.2)])
def test_clipping_is_all_that_is_found_of_clipping_under_noise(world, tmp_path, noise_rms, level):
    world.noise_rms = noise_rms
    document = diagnose(read_case(world.write(tmp_path / "case", clipped(world, level))), budget_s=3000)
    (finding,) = document.findings
    assert document.document["verdict"] == "identified"
    assert [e["family"] for e in document.document["effects"]] == ["adc_clipping"]
    fit = finding.fit
    inside = off_the_rails(fit)
    assert inside.sum() < 0.9 * fit.data.count  # the rails hold much
    assert not noise.starts(fit) or max(net for net, _ in noise.starts(fit)) < 0
    assert all(rest.p_value > policy.UNEXPLAINED_P for rest in residual.leftovers(fit, inside))
