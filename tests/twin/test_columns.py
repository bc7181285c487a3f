# SPDX-License-Identifier: GPL-3.0-or-later
"""Inner products of derivatives are those of the derivatives written out."""

from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast.twin.basis import course
from gr_cast.twin.columns import Courses, Dense, Lags, gram, inner, some_at_once

COUNT = 3000


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def gaussian(rng, *shape):
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def written_out(a, b):
    return (np.conj(a.full()) @ b.full().T).real


@pytest.mark.parametrize("low", [-40, -3, 0, 7])
@pytest.mark.parametrize("window", ["none", "gaps", "rough"])
def test_many_lags_of_one_signal_have_the_products_of_their_samples(rng, low, window):
    seen = {"none": None, "gaps": np.where(np.arange(COUNT) % 700 < 600, 1.3, 0.0), "rough": rng.uniform(size=COUNT)}[window]
    entries = tuple((0, low + k) for k in range(50))
    lags = Lags(signals=gaussian(rng, 1, COUNT), entries=entries, window=seen, paired=-1, turn=0.1)
    few = Lags(signals=gaussian(rng, 2, COUNT), entries=((0, 3), (1, -2)))
    dense = Dense(signals=gaussian(rng, 3, COUNT))
    for other in (lags, few, dense):
        expected = written_out(lags, other)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(inner(lags, other), expected, atol=1e-11 * scale)
        np.testing.assert_allclose(inner(other, lags), expected.T, atol=1e-11 * scale)


@pytest.mark.parametrize("orders", [6, 24, 96])
def test_slow_courses_of_rough_signals_have_the_products_of_their_samples(rng, orders):
    """However a signal changes from sample to sample: without that, what is left of a sum is no sum of squares."""
    count = 100 * orders + 11
    scene = SimpleNamespace(course=lambda p: course(p, count), spread=lambda signal: signal)
    chips = np.sign(rng.normal(size=(2, count))) * np.exp(0.4j)
    courses, dense = Courses(signals=chips, orders=orders, scene=scene), Dense(signals=gaussian(rng, 2, count))
    size = [np.linalg.norm(block.full(), axis=1) for block in (courses, dense)]
    for b, norm in ((courses, size[0]), (dense, size[1])):
        assert np.abs((inner(courses, b) - written_out(courses, b)) / np.outer(size[0], norm)).max() < 2e-5
    unit = gram([courses, dense]) / np.outer(np.concatenate(size), np.concatenate(size))
    assert np.linalg.eigvalsh(unit)[0] > 0


@pytest.mark.parametrize("window", ["gaps", "rough"])
@pytest.mark.parametrize("kinds", [1, 3])
def test_lags_of_several_signals_have_the_products_of_their_samples(rng, window, kinds):
    seen = {"gaps": np.where(np.arange(COUNT) % 700 < 600, 1.3, 0.0), "rough": rng.uniform(size=COUNT)}[window]
    entries = tuple((i, lag) for lag in (2, -3, -2, -1, 0, 1) for i in range(kinds) if (i, lag) != (0, 0))
    lags = Lags(signals=gaussian(rng, kinds, COUNT), entries=entries, window=seen, turn=-0.2)
    expected = written_out(lags, lags)
    np.testing.assert_allclose(inner(lags, lags), expected, atol=1e-11 * np.abs(expected).max())


def test_a_late_signal_is_turned_with_every_sample_that_it_is_late(rng):
    lags = Lags(signals=gaussian(rng, 1, COUNT), entries=((0, 0), (0, 5), (0, -2)), turn=0.3)
    late = [np.exp(0.3j * lag) * np.roll(lags.signals[0], lag) for lag in (0, 5, -2)]
    np.testing.assert_allclose(lags.full()[::2, 5:-5], np.array(late)[:, 5:-5], rtol=1e-12)


@pytest.mark.parametrize(("count", "each", "runs"), [(7, 3, [3, 3, 1]), (2, 50, [1, 1]), (4, 0, [4]), (0, 5, [])])
def test_runs_have_every_item_once_and_no_more_than_they_may(count, each, runs):
    found = some_at_once(np.arange(count), each, 10)
    assert [len(run) for run in found] == runs
    assert [*map(int, np.concatenate([[], *found]))] == [*range(count)]
