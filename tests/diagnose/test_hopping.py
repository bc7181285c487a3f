# SPDX-License-Identifier: GPL-3.0-or-later
"""What hops from band to band is left, though no cell of time and frequency tells it, and noise does not hop."""

import numpy as np
from conftest_world import noise, sent_once
from gr_cast.diagnose import align, flatness, hopping, policy, residual
from gr_cast.diagnose.fit import off_the_rails
from gr_cast.diagnose.search import refit

COUNT, NOISE = 40_000, 0.02


def _fit(folder, more=0.0, seed=3):
    rng = np.random.default_rng(seed)
    x = noise(rng, COUNT)
    folder.mkdir()
    case = sent_once(folder, 0.2 * x + more + noise(rng, COUNT, NOISE), x)
    _, data, model = align.build(case, case.observations[0])
    return refit(data, model)


def _tones(rng, each: int) -> np.ndarray:
    return np.exp(2j * np.pi * np.cumsum(np.repeat(rng.uniform(-0.4, 0.4, COUNT // each), each)))


def test_a_faint_carrier_that_hops_is_left_though_no_cell_shows_it_nor_all_together(tmp_path):
    fit = _fit(tmp_path / "case", 0.14 * NOISE * _tones(np.random.default_rng(8), 1000))
    rest = {r.test: r for r in [*residual.leftovers(fit, off_the_rails(fit)), *flatness.left(fit, off_the_rails(fit))]}
    hops = rest.pop("energy that hops in frequency")
    assert hops.p_value < policy.UNEXPLAINED_P and hops.nats > policy.UNEXPLAINED_NATS
    assert not [r for r in rest.values() if r.p_value < policy.UNEXPLAINED_P and r.nats > policy.UNEXPLAINED_NATS]


def test_noise_does_not_hop_nor_does_a_colour_that_stays_or_a_level_that_moves(tmp_path):
    n = np.arange(COUNT)
    coloured = np.convolve(noise(np.random.default_rng(4), COUNT + 8, 0.3 * NOISE), np.ones(9), "valid")
    louder = noise(np.random.default_rng(5), COUNT, NOISE) * (np.sin(6 * np.pi * n / COUNT) > 0)
    for k, more in enumerate([0.0, coloured, louder]):
        assert hopping.left(_fit(tmp_path / str(k), more, seed=k)).p_value > 0.01


def test_the_likelihood_of_all_ways_together_has_a_mean_of_one_over_white_noise():
    rng, levels, paces = np.random.default_rng(1), np.array([[0.1], [0.3]]), np.array([0.02, 0.1])
    ratios = np.exp([hopping._likelihood(rng.exponential(size=(80, 12)), levels, paces) for _ in range(600)])
    assert np.all(np.abs(ratios.mean(0) - 1) < 5 * ratios.std(0) / np.sqrt(len(ratios)))
    assert np.all(ratios.std(0) > 0.01)
