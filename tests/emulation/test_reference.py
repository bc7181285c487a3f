# SPDX-License-Identifier: GPL-3.0-or-later
"""Laws of the NumPy reference."""

import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.emulation.reference import (
    INTERPOLATOR_TAPS,
    FixedPoint,
    LinkUpdate,
    bulk_delay_samples,
    emulate,
    filter_length,
    fir_taps,
    has_taps_between_samples,
    interpolator,
    noise_power_from_snr,
    quantize,
    receiver_noise,
    scenario_bulk_delay,
    scenario_updates,
    split_delay,
    sqnr_db,
)
from gr_cast.scenario.model import MAX_DELAY_S, LinkTaps, Scenario
from scipy.interpolate import interp1d
from scipy.signal import lfilter
from scipy.stats import kstest


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


@pytest.mark.parametrize("fraction", np.linspace(0.02, 0.98, 13))
def test_fractional_delay_errs_below_60_db_over_80_percent_of_the_band(fraction):
    delay = 20 + fraction
    taps = fir_taps([delay], [1])
    frequency = np.linspace(-0.4, 0.4, 999)  # cycles per sample
    response = np.exp(-2j * np.pi * np.outer(frequency, np.arange(len(taps)))) @ taps
    ideal = np.exp(-2j * np.pi * frequency * delay)
    assert 20 * np.log10(np.max(np.abs(response - ideal))) < -60


def test_taps_on_whole_samples_stay_there_without_bulk_delay():
    assert bulk_delay_samples([0, 3, 511]) == 0
    assert np.array_equal(fir_taps([0, 3.0000000001], [1, 0.5j]), [1, 0, 0, 0.5j])


def test_bulk_delay_is_just_what_keeps_a_filter_from_reaching_ahead():
    bulk = bulk_delay_samples([0.5, 3])
    ahead = INTERPOLATOR_TAPS // 2 - 1
    assert bulk == ahead
    assert np.flatnonzero(fir_taps([0.5], [1], bulk))[0] == 0
    assert bulk_delay_samples([ahead + 0.5]) == 0


def test_noise_is_white_circular_gaussian_and_independent_between_receivers():
    n = 200_000
    a, b = receiver_noise(5, 0, n), receiver_noise(5, 1, n)
    for part in (a.real, a.imag, b.real, b.imag):
        assert kstest(part * np.sqrt(2), "norm").pvalue > 1e-4
    # Correlations of n samples have standard deviation 1/sqrt(n); 5 of them is one chance in 10^6.
    for other in (b, a.conj(), np.roll(a, 1), receiver_noise(6, 0, n)):
        assert abs(np.vdot(other, a)) / n < 5 / np.sqrt(n)
    assert np.mean(np.abs(a) ** 2) == pytest.approx(1, abs=5 / np.sqrt(n))


def test_noise_of_a_sample_depends_on_its_number_alone():
    whole = receiver_noise(9, 3, 1000)
    assert np.array_equal(whole[333:777], receiver_noise(9, 3, 444, first_sample=333))


def philox4x32(counter, key):
    """Ten rounds, word by word, as Salmon et al. write them (SC11)."""
    c, k = list(counter), list(key)
    for _ in range(10):
        high0, low0 = divmod(0xD2511F53 * c[0], 2**32)
        high1, low1 = divmod(0xCD9E8D57 * c[2], 2**32)
        c = [high1 ^ c[1] ^ k[0], low1, high0 ^ c[3] ^ k[1], low0]
        k = [(k[0] + 0x9E3779B9) % 2**32, (k[1] + 0xBB67AE85) % 2**32]
    return c


@pytest.mark.parametrize("first_pair", [0, 1000, 2**32 - 2, 2**40])
def test_noise_is_philox_by_box_and_muller_keyed_by_seed_receiver_and_number(first_pair):
    # The authors' known answers.
    assert philox4x32([0] * 4, [0] * 2) == [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]
    assert philox4x32([2**32 - 1] * 4, [2**32 - 1] * 2) == [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD]
    seed, expected = (5 << 32) + 7, []
    for pair in range(first_pair, first_pair + 4):
        words = philox4x32([pair % 2**32, pair >> 32, 3, 0], [7, 5])
        for u, t in (words[:2], words[2:]):
            radius = np.sqrt(-np.log(((u >> 8) + 0.5) / 2**24))
            expected.append(radius * np.exp(2j * np.pi * t / 2**32))
    np.testing.assert_allclose(receiver_noise(seed, 3, 8, 2 * first_pair), expected, rtol=1e-12)


def test_a_receivers_noise_is_added_with_its_power():
    y = emulate(np.ones((1, 50)), [LinkUpdate(tx=0, rx=1, taps=[1])], 2, noise_power=(0.0, 4.0), seed=3)
    assert not y[0].any()
    np.testing.assert_allclose(y[1], 1 + 2 * receiver_noise(3, 1, 50), rtol=1e-12)


@pytest.mark.parametrize("bits", [2, 5, 16])
def test_rounding_goes_to_the_nearest_step_and_ends_at_full_scale(bits):
    step = 3.0 / 2 ** (bits - 1)
    values = complex_noise(1, 400)
    rounded = quantize(values, 3.0, bits)
    for got, wanted in ((rounded.real, values.real), (rounded.imag, values.imag)):
        held = np.clip(wanted, -3.0, 3.0 - step)
        assert np.max(np.abs(got - held)) <= step / 2 * (1 + 1e-12)
        np.testing.assert_allclose(got / step, np.round(got / step), atol=1e-9)
    assert quantize(np.array([100 - 100j]), 3.0, bits)[0] == pytest.approx(3.0 - step - 3.0j, rel=1e-12)


def test_what_is_no_number_is_rounded_to_nothing_and_infinity_to_full_scale():
    values = np.array([complex(np.nan, 0.5), complex(-np.inf, np.nan), complex(np.inf, -np.inf)])
    np.testing.assert_array_equal(quantize(values, 1.0, 4), [0.5j, -1.0, 0.875 - 1j])


def test_a_tap_of_no_gain_delays_nothing():
    for gain, late in ((0.0, False), (-1.0, True)):
        link = LinkTaps(delay_s=np.array([[0.0, 0.5e-6]]), gain=np.array([[1.0, gain]]))
        scenario = Scenario(name="s", nodes=("a",), links={("a", "a"): link}, time_s=[0])
        assert (scenario_bulk_delay(scenario, 1e6) > 0) == late


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_quantisation_noise_follows_widrows_law(bits):
    arithmetic = FixedPoint(bits=bits, tap_bits=16, output_full_scale=0.8)
    x = 0.1 * complex_noise(3, 1, 60_000)
    taps = np.array([0.7, 0, 0.2j])
    exact = emulate(x, [LinkUpdate(tx=0, rx=0, taps=taps)], 1)
    rounded = emulate(x, [LinkUpdate(tx=0, rx=0, taps=taps)], 1, fixed_point=arithmetic)
    measured = 10 * np.log10(np.mean(np.abs(exact) ** 2) / np.mean(np.abs(exact - rounded) ** 2))
    assert measured == pytest.approx(sqnr_db(np.mean(np.abs(x) ** 2), taps, arithmetic), abs=0.2)


def test_scenario_plays_its_taps_at_their_instants_with_base_loss():
    link = LinkTaps(delay_s=np.array([[0, 1e-6], [2e-6, 0]]), gain=np.array([[1, 0.5], [2j, 0]]))
    scenario = Scenario(name="s", nodes=("a", "b"), links={("a", "b"): link}, time_s=[0, 1e-3], base_loss_db=20)
    updates, bulk = scenario_updates(scenario, 1e6), scenario_bulk_delay(scenario, 1e6)
    x = np.zeros((2, 3000))
    x[0, [100, 2000]] = 1
    y = emulate(x, updates, 2)
    assert bulk == 0 and not y[0].any()
    expected = np.zeros(3000, complex)
    expected[[100, 101, 2002]] = 0.1, 0.05, 0.2j
    np.testing.assert_allclose(y[1], expected, atol=1e-15)


def test_linear_scenario_moves_its_taps_in_straight_lines():
    link = LinkTaps(delay_s=np.zeros((3, 1)), gain=np.array([[1], [3], [-1]]))
    scenario = Scenario(name="s", nodes=("a",), links={("a", "a"): link}, time_s=[0, 1e-3, 2e-3], interpolation="linear")
    y = emulate(np.ones((1, 2500)), scenario_updates(scenario, 1e6), 1)[0]
    np.testing.assert_allclose(y, np.interp(np.arange(2500), [0, 1000, 2000], [1, 3, -1]), atol=1e-12)


def test_every_tap_of_any_scenario_fits_the_filter():
    for rate_hz in (1e6, 61.44e6, 100e6, 184.32e6):
        taps = fir_taps([0.5, MAX_DELAY_S * rate_hz], [1, 1], bulk_delay_samples([0.5]))
        assert len(taps) <= filter_length(rate_hz)


def test_windows_of_a_scenario_add_up_to_the_whole():
    rng = np.random.default_rng(2)
    link = LinkTaps(delay_s=rng.uniform(0, 5e-6, (20, 3)), gain=rng.standard_normal((20, 3)))
    for interpolation in ("hold", "linear"):
        scenario = Scenario(
            name="s",
            nodes=("a",),
            links={("a", "a"): link},
            time_s=np.arange(20) / 1e3,
            interpolation=interpolation,
        )
        windows = [scenario_updates(scenario, 1e5, a / 1e3, (a + 5) / 1e3) for a in (0, 5, 10, 15)]
        x = complex_noise(3, 1, 2500)
        whole = emulate(x, scenario_updates(scenario, 1e5), 1)
        np.testing.assert_array_equal(emulate(x, sum(windows, []), 1), whole)


@pytest.mark.parametrize("bad", [{"rx": -1}, {"ramp_samples": -1}, {"taps": [np.inf]}, {"taps": 1.0}])
def test_an_update_that_says_nothing_is_refused_by_its_link(bad):
    with pytest.raises(CastError, match=f"update of link {bad.get('tx', 3)}>{bad.get('rx', 4)}"):
        LinkUpdate(**{"tx": 3, "rx": 4, "taps": [1]} | bad)
    assert LinkUpdate(tx=0, rx=0, at_sample=0, ramp_samples=0).taps is None


@pytest.mark.parametrize(("tx", "rx", "there"), [(1, 0, True), (2, 0, False), (0, 2, True), (0, 3, False)])
def test_updates_name_nodes_that_are_there(tx, rx, there):
    if there:
        assert emulate(np.ones((2, 4)), [LinkUpdate(tx=tx, rx=rx, taps=[1])], 3)[rx].all()
    else:
        with pytest.raises(CastError, match="the network has 2 transmitters and 3 receivers"):
            emulate(np.ones((2, 4)), [LinkUpdate(tx=tx, rx=rx, taps=[1])], 3)


@pytest.mark.parametrize(
    ("wrong", "fits"),
    [({"bits": 1}, False), ({"bits": 2}, True), ({"bits": 24}, True), ({"bits": 25}, False), ({"tap_bits": 1}, False),
     ({"tap_bits": 2}, True), ({"tap_bits": 24}, True), ({"tap_bits": 25}, False), ({"input_full_scale": 0.0}, False),
     ({"input_full_scale": np.inf}, False), ({"output_full_scale": 0.0}, False), ({"output_full_scale": np.nan}, False),
     ({"output_full_scale": 1e-9, "input_full_scale": 1e9}, True)],
)  # fmt: skip
def test_arithmetic_has_2_to_24_bits_and_a_finite_full_scale(wrong, fits):
    if fits:
        FixedPoint(**wrong)
    else:
        with pytest.raises(CastError, match="fixed point"):
            FixedPoint(**wrong)


def test_by_default_samples_and_taps_have_16_bits_and_one_is_full_scale():
    x = 0.4 * complex_noise(4, 1, 300)
    taps = [0.3 + 0.1j, 1.0, -2.5]
    y = emulate(x, [LinkUpdate(tx=0, rx=0, taps=taps)], 1, fixed_point=FixedPoint())
    rounded = quantize(x[0], 1.0, 16)
    want = quantize(lfilter(quantize(np.array(taps), 2.0, 16), 1, rounded), 1.0, 16)
    np.testing.assert_array_equal(y[0], want)
    assert np.abs(y.imag).max() == 1.0 and quantize(np.array(taps), 2.0, 16)[2] == -2.0


def test_signal_over_quantisation_noise_is_that_of_input_output_and_taps_alone():
    """Each of the three roundings is made to rule by fine steps of the other two."""
    step = 2.0**-7
    fine = dict(bits=24, tap_bits=24)
    for bits, taps, law in (
        (FixedPoint(bits=8, tap_bits=24, output_full_scale=1e-6), [0.5, 0.5j], 0.5 * 0.1 / (0.5 * step**2 / 6)),
        (FixedPoint(bits=8, tap_bits=24, input_full_scale=1e-6), [0.5, 0.5j], 0.5 * 0.1 / (step**2 / 6)),
        (FixedPoint(**fine | {"tap_bits": 8}), [0.503], 0.503**2 / (0.503 - round(0.503 * 64) / 64) ** 2),
    ):
        assert sqnr_db(0.1, taps, bits) == pytest.approx(10 * np.log10(law), abs=0.01)


def test_noise_so_many_db_below_a_power_is_that_power_over_their_ratio():
    assert noise_power_from_snr(13.0, 0.4) == pytest.approx(0.4 / 10**1.3)


@pytest.mark.parametrize("fraction", [0.001, 0.3, 0.5, 0.999])
def test_the_filter_between_samples_is_the_least_squares_one(fraction):
    """Over 80 % of the band, on a fine grid of frequencies, by NumPy's own solver."""
    frequency = np.linspace(-0.4, 0.4, 4001)
    rows = np.exp(-2j * np.pi * np.outer(frequency, np.arange(INTERPOLATOR_TAPS)))
    ideal = np.exp(-2j * np.pi * frequency * (INTERPOLATOR_TAPS / 2 - 1 + fraction))
    best = np.linalg.lstsq(rows, ideal, rcond=1e-7)[0]
    ours = interpolator(fraction)
    errors = [np.sqrt(np.mean(np.abs(rows @ taps - ideal) ** 2)) for taps in (ours, best)]
    assert errors[0] < 1.1 * errors[1] + 1e-6
    assert np.abs(ours).sum() < 20  # the band alone leaves it nearly free


def test_a_millionth_of_a_sample_is_none():
    whole, rest = split_delay(np.array([3 - 0.9e-6, 3 + 0.9e-6, 3 - 1.1e-6, 3 + 1.1e-6, 2.75]))
    assert whole.tolist() == [3, 3, 2, 3, 2] and (rest[:2] == 0).all()
    np.testing.assert_allclose(rest[2:], [1 - 1.1e-6, 1.1e-6, 0.75], atol=1e-12)


def test_filters_of_all_paths_add_and_end_with_their_last_tap():
    late = bulk_delay_samples([2.5, 40.0])
    assert late == INTERPOLATOR_TAPS // 2 - 1 - 2
    taps = fir_taps(np.array([2.5, 40.0, 40.0, 300.0]), np.array([1.0, 0.5, 0.25j, 0.0]), late)
    want = np.zeros(40 + late + 1, complex)
    want[:INTERPOLATOR_TAPS] = interpolator(0.5)
    want[40 + late] += 0.5 + 0.25j
    np.testing.assert_allclose(taps, want, atol=1e-12)
    assert fir_taps(np.array([5.5]), np.array([1.0]), 20)[20 + 5 - 13 :].size == INTERPOLATOR_TAPS
    assert fir_taps(np.zeros(0), np.zeros(0)).size == 0


def test_filters_are_512_taps_or_hold_the_longest_delay_and_two_interpolators():
    assert filter_length(100e6) == int(np.ceil(MAX_DELAY_S * 100e6)) + 56 == 567
    assert filter_length(1e6) == 512 and filter_length(184.32e6) == int(np.ceil(MAX_DELAY_S * 184.32e6)) + 56


def moving(interpolation, links=None):
    rng = np.random.default_rng(8)
    instants = np.array([0.0, 1e-3, 2.5e-3, 4e-3])
    taps = LinkTaps(delay_s=np.zeros((4, 1)), gain=rng.normal(size=(4, 1)) + 1j * rng.normal(size=(4, 1)))
    return Scenario(name="s", nodes=("a", "b"), links=links or {("a", "b"): taps}, time_s=instants, interpolation=interpolation)


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_in_a_cycle_the_scenario_begins_again_whenever_it_ends(interpolation):
    scenario, rate_hz, count = moving(interpolation), 1e5, 1050
    gain = scenario.links["a", "b"].gain[:, 0]
    when = (np.arange(count) / rate_hz) % 4e-3
    kind = "previous" if interpolation == "hold" else "linear"
    law = interp1d(scenario.time_s, gain, kind=kind)(when + 1e-9)
    whole = scenario_updates(scenario, rate_hz, 0.0, count / rate_hz, cycle=True)
    cut = [scenario_updates(scenario, rate_hz, a, b, cycle=True) for a, b in ((0, 3e-3), (3e-3, 9.5e-3), (9.5e-3, 10.5e-3))]
    for updates in (whole, sum(cut, [])):
        y = emulate(np.ones((2, count)), updates, 2)[1]
        np.testing.assert_allclose(y, law, atol=1e-5)


def test_updates_of_chosen_links_are_those_of_all_and_a_static_link_has_one():
    still = LinkTaps(delay_s=np.array([[0.5e-5]]), gain=np.array([[1.0]]))
    turning = moving("hold").links["a", "b"]
    scenario = moving("hold", {("a", "b"): turning, ("b", "a"): still})
    every = scenario_updates(scenario, 1e5)
    assert [(u.tx, u.rx) for u in every] == [(0, 1)] * 4 + [(1, 0)]
    assert [u.at_sample for u in every] == [0, 100, 250, 400, 0]
    chosen = scenario_updates(scenario, 1e5, links={("b", "a")})
    assert len(chosen) == 1 and np.array_equal(chosen[0].taps, every[-1].taps)  # as late as with all
    assert [u.at_sample for u in scenario_updates(scenario, 1e5, 1e-3, 4e-3)] == [100, 250]
    assert len(scenario_updates(scenario, 1e5, 4e-3)) == 1
    again = scenario_updates(Scenario(name="s", nodes=("a", "b"), links={("b", "a"): still}), 1e5, cycle=True, until_s=9.0)
    assert len(again) == 1  # what does not change never begins again


def test_a_scenario_has_taps_between_samples_at_some_rates_and_unused_ones_are_none():
    link = LinkTaps(delay_s=np.array([[1e-6, 1.5e-6]]), gain=np.array([[1.0, 0.5]]))
    unused = LinkTaps(delay_s=np.array([[1e-6, 1.5e-6]]), gain=np.array([[1.0, 0.0]]))
    for taps, rate_hz, between in ((link, 1e6, True), (link, 2e6, False), (unused, 1e6, False)):
        scenario = Scenario(name="s", nodes=("a",), links={("a", "a"): taps})
        assert has_taps_between_samples(scenario, rate_hz) == between
    assert not has_taps_between_samples(Scenario(name="s", nodes=("a",), links={}), 1e6)
    assert scenario_bulk_delay(Scenario(name="s", nodes=("a",), links={}), 1e6) == 0


def test_ramps_begin_and_end_where_they_are_told_for_any_order_of_changes():
    updates = [
        LinkUpdate(tx=0, rx=0, at_sample=30, taps=[0, 2], ramp_samples=20),
        LinkUpdate(tx=0, rx=0, taps=[1]),
        LinkUpdate(tx=0, rx=0, at_sample=40, base_loss_db=20 * np.log10(4)),
        LinkUpdate(tx=0, rx=0, at_sample=35, enabled=False),
        LinkUpdate(tx=0, rx=0, at_sample=45, enabled=True),
        LinkUpdate(tx=0, rx=0, at_sample=500, taps=[9]),
    ]
    n = np.arange(100)
    share = np.clip((n - 30) / 20, 0, 1)
    on = ((n < 35) | (n >= 45)) * np.where(n < 40, 1.0, 0.25)
    x = np.arange(1.0, 101.0)
    late = np.append(0, x[:-1])
    want = on * ((1 - share) * x + 2 * share * late)
    np.testing.assert_allclose(emulate(x[None], updates, 1)[0], want, atol=1e-12)


def test_of_updates_of_one_sample_the_last_holds_and_shorter_taps_clear_longer_ones():
    updates = [LinkUpdate(tx=0, rx=0, taps=taps) for taps in ([1, 0, 5], [3, 1])]
    assert emulate(np.eye(1, 5), updates, 1)[0].tolist() == [3, 1, 0, 0, 0]
    assert not emulate(np.ones((1, 5)), [LinkUpdate(tx=0, rx=0, enabled=True)], 1).any()
    assert not emulate(np.ones((1, 3)), [LinkUpdate(tx=0, rx=0, taps=[0, 0, 0, 0, 1])], 1).any()  # later than all there is
