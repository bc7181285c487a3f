# SPDX-License-Identifier: GPL-3.0-or-later
"""Laws of the NumPy reference."""

import numpy as np
import pytest
from gr_cast.emulate import LinkUpdate, emulate
from gr_cast.errors import CastError
from scipy.signal import lfilter


def complex_noise(seed, *shape):
    rng = np.random.default_rng(seed)
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def test_static_network_is_a_sum_of_fir_filters():
    x, h = complex_noise(1, 3, 2000), complex_noise(2, 3, 2, 40)
    updates = [LinkUpdate(tx=i, rx=j, taps=h[i, j]) for i in range(3) for j in range(2)]
    expected = [sum(lfilter(h[i, j], 1, x[i]) for i in range(3)) for j in range(2)]
    np.testing.assert_allclose(emulate(x, updates, 2), expected, rtol=0, atol=1e-12)


def test_update_holds_from_its_sample_on():
    x = np.ones((1, 100))
    y = emulate(x, [LinkUpdate(tx=0, rx=0, taps=[1]), LinkUpdate(tx=0, rx=0, at_sample=40, taps=[0, 3])], 1)
    assert np.array_equal(y[0], np.r_[np.ones(40), 3 * np.ones(60)])


def test_ramp_is_a_straight_line_and_turns_where_it_is_when_interrupted():
    updates = [
        LinkUpdate(tx=0, rx=0, at_sample=10, taps=[1], ramp_samples=100),
        LinkUpdate(tx=0, rx=0, at_sample=60, taps=[0], ramp_samples=50),
    ]
    y = emulate(np.ones((1, 200)), updates, 1)[0]
    expected = np.interp(np.arange(200), [10, 60, 110], [0, 0.5, 0])
    np.testing.assert_allclose(y, expected, atol=1e-12)


def test_switched_off_link_keeps_its_taps():
    updates = [
        LinkUpdate(tx=0, rx=0, taps=[2]),
        LinkUpdate(tx=0, rx=0, at_sample=5, enabled=False),
        LinkUpdate(tx=0, rx=0, at_sample=8, enabled=True),
    ]
    assert np.array_equal(emulate(np.ones((1, 10)), updates, 1)[0], [2, 2, 2, 2, 2, 0, 0, 0, 2, 2])


@pytest.mark.parametrize("bad", [{"taps": [np.nan]}, {"at_sample": -1}, {"tx": -1}, {"taps": [[1]]}])
def test_malformed_update_is_refused(bad):
    with pytest.raises(CastError):
        LinkUpdate(**{"tx": 0, "rx": 0, "taps": [1]} | bad)


def test_update_of_an_absent_node_is_refused():
    with pytest.raises(CastError, match="1 transmitters"):
        emulate(np.ones((1, 4)), [LinkUpdate(tx=1, rx=0, taps=[1])], 1)
