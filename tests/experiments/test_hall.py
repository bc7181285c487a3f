# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.experiments import hall
from scipy.optimize import minimize_scalar

C = 299_792_458.0


@pytest.mark.parametrize("name", hall.WALLS)
def test_a_reflection_takes_the_shortest_way_over_its_wall(name):
    """Fermat's principle, found by search, in the place of the image."""
    axis, place_m = hall.WALLS[name]
    source_m, sink_m = np.array([3.0, -4.0]), np.array([-7.0, 5.0])

    def over(along_m):
        point = np.empty(2)
        point[axis], point[1 - axis] = place_m, along_m
        return np.linalg.norm(point - source_m) + np.linalg.norm(point - sink_m)

    shortest_m = minimize_scalar(over, bracket=(-5, 5)).fun
    delay_s, gain = hall.paths(source_m[None], sink_m, [hall.WALLS[name]])
    assert delay_s[0, 1] * C == pytest.approx(shortest_m)
    assert delay_s[0, 0] * C == pytest.approx(np.hypot(10, 9))
    assert abs(gain[0, 1]) == pytest.approx(0.6 * C / 2.437e9 / (4 * np.pi * shortest_m))


@pytest.mark.parametrize("name", hall.WALLS)
def test_a_wall_left_out_takes_its_path_with_it_and_no_other(name):
    whole, less = (hall.scenario("static", without=out).links[("tx", "rx")] for out in ((), (name,)))
    gone = 1 + list(hall.WALLS).index(name)
    np.testing.assert_array_equal(np.delete(whole.gain, gone, axis=1), less.gain)


def test_the_jammer_walks_past_half_way_at_its_pace():
    s = hall.scenario("mobile", duration_s=20)
    direct_m = s.links[("jammer", "rx")].delay_s[:, 0] * C
    assert s.time_s[np.argmin(direct_m)] == pytest.approx(10, abs=0.01) and direct_m.min() == pytest.approx(hall.PASSING_M)
    assert direct_m[0] == pytest.approx(np.hypot(12, hall.PASSING_M), abs=0.01)


def test_the_twin_has_four_taps_on_the_grid_and_the_same_power():
    whole, twin = (hall.scenario("static", taps=taps).links[("tx", "rx")] for taps in (None, 4))
    assert twin.gain.shape == (1, 4)
    np.testing.assert_allclose(twin.delay_s / 1e-8, np.rint(twin.delay_s / 1e-8), atol=1e-6)
    f = np.linspace(-10e6, 10e6, 401)[:, None]
    responses = [np.sum(t.gain * np.exp(-2j * np.pi * f * t.delay_s), axis=1) for t in (whole, twin)]
    error = np.mean(np.abs(responses[1] - responses[0]) ** 2) / np.mean(np.abs(responses[0]) ** 2)
    assert 10 * np.log10(error) < -15


def test_names_that_are_not_there_are_refused():
    with pytest.raises(CastError, match="the hall has north"):
        hall.scenario("static", without=["roof"])
    with pytest.raises(CastError, match="static, mobile"):
        hall.scenario("flying")
