# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError
from scipy.interpolate import interp1d


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


def chirp(instants=4, taps=2, seed=1):
    rng = np.random.default_rng(seed)
    gain = rng.normal(size=(instants, taps)) + 1j * rng.normal(size=(instants, taps))
    return sc.LinkTaps(delay_s=rng.uniform(0, 5e-6, (instants, taps)), gain=gain)


CLOCK_S = np.array([0.0, 0.5, 0.75, 2.0])


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_taps_at_any_instant_are_scipys_interpolation_and_end_with_the_last(interpolation):
    taps = chirp()
    scenario = two_nodes(taps, time_s=CLOCK_S, interpolation=interpolation)
    when = np.concatenate([CLOCK_S, np.random.default_rng(2).uniform(0, 2, 40), [2.5, 99.0]])
    for got, values in zip(sc.taps_at(scenario, ("a", "b"), when), (taps.delay_s, taps.gain), strict=True):
        kind = "previous" if interpolation == "hold" else "linear"
        law = interp1d(CLOCK_S, values, kind=kind, axis=0, bounds_error=False, fill_value=(values[0], values[-1]))
        np.testing.assert_allclose(got, law(when), rtol=1e-12)


def test_a_link_that_does_not_change_has_its_taps_at_every_instant():
    taps = sc.LinkTaps(delay_s=[[0.0, 1e-7]], gain=[[1.0, 2.0]])
    for clock_s in ([0.0], CLOCK_S):
        delay_s, gain = sc.taps_at(two_nodes(taps, time_s=clock_s), ("a", "b"), [0.0, 5.0, 9.0])
        assert delay_s.tolist() == [[0.0, 1e-7]] * 3 and gain.tolist() == [[1.0, 2.0]] * 3
    assert two_nodes(taps).is_static and not two_nodes(chirp(), time_s=CLOCK_S).is_static
    assert sc.taps_at(two_nodes(taps), ("a", "b"), 3.0)[1].shape == (1, 2)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"nodes": ()}, "nodes: got 0, needs 1 to 256"),
        ({"nodes": tuple(f"n{k}" for k in range(257))}, "nodes: got 257, needs 1 to 256"),
        ({"nodes": ("a", "b", "../c")}, "got '../c', needs a name"),
        ({"nodes": ("a", "b", "b")}, "named twice"),
        ({"interpolation": "cubic"}, "got 'cubic', needs one of hold, linear"),
        ({"center_frequency_hz": 0.0}, "center_frequency_hz: got 0.0"),
        ({"center_frequency_hz": np.inf}, "center_frequency_hz: got inf"),
        ({"bandwidth_hz": 0.0}, "bandwidth_hz: got 0.0"),
        ({"bandwidth_hz": np.nan}, "bandwidth_hz: got nan"),
        ({"time_s": [0.5]}, "time_s: needs finite seconds"),
        ({"time_s": [0.0, 0.0]}, "time_s: needs finite seconds"),
        ({"time_s": [0.0, np.inf]}, "time_s: needs finite seconds"),
        ({"time_s": [[0.0, 1.0]]}, "time_s: needs finite seconds"),
        ({"base_loss_db": np.inf}, "base_loss_db: got inf"),
        ({"link_base_loss_db": {("a", "b"): np.nan}}, "link a>b: base_loss_db: got nan"),
        ({"time_s": [0.0, 1.0, 2.0], "links": {("a", "b"): chirp(2, 4)}}, "link a>b: got 2 instants, time_s has 3"),
        ({"links": {("a", "c"): chirp(1)}}, "link a>c: names a node that is not in nodes"),
        ({"position_m": {"c": np.zeros((1, 3))}}, "node c: position_m"),
        ({"position_m": {"a": np.zeros((2, 3))}}, r"node a: position_m: needs finite metres of shape \(1, 3\) or \(1, 3\)"),
        ({"position_m": {"a": np.full((1, 3), np.nan)}}, "node a: position_m"),
    ],
)
def test_what_is_no_scenario_is_refused_by_its_one_fault(wrong, says):
    with pytest.raises(CastError, match=says) as error:
        sc.Scenario(**{"name": "s", "nodes": ("a", "b"), "links": {}} | wrong)
    assert len(error.value.faults) == 1


def test_what_a_scenario_may_be_at_most_it_may_be():
    most = sc.Scenario(name="s", nodes=tuple(f"n{k}" for k in range(256)), links={}, time_s=CLOCK_S,
                       position_m={"n0": np.zeros((4, 3)), "n1": np.zeros((1, 3))}, bandwidth_hz=1e-3)  # fmt: skip
    assert len(most.nodes) == 256 and most.is_static
    with pytest.raises(ValueError, match="read-only"):
        most.time_s[0] = 1.0


@pytest.mark.parametrize(("gain", "fits"), [(1e6, True), (-1e6j, True), (1.001e6, False)])
def test_a_taps_gain_is_at_most_120_db(gain, fits):
    if fits:
        taps = sc.LinkTaps(delay_s=[[0.0, 0.0]], gain=[[0.1, gain]])
        for values in (taps.gain, taps.delay_s):
            with pytest.raises(ValueError, match="read-only"):
                values[0, 0] = 1.0
    else:
        with pytest.raises(CastError, match="taps: gain: got 120 dB, limit 120 dB"):
            sc.LinkTaps(delay_s=[[0.0, 0.0]], gain=[[0.1, gain]])


@pytest.mark.parametrize(
    ("delay_s", "gain"),
    [([[0.0]], [[np.inf]]), ([[np.inf]], [[1.0]]), ([[]], [[]]), ([[[0.0]]], [[[1.0]]]), ([[0.0]], [[1.0, 2.0]])],
)
def test_taps_that_are_none_are_refused(delay_s, gain):
    with pytest.raises(CastError, match="taps: "):
        sc.LinkTaps(delay_s=delay_s, gain=gain)


def test_taps_are_equal_where_delays_and_gains_are():
    one, other = chirp(), chirp(seed=2)
    assert one == chirp() and one != other and one != "taps"
    assert one != sc.LinkTaps(delay_s=one.delay_s, gain=other.gain) and one != sc.LinkTaps(delay_s=other.delay_s, gain=one.gain)


def test_half_a_picosecond_off_the_grid_is_rounding_and_more_is_not():
    for delay_s in (-4e-13, 5.11e-6 + 4e-13):
        assert not list(sc.model.taps_off_grid(sc.LinkTaps(delay_s=[[delay_s]], gain=[[1.0]])))
    delays_s = np.array([[0.0, -6e-13, 0.0], [1e-6, 0.0, 5.13e-6]])
    found = list(sc.model.taps_off_grid(sc.LinkTaps(delay_s=delays_s, gain=np.ones((2, 3)))))
    assert found[0] == (1, "delay_s: got -6e-13 s (tap index 0 on the 10 ns grid), limit 0 to 5.11 us (index 511)")
    assert found[1][0] == 2 and "got 5.13e-06 s (tap index 513 on" in found[1][1]
    assert len(list(sc.model.taps_off_grid(sc.LinkTaps(delay_s=[[5.11e-6 + 6e-13]], gain=[[1.0]])))) == 1


def test_a_coarser_clock_has_the_taps_of_its_instants_and_those_of_the_end():
    clock_s = np.arange(0, 1.05, 0.1)
    taps = sc.LinkTaps(delay_s=np.zeros((11, 1)), gain=np.arange(1, 12)[:, None])
    track = np.arange(33.0).reshape(11, 3)
    scenario = two_nodes(taps, time_s=clock_s, position_m={"a": track, "b": np.zeros((1, 3))})
    coarse = sc.resampled(scenario, 0.4)
    np.testing.assert_allclose(coarse.time_s, [0, 0.4, 0.8, 1.0])
    assert coarse.links["a", "b"].gain[:, 0].tolist() == [1, 5, 9, 11]
    assert coarse.position_m["a"].tolist() == track[[0, 4, 8, 10]].tolist() and coarse.position_m["b"].shape == (1, 3)
    same = sc.resampled(scenario, 0.1)
    assert same.links["a", "b"].gain[:, 0].tolist() == list(range(1, 12)) and same.time_s.size == 11
    for step_s in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(CastError, match="step: got"):
            sc.resampled(scenario, step_s)
    still = two_nodes(sc.LinkTaps(delay_s=[[0.0]], gain=[[1.0]]))
    assert sc.resampled(still, 0.1).links == still.links


@pytest.mark.parametrize("held_s", [0.0, 0.3])
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_a_scenario_begun_later_is_the_rest_of_it_after_its_first_taps_stood(held_s, interpolation):
    track = np.arange(12.0).reshape(4, 3)
    scenario = two_nodes(chirp(), time_s=CLOCK_S, interpolation=interpolation, position_m={"a": track, "b": track[:1]})
    for at_s in (0.0, 0.5, 0.6, 2.0):
        late = sc.begun_at(scenario, at_s, held_s)
        when = np.random.default_rng(3).uniform(0, 2 - at_s, 30)
        for got, want in zip(
            sc.taps_at(late, ("a", "b"), when + held_s), sc.taps_at(scenario, ("a", "b"), when + at_s), strict=True
        ):
            np.testing.assert_allclose(got, want, atol=1e-9)
        if held_s:
            first = sc.taps_at(scenario, ("a", "b"), at_s)[1]
            np.testing.assert_allclose(sc.taps_at(late, ("a", "b"), [0.0, 0.1, 0.29])[1], np.repeat(first, 3, axis=0), atol=1e-9)
        assert late.time_s[0] == 0 and late.time_s[-1] == pytest.approx(2 - at_s + held_s)
        assert late.position_m["a"][0].tolist() == track[np.searchsorted(CLOCK_S, at_s, side="right") - 1].tolist()
        assert late.position_m["a"][-1].tolist() == track[-1].tolist() and late.position_m["b"].tolist() == track[:1].tolist()
    for at_s in (-0.1, 2.1, np.nan):
        with pytest.raises(CastError, match="the scenario lasts from 0 to 2 s"):
            sc.begun_at(scenario, at_s)
    still = two_nodes(sc.LinkTaps(delay_s=[[0.0]], gain=[[1.0]]))
    assert sc.begun_at(still, 7.0) is still


def test_losses_of_a_set_up_add_to_every_link_or_stand_for_all():
    own = {("a", "b"): 3.0}
    scenario = sc.Scenario(name="s", nodes=("a", "b"), links=sc.model.reciprocal({("a", "b"): chirp(1)}), base_loss_db=10.0,
                           link_base_loss_db=own)  # fmt: skip
    more, other = sc.with_more_loss(scenario, 2.5), sc.with_base_loss(scenario, 40.0)
    losses = [[sc.base_loss_db(s, key) for key in (("a", "b"), ("b", "a"))] for s in (scenario, more, other)]
    assert losses == [[3.0, 10.0], [5.5, 12.5], [40.0, 40.0]]


def test_the_way_back_is_added_where_there_is_none():
    one, other = chirp(1), chirp(1, seed=5)
    assert sc.model.reciprocal({("a", "b"): one}) == {("a", "b"): one, ("b", "a"): one}
    assert sc.model.reciprocal({("a", "b"): one, ("b", "a"): other}) == {("a", "b"): one, ("b", "a"): other}


def test_the_filter_over_time_has_a_row_for_each_instant_and_ends_at_511():
    taps = sc.LinkTaps(delay_s=[[0.0, 5.114e-6], [-4e-9, 2e-8]], gain=[[1.0, 2.0], [3.0, 4.0]])
    filters = sc.impulse_response(taps)
    assert filters.shape == (2, 512)
    assert [np.flatnonzero(row).tolist() for row in filters] == [[0, 511], [0, 2]]
    assert filters[1, [0, 2]].tolist() == [3, 4]
