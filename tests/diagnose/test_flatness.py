# SPDX-License-Identifier: GPL-3.0-or-later
"""What no cell of the residual tells alone: a long faint stretch, and what comes again in a waveform that is sent once."""

import numpy as np
import pytest
from conftest_world import RATE_HZ, noise, sent_once
from gr_cast.diagnose import align, flatness, policy, read_case, residual
from gr_cast.diagnose.fit import off_the_rails
from gr_cast.diagnose.search import refit


def _fit(case):
    _, data, model = align.build(case, case.observations[0])
    return refit(data, model)


def _told(fit):
    rest = [*residual.leftovers(fit, off_the_rails(fit)), *flatness.left(fit, off_the_rails(fit))]
    return {r.test for r in rest if r.p_value < policy.UNEXPLAINED_P and r.nats > policy.UNEXPLAINED_NATS}


def test_a_stretch_too_faint_for_any_cell_is_left_with_its_place(world, tmp_path):
    faint = noise(world.rng, len(world.n), 0.45 * world.noise_rms) * ((world.n > 5_000) & (world.n < 11_000))
    fit = _fit(read_case(world.write(tmp_path / "case", world.noisy(world.clean() + faint))))
    rest = flatness.stretch(fit)
    assert rest.p_value < policy.UNEXPLAINED_P and rest.nats > policy.UNEXPLAINED_NATS
    assert np.allclose(np.array(rest.where["time_s"]) * RATE_HZ, [5_000, 11_000], atol=1800)
    assert "time × frequency" not in {
        r.test for r in residual.leftovers(fit, off_the_rails(fit)) if r.p_value < policy.UNEXPLAINED_P
    }


def test_even_noise_leaves_no_stretch_and_nothing_that_comes_again(tmp_path):
    told = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        x = noise(rng, 6_000)
        (tmp_path / str(seed)).mkdir()
        fit = _fit(sent_once(tmp_path / str(seed), 0.2 * x + noise(rng, 6_000, 0.02), x))
        told += [flatness.stretch(fit).p_value, flatness.comes_again(fit).p_value]
    assert min(told) > 1e-3


def test_few_samples_that_the_rails_leave_tell_no_more_than_they_are(tmp_path):
    """One or two of 32 have the same energy in all bands."""
    rng, count = np.random.default_rng(4), 40_000
    x = noise(rng, count)
    fit = _fit(sent_once(tmp_path, 0.2 * x + noise(rng, count, 0.02), x))
    told = [flatness.left(fit, (fit.data.use > 0) & (rng.random(count) < 0.02)) for _ in range(8)]
    assert min(rest.p_value for every in told for rest in every) > 1e-3


@pytest.mark.parametrize("strength", [0.0, 0.25])
def test_an_error_that_comes_again_with_each_symbol_of_a_waveform_sent_once_is_left(tmp_path, strength):
    rng, period, count = np.random.default_rng(3), 640, 24_000
    x = noise(rng, count)
    error = strength * 0.02 * np.resize(noise(rng, period), count)
    fit = _fit(sent_once(tmp_path, 0.2 * x + error + noise(rng, count, 0.02), x))
    again = {t for t in _told(fit) if "again" in t}
    assert bool(again) == (strength > 0)


def test_impulses_in_several_bursts_do_not_come_at_random():
    rng = np.random.default_rng(2)
    even = np.sort(rng.random(600))
    bursts = np.sort(np.concatenate([rng.random(300), *(c + 0.02 * rng.random(60) for c in (0.1, 0.3, 0.5, 0.7, 0.9))]))
    assert residual._in_several(even) > 0.01
    assert residual._in_several(bursts) < policy.CROWDED_P / 2
