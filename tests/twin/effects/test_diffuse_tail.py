# SPDX-License-Identifier: GPL-3.0-or-later
"""A tail's power and decay are those that make the recording likeliest, all taps averaged out."""

from dataclasses import replace

import numpy as np
import pytest
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start
from gr_cast.twin.effects.diffuse_tail import Told, profile
from scipy.stats import multivariate_normal

ECHO = FAMILIES["extra_path"]
TAIL = FAMILIES["diffuse_tail"]
SIZE = 100


class Scene:
    sample_rate_hz = 1e6


def _gaussian(rng, size):
    return (rng.normal(size=size) + 1j * rng.normal(size=size)) / np.sqrt(2)


def _fitted(taps, noise_power, rng):
    """(effect, covariance) as a fit leaves them where every tap was measured on its own in noise."""
    seen = taps + np.sqrt(noise_power) * _gaussian(rng, len(taps))
    prior = profile(len(taps), 1.0, len(taps) / 3)
    covariance = 1 / (2 / noise_power + 1 / prior)
    p = covariance * 2 / noise_power * np.stack([seen.real, seen.imag], 1).ravel()
    return start(TAIL, p, prior=prior, aux={"source": 0, "first": 1.0}), np.diag(covariance)


def test_the_likelihood_of_a_law_is_that_of_gaussian_taps_in_gaussian_noise():
    rng = np.random.default_rng(3)
    design, noise_power = rng.normal(size=(9, 6)), 0.3
    recorded = rng.normal(size=9)
    prior, law = np.array([1.0, 1.0, 0.5, 0.5, 0.2, 0.2]), profile(3, 0.7, 1.4)
    covariance = np.linalg.inv(design.T @ design / noise_power + np.diag(1 / prior))
    told = Told.of(covariance @ design.T @ recorded / noise_power, covariance, prior)
    with_taps = multivariate_normal(cov=noise_power * np.eye(9) + design @ np.diag(law) @ design.T).logpdf(recorded)
    without = multivariate_normal(cov=noise_power * np.eye(9)).logpdf(recorded)
    assert told.likelihood(law) == pytest.approx(with_taps - without, rel=1e-6)


@pytest.mark.parametrize("ends", [3.0, 6.0, 20.0])
@pytest.mark.parametrize("decay", [9.0, 20.0])
def test_power_and_decay_are_told_within_their_errors_wherever_the_tail_ends(decay, ends):
    rng, z = np.random.default_rng(8), []
    for _ in range(3):
        k = np.arange(SIZE)
        taps = 0.1 * _gaussian(rng, SIZE) * np.exp(-k / decay / 2) * (k < ends * decay)
        effect = TAIL.settled_law(Scene, *_fitted(taps, 1e-6, rng))
        values, stds = TAIL.values(Scene, effect, effect.p), effect.aux["_stds"]
        assert values["decay_s"] * 1e6 == pytest.approx(decay, rel=0.4)
        z += [(values["decay_s"] * 1e6 - decay) / (stds["decay_s"] * 1e6)]
        z += [(values["power_db"] - 10 * np.log10(np.sum(np.abs(taps) ** 2))) / stds["power_db"]]
    assert np.sqrt(np.mean(np.square(z))) < 1.5


@pytest.mark.parametrize("onset", [0, 30])
def test_a_tail_begins_behind_the_tap_that_makes_it_likeliest(onset):
    """Scattering that follows a late path has the decay that it has there, not that of all taps since the first one."""
    for seed in range(3):
        rng, k = np.random.default_rng(seed), np.arange(SIZE) - onset
        taps = 0.1 * _gaussian(rng, SIZE) * np.exp(-k / 7.0 / 2) * (k >= 0)
        effect, covariance = _fitted(taps, 1e-6, rng)
        effect = TAIL.likelier(replace(effect, aux={**effect.aux, "_onsets": (12, 30)}), covariance)
        size = len(effect.p)
        effect = TAIL.settled_law(Scene, effect, covariance[:size, :size])
        values, stds = TAIL.values(Scene, effect, effect.p), effect.aux["_stds"]
        assert values["decay_s"] * 1e6 == pytest.approx(7.0, abs=3 * stds["decay_s"] * 1e6) and stds["decay_s"] < 4e-6
        begin, end = TAIL.where(Scene, effect, values)["delay_s"]
        assert begin * 1e6 == pytest.approx(onset + 1) and end - begin < 50e-6


def test_a_law_that_is_likelier_keeps_the_taps_that_hold_the_tail():
    rng = np.random.default_rng(4)
    taps = 0.1 * _gaussian(rng, 128) * np.exp(-np.arange(128) / 8 / 2)
    likelier = TAIL.likelier(*_fitted(taps, 1e-6, rng))
    assert len(likelier.p) == len(likelier.prior) == len(likelier.free)
    assert 5 * 8 < len(likelier.p) / 2 < 100  # a few decays, not all that were looked at
    assert likelier.prior[0] / likelier.prior[16] == pytest.approx(np.exp(8 / 8), rel=0.4)  # the taps 0 and 8


def test_sums_of_taps_of_which_nothing_was_heard_leave_the_law_as_it_is():
    """Faint taps under a steep law, seen through a waveform that holds half of the band: rounding leaves information below 0."""
    rng = np.random.default_rng(2)
    design, noise_power = rng.normal(size=(32, 64)), 1e-9
    prior = profile(32, 1e-6, 2.0)
    covariance = np.linalg.inv(design.T @ design / noise_power + np.diag(1 / prior))
    covariance *= 1 + 1e-9 * rng.normal(size=covariance.shape)  # what an iteration that ends leaves over
    recorded = design @ (rng.normal(size=64) * np.sqrt(prior)) + rng.normal(size=32) * np.sqrt(noise_power)
    mean = covariance @ design.T @ recorded / noise_power
    told = Told.of(mean, (covariance + covariance.T) / 2, prior)
    likelihoods = [told.likelihood(profile(32, power, 2.0)) for power in (1e-6, 1.0, 1e6)]
    assert np.isfinite(likelihoods).all() and np.argmax(likelihoods) == 0


def test_the_strongest_of_the_taps_behind_the_row_is_the_tails_and_a_wall_is_not():
    """A row of 64 taps of a tail that falls by e in 40: of its next 80 taps the strongest is told as an echo, if any is."""
    rng, decay, size = np.random.default_rng(7), 40.0, 64
    power = np.exp(-np.arange(size + 80) / decay)
    law = {"decay": decay, "power": float(power[:size].sum())}
    tail = start(TAIL, np.zeros(2 * size), aux={"source": 0, "first": 1.0, "_law": law})
    held = []
    for _ in range(300):
        taps = np.sqrt(power / 2) * (rng.normal(size=(2, len(power))).T @ [1, 1j])
        k = size + int(np.argmax(np.abs(taps[size:]) ** 2 / power[size:]))
        held.append(TAIL.holds(Scene, tail, start(ECHO, [taps[k].real, taps[k].imag, 1.0 + k, 0.0], aux={"source": 0})))
    assert np.mean(held) > 0.75
    faint = [np.sqrt(power[size + 10]), 0.0, 1.0 + size + 10]
    assert TAIL.holds(Scene, tail, start(ECHO, [*faint, 0.0], aux={"source": 0}))
    assert not TAIL.holds(Scene, tail, start(ECHO, [*faint, 5.0], aux={"source": 0}))  # it turns
    loud = np.sqrt(20 * power[size + 10])
    assert not TAIL.holds(Scene, tail, start(ECHO, [loud, 0.0, 1.0 + size + 10, 0.0], aux={"source": 0}))
    assert not TAIL.holds(Scene, tail, start(ECHO, [1e-3, 0.0, 1.0 + size + 10, 0.0], aux={"source": 1}))


@pytest.mark.parametrize("seed", range(6))
def test_sums_of_taps_that_are_known_all_but_exactly_leave_a_likelihood(seed):
    """Rounding leaves less than nothing of the sums that are not known; a prior then still holds them."""
    rng, size = np.random.default_rng(seed), 32
    seen = np.linalg.qr(rng.normal(size=(size, size)))[0][:, :5]
    information = (seen * 10.0 ** rng.uniform(18, 24, 5)) @ seen.T
    told = Told(information=information, pull=information @ rng.normal(size=size))
    assert np.isfinite(told.likelihood(profile(size // 2, 1.0, 3.0)))
