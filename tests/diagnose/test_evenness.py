# SPDX-License-Identifier: GPL-3.0-or-later
"""Amplitudes more even than noise: another network in the signal's own band, and nothing that noise itself is."""

import numpy as np
import pytest
from gr_cast.diagnose import diagnose, read_case
from gr_cast.diagnose.evenness import beats, evenness
from scipy import stats


def _noise(rng, count, taps=(1.0,)):
    white = rng.normal(size=count + len(taps) - 1) + 1j * rng.normal(size=count + len(taps) - 1)
    return np.convolve(white, taps, "valid")


def _qpsk(rng, count, samples_per_symbol):
    return np.exp(0.5j * np.pi * rng.integers(0, 4, count))[(np.arange(count) / samples_per_symbol).astype(int)]


@pytest.mark.parametrize("taps", [(1.0,), np.hanning(9)])
def test_how_even_noise_is_varies_as_its_colour_lets_it(taps):
    """White or filtered, and with holes: the standard scores of 200 draws are normal."""
    rng, inside = np.random.default_rng(5), np.arange(4000) % 50 < 40
    scores = [lack / std for lack, std in (evenness(_noise(rng, 4000, taps), inside) for _ in range(200))]
    assert stats.kstest(scores, "norm").pvalue > 1e-3


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_signal_of_one_amplitude_lacks_the_square_of_its_share(share):
    rng, inside = np.random.default_rng(6), np.ones(100_000, bool)
    r = np.sqrt((1 - share) / 2) * _noise(rng, len(inside)) + np.sqrt(share) * _qpsk(rng, len(inside), 3.1)
    lack, std = evenness(r, inside)
    assert abs(lack - share**2) < 5 * std


@pytest.mark.parametrize("there", [False, True])
def test_another_network_in_the_whole_band_is_left_unexplained(world, tmp_path, monkeypatch, there):
    """A twin that says nothing of its noise: power tells nothing, only how even it is."""
    rng = np.random.default_rng(7)
    other = _qpsk(rng, len(world.n), 1.0) if there else _noise(rng, len(world.n)) / np.sqrt(2)
    y = world.noisy(world.clean()) + 0.02 * other
    twin = world.twin()
    del twin["noise"]
    monkeypatch.setattr(world, "twin", lambda: twin)
    said = diagnose(read_case(world.write(tmp_path / "case", y))).document
    assert said["verdict"] == ("unexplained" if there else "no_mismatch")
    assert any("even" in w["test"] for w in said["residual"]["where"]) == there


def test_the_power_of_noise_beats_as_chance_says_and_that_of_symbols_at_their_rate():
    rng, inside = np.random.default_rng(8), np.arange(4000) % 50 < 45
    by_chance = [beats(_noise(rng, 4000, np.hanning(5)), inside) for _ in range(200)]
    assert np.mean(np.array(by_chance) < 0.1) < 0.2 and min(by_chance) > 1e-4
    symbols = np.zeros(4000, complex)
    symbols[::3] = _qpsk(rng, 1334, 1.0)
    assert beats(np.convolve(symbols, np.hanning(7), "same") + 0.3 * _noise(rng, 4000), inside) < 1e-6
