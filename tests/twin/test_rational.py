# SPDX-License-Identifier: GPL-3.0-or-later
"""A ratio of polynomials against SciPy's filters, whose poles are told from a signal and what became of it."""

import numpy as np
import pytest
from gr_cast.twin.rational import Ratio, read_off, stable
from scipy import signal

DESIGNS = {"Butterworth": signal.butter(4, 0.4), "Chebyshev": signal.cheby1(5, 1.0, 0.4), "notch": signal.iirnotch(0.12, 8.0)}


def noise(rng, n, rms=1.0):
    return rms / np.sqrt(2) * (rng.normal(size=n) + 1j * rng.normal(size=n))


@pytest.mark.parametrize("design", DESIGNS)
def test_the_poles_of_a_design_are_read_off_what_it_leaves_of_a_signal(design):
    rng, (b, a) = np.random.default_rng(7), DESIGNS[design]
    sent = noise(rng, 16_000)
    heard = signal.lfilter(b, a, sent) + noise(rng, len(sent), 0.01)
    gain = np.vdot(sent, heard) / np.vdot(sent, sent)
    use = np.arange(len(sent)) % 4000 > 400  # held-out stretches tell nothing
    found = read_off(gain * sent, (heard - gain * sent) * use, use)
    frequency = np.linspace(-0.5, 0.5, 201)
    told = gain * found[0].response(frequency)
    want = signal.freqz(b, a, 2 * np.pi * frequency)[1]
    assert np.abs(told - want).max() < 0.01 * np.abs(want).max()
    assert len(found[0].feedback) == len(a)


def test_noise_alone_is_no_filter():
    rng = np.random.default_rng(8)
    assert read_off(noise(rng, 16_000), noise(rng, 16_000), np.ones(16_000, bool)) == []


def test_a_wave_that_goes_round_is_one_that_has_gone_round_for_long():
    rng, (b, a) = np.random.default_rng(9), DESIGNS["Chebyshev"]
    wave, ratio = noise(rng, 510), Ratio(low=0, taps=b, feedback=a)
    assert np.allclose(ratio.around(wave), signal.lfilter(b, a, np.tile(wave, 4))[-510:])
    early = Ratio(low=-3, taps=b, feedback=a)
    assert np.allclose(early.around(wave), np.roll(ratio.around(wave), -3))
    assert np.allclose(early.behind(wave)[:-3], ratio.behind(wave)[3:])


def test_a_pole_outside_the_circle_is_mirrored_into_it_and_leaves_the_magnitude():
    outside = np.poly([1.25 * np.exp(0.3j), 0.5])
    w = np.linspace(0, np.pi, 50)
    mirrored = stable(outside)
    assert np.abs(np.roots(mirrored)).max() == pytest.approx(0.8)
    apart = np.abs(signal.freqz(1, outside, w)[1]) / np.abs(signal.freqz(1, mirrored, w)[1])
    assert np.ptp(apart) < 1e-9
