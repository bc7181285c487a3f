# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError


def two_nodes(taps, **about):
    return sc.Scenario(name="test", nodes=("a", "b"), links={("a", "b"): taps}, **about)


def test_taps_hold_until_the_next_instant_or_move_on_a_straight_line():
    taps = sc.LinkTaps(delay_s=[[0.0], [1e-7]], gain=[[1.0], [3.0]])
    held = two_nodes(taps, time_s=[0, 1])
    for when, value in ((0.0, 1.0), (0.999, 1.0), (1.0, 3.0), (50.0, 3.0)):
        assert sc.taps_at(held, ("a", "b"), [when])[1][0, 0] == value
    linear = two_nodes(taps, time_s=[0, 1], interpolation="linear")
    delay_s, gain = sc.taps_at(linear, ("a", "b"), [0.0, 0.25, 1.0, 50.0])
    np.testing.assert_allclose(gain[:, 0], np.interp([0, 0.25, 1, 50], [0, 1], [1, 3]))
    np.testing.assert_allclose(delay_s[:, 0], np.interp([0, 0.25, 1, 50], [0, 1], [0, 1e-7]))


def test_a_tap_fades_in_at_its_own_delay_not_from_that_of_an_unused_one():
    taps = sc.LinkTaps(delay_s=[[0.0], [4e-7]], gain=[[0.0], [1.0]])
    linear = two_nodes(taps, time_s=[0, 1], interpolation="linear")
    delay_s, gain = sc.taps_at(linear, ("a", "b"), [0.5])
    assert delay_s[0, 0] == 4e-7 and gain[0, 0] == 0.5


def test_powers_of_taps_add_and_base_loss_subtracts_in_db():
    taps = sc.LinkTaps(delay_s=[[0, 1e-6]], gain=[[0.6, 0.8j]])
    scenario = two_nodes(taps, base_loss_db=57.55)
    assert sc.tap_power_db(scenario, ("a", "b"))[0] == pytest.approx(-57.55)
    matrix = sc.path_gain_matrix_db(scenario)
    assert matrix[0, 1] == pytest.approx(-57.55) and matrix[1, 0] == -np.inf
    own = two_nodes(taps, base_loss_db=57.55, link_base_loss_db={("a", "b"): 3.0})
    np.testing.assert_allclose(np.abs(sc.played_gain(own, ("a", "b"))), np.array([[0.6, 0.8]]) * 10 ** (-3 / 20))


def test_the_filter_holds_every_tap_at_its_nearest_10_ns_and_adds_those_that_meet():
    taps = sc.LinkTaps(delay_s=[[0.0, 4.9e-9, 1.281e-6, 5.11e-6]], gain=[[1, 1j, 0.5, -0.25]])
    expected = np.zeros(512, complex)
    expected[[0, 128, 511]] = 1 + 1j, 0.5, -0.25
    np.testing.assert_array_equal(sc.impulse_response(taps)[0], expected)


@pytest.mark.parametrize("delay_s, fits", [(0.0, True), (5.11e-6, True), (5.12e-6, False), (-1e-9, False)])
def test_a_used_tap_must_lie_on_the_512_tap_grid(delay_s, fits):
    taps = sc.LinkTaps(delay_s=[[delay_s]], gain=[[1.0]])
    if fits:
        two_nodes(taps)
    else:
        with pytest.raises(CastError, match=r"link a>b: tap 1: delay_s: got .*limit 0 to 5.11 us"):
            two_nodes(taps)
    two_nodes(sc.LinkTaps(delay_s=[[delay_s]], gain=[[0.0]]))  # an unused tap has no delay


def test_all_faults_of_a_scenario_are_reported_at_once():
    taps = sc.LinkTaps(delay_s=np.zeros((3, 1)), gain=np.ones((3, 1)))
    with pytest.raises(CastError) as error:
        sc.Scenario(
            name="bad", nodes=("a", "a"), links={("a", "z"): taps}, time_s=[0, 2, 1], interpolation="cubic",
            base_loss_db=np.nan, center_frequency_hz=-1.0, position_m={"a": np.zeros((1, 2))},
        )  # fmt: skip
    text = str(error.value)
    for place in ("named twice", "a>z", "time_s", "interpolation", "base_loss_db", "center_frequency_hz", "position_m"):
        assert place in text
    with pytest.raises(CastError, match="finite"):
        sc.LinkTaps(delay_s=[[np.nan]], gain=[[1.0]])
    with pytest.raises(CastError, match="one shape"):
        sc.LinkTaps(delay_s=[[0.0, 1.0]], gain=[[1.0]])


def test_a_tap_that_fades_keeps_its_delay_in_and_out():
    """An unused tap (gain 0) has no delay of its own: whatever stands there, the tap fades where it is or will be."""
    delay_s, gain = np.array([[9e-7], [2e-6], [3e-7]]), np.array([[0.0], [1.0], [0.0]])
    faded = sc.Scenario(
        name="fade",
        nodes=("a", "b"),
        time_s=np.array([0.0, 1.0, 2.0]),
        interpolation="linear",
        links={("a", "b"): sc.LinkTaps(delay_s=delay_s, gain=gain)},
    )
    delays, gains = sc.taps_at(faded, ("a", "b"), np.array([0.25, 1.0, 1.75]))
    assert delays[:, 0] == pytest.approx([2e-6] * 3, abs=1e-15) and gains[:, 0] == pytest.approx([0.25, 1.0, 0.25])
