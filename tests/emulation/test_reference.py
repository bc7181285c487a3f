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
    quantize,
    receiver_noise,
    scenario_bulk_delay,
    scenario_updates,
    sqnr_db,
)
from gr_cast.scenario.model import MAX_DELAY_S, LinkTaps, Scenario
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
