# SPDX-License-Identifier: GPL-3.0-or-later
"""Rails eat the noise of the samples that they hold, in step with the code: that is no law of the noise, and no other floor."""

import numpy as np
import pytest
from conftest_world import noise as noise_of
from gr_cast.diagnose import align, diagnose, noise, policy, read_case, residual
from gr_cast.diagnose.fit import off_the_rails
from gr_cast.diagnose.search import candidates, refit
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start


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


def test_a_raised_floor_is_told_by_unseen_samples_off_the_rails_too(world, tmp_path):
    world.noise_rms, world.taps = 0.03, [(0, 1.0), (9, 0.8 * np.exp(0.7j)), (31, 0.5j)]  # a signal whose power changes
    y = world.noisy(world.clean()) + noise_of(world.rng, len(world.n), 0.5 * world.noise_rms)
    y = np.clip(y.real, -0.4, 0.4) + 1j * np.clip(y.imag, -0.4, 0.4)
    document = diagnose(read_case(world.write(tmp_path / "case", y)), budget_s=3000).document
    assert document["verdict"] == "identified"
    assert {e["family"] for e in document["effects"]} == {"adc_clipping", "noise_floor"}
    (change,) = [e["parameters"]["change_db"] for e in document["effects"] if e["family"] == "noise_floor"]
    assert abs(change["value"] - 10 * np.log10(1.25)) < 2.5 * change["std"]


def test_a_loud_band_is_heard_through_rails_that_leave_no_sample_untouched(world, tmp_path):
    """A code of one level beyond the rails, noise and a band a third as loud: of every sample some may have been cut off."""
    rng, count = np.random.default_rng(11), len(world.n)
    world.taps, world.noise_rms = [(0, 1.0)], 0.1
    inside = np.abs(np.fft.fftfreq(count) - 0.21) < 0.01
    band = np.fft.ifft(np.fft.fft(rng.normal(size=(count, 2)) @ [1, 1j]) * inside)
    clean = world.clean() * np.exp(0.3j)
    y = world.noisy(clean + 0.35 * np.std(clean) / np.std(band) * band)
    level = 0.75 * np.abs(clean.real).mean()
    case = read_case(world.write(tmp_path / "case", np.clip(y.real, -level, level) + 1j * np.clip(y.imag, -level, level)))
    _, data, model = align.build(case, case.observations[0])
    rails = start(FAMILIES["adc_clipping"], [level, 0.1], free=[False] * 2)
    fit = refit(data, model.adding(rails))
    assert not off_the_rails(fit).any()
    best = candidates(fit)[0].effect
    assert best.family == "narrowband_interference" and best.p[1] == pytest.approx(0.21, abs=2e-3)
    assert best.p[2] == pytest.approx(0.02, rel=0.2)
