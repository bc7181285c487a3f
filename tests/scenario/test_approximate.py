# SPDX-License-Identifier: GPL-3.0-or-later
import itertools

import numpy as np
import pytest
from gr_cast.scenario.create import approximate

BAND_HZ = 80e6


def room(tx_m, rx_m, size_m=(19.0, 12.0, 3.0), order=3, reflection=0.5):
    """Image sources of a shoebox room (Allen & Berkley 1979): delays and gains (P,) at 2.4 GHz."""
    images = [
        (sum(map(abs, n)), [k * s + (x if k % 2 == 0 else s - x) for k, s, x in zip(n, size_m, tx_m, strict=True)])
        for n in itertools.product(range(-order, order + 1), repeat=3)
    ]
    bounces, places = zip(*[image for image in images if image[0] <= order], strict=True)
    distance_m = np.linalg.norm(np.array(places) - rx_m, axis=1)
    delay_s = distance_m / 299_792_458.0
    return delay_s, reflection ** np.array(bounces) / distance_m * np.exp(-2j * np.pi * 2.4e9 * delay_s)


def walk(seed, instants=200):
    rng = np.random.default_rng(seed)
    tx, start = rng.uniform([1, 1, 2.8], [18, 11, 2.9]), rng.uniform([1, 1, 1], [17, 10, 1.1])
    columns = [room(tx, start + [1.2 * step / 1000, 0, 0]) for step in range(instants)]
    return np.array([c[0] for c in columns]), np.array([c[1] for c in columns])


def band_nmse_db(delay_s, gain, tap_delay_s, tap_gain):
    """The error measured on a fine comb of frequencies: no closed form."""
    f = (np.arange(4000) + 0.5) / 4000 * BAND_HZ - BAND_HZ / 2
    h = np.exp(-2j * np.pi * np.outer(f, delay_s)) @ gain
    error = h - np.exp(-2j * np.pi * np.outer(f, tap_delay_s)) @ tap_gain
    return 10 * np.log10(np.mean(np.abs(error) ** 2) / np.mean(np.abs(h) ** 2))


def test_the_stated_loss_is_that_of_the_frequency_response():
    delay_s, gain = walk(1, 1)
    for taps in (approximate.kmeans(delay_s, gain), grid_fit(delay_s, gain)):
        stated = approximate.loss(delay_s, gain, *taps, BAND_HZ)
        assert stated.nmse_db[0] == pytest.approx(band_nmse_db(delay_s[0], gain[0], taps[0][0], taps[1][0]), abs=0.01)


def grid_fit(delay_s, gain, taps=4):
    support, gains = approximate.least_squares(delay_s, gain, BAND_HZ, taps)
    return np.broadcast_to(support * 1e-8, gains.shape), gains


def test_four_paths_on_the_grid_are_kept_whole_by_both_methods():
    delay_s = np.array([[0.0, 1.28e-6, 2e-6, 4e-6]])
    gain = 10 ** (np.array([[-3, -20, -15, -8]]) / 20) * np.exp(1j * np.arange(4))
    for found_s, found in (approximate.kmeans(delay_s, gain), grid_fit(delay_s, gain)):
        np.testing.assert_allclose(found_s, delay_s, atol=1e-15)
        np.testing.assert_allclose(found, gain, rtol=0.02)


def test_kmeans_is_the_best_of_all_splits_into_intervals():
    rng = np.random.default_rng(5)
    for _ in range(30):
        delay_s, weight = np.sort(rng.uniform(0, 5e-6, 9)), rng.uniform(0.1, 1, 9)

        def cost(borders, delay_s=delay_s, weight=weight):
            parts = [(delay_s[a:b], weight[a:b]) for a, b in itertools.pairwise(borders)]
            return sum(np.sum(w * (d - np.average(d, weights=w)) ** 2) for d, w in parts)

        best = min(cost((0, *inner, 9)) for inner in itertools.combinations(range(1, 9), 3))
        assert cost(approximate._best_intervals(delay_s, weight, 4)) == pytest.approx(best, rel=1e-9)


@pytest.mark.parametrize("taps", [2, 3])
def test_the_support_found_captures_nearly_what_the_best_of_all_supports_does(taps):
    shortfall_db = []
    for seed in range(6):
        delay_s, gain = walk(seed, 1)
        keep = np.argsort(-np.abs(gain[0]))[:8]
        delay_s, gain = delay_s[:, keep], gain[:, keep]
        indices = np.arange(int(delay_s.min() / 1e-8) - 2, int(delay_s.max() / 1e-8) + 4)
        indices = indices[indices >= 0]
        f = (np.arange(400) + 0.5) / 400 * BAND_HZ - BAND_HZ / 2
        basis, h = (
            np.exp(-2j * np.pi * np.outer(f, indices * 1e-8)),
            np.exp(-2j * np.pi * np.outer(f, delay_s[0])) @ gain[0],
        )
        best = min(
            np.linalg.lstsq(basis[:, list(s)], h, rcond=None)[1][0] for s in itertools.combinations(range(len(indices)), taps)
        )
        best_db = 10 * np.log10(best / np.sum(np.abs(h) ** 2))
        found = grid_fit(delay_s, gain, taps)
        scaled = 10 ** (
            approximate.loss(delay_s, gain, *found, BAND_HZ).nmse_db[0] / 10
        )  # to the paths' power: 2 - 2 sqrt(share)
        shortfall_db.append(10 * np.log10(1 - (1 - scaled / 2) ** 2) - best_db)
    assert max(shortfall_db) < 0.5 and np.median(shortfall_db) < 0.05


def test_in_a_room_a_held_support_loses_little_to_one_chosen_anew_and_beats_clustering():
    held, anew, clustered = [], [], []
    for seed in range(8):
        delay_s, gain = walk(seed)
        held += list(approximate.loss(delay_s, gain, *grid_fit(delay_s, gain), BAND_HZ).nmse_db[::50])
        for instant in range(0, len(gain), 50):
            part = delay_s[instant : instant + 1], gain[instant : instant + 1]
            anew += list(approximate.loss(*part, *grid_fit(*part), BAND_HZ).nmse_db)
            clustered += list(approximate.loss(*part, *approximate.kmeans(*part), BAND_HZ).nmse_db)
    assert np.median(held) < -12 and np.median(held) - np.median(anew) < 2.0
    assert np.median(clustered) > np.median(held) + 4


def test_power_and_delay_spread_errors_have_their_sign():
    delay_s, gain = np.array([[0.0, 2e-6]]), np.array([[1.0, 1.0]])
    lost = approximate.loss(delay_s, gain, np.array([[0.0]]), np.array([[1.0]]), BAND_HZ)
    assert lost.power_error_db[0] == pytest.approx(-3.01, abs=0.01)
    assert lost.delay_spread_error_s[0] == pytest.approx(-1e-6)
    assert approximate.delay_spread_s(delay_s, gain)[0] == pytest.approx(1e-6)


def test_moving_delays_onto_the_grid_makes_one_path_one_tap():
    delay_s, gain = np.array([[3.37e-7]]), np.array([[0.5j]])
    assert abs(approximate.best_shift_s(delay_s, gain, BAND_HZ)) <= 5.0e-9
    moved_s = delay_s + approximate.best_shift_s(delay_s, gain, BAND_HZ)
    assert approximate.loss(moved_s, gain, *approximate.kmeans(moved_s, gain), BAND_HZ).nmse_db[0] < -80
    assert approximate.loss(delay_s, gain, *approximate.kmeans(delay_s, gain), BAND_HZ).nmse_db[0] > -20


def test_power_in_the_band_does_not_jump_where_another_support_begins():
    """Held against the frequency response on a fine comb: what the taps' power steps by beyond what the paths' does."""

    def power_db(delay_s, gain):
        f = (np.arange(1000) + 0.5) / 1000 * BAND_HZ - BAND_HZ / 2
        return 10 * np.log10(np.mean(np.abs(np.exp(-2j * np.pi * np.outer(f, delay_s)) @ gain) ** 2))

    steps_db = []
    for seed in (0, 3):
        delay_s, gain = walk(seed, 60)
        errors_db = []
        for part in (slice(0, 30), slice(30, 60)):
            shifted_s = delay_s[part] + approximate.best_shift_s(delay_s[part], gain[part], BAND_HZ)
            taps_s, taps = grid_fit(shifted_s, gain[part])
            errors_db += [power_db(taps_s[k], taps[k]) - power_db(shifted_s[k], gain[part][k]) for k in (0, -1)]
        steps_db.append(abs(errors_db[2] - errors_db[1]))
    assert max(steps_db) < 0.01
