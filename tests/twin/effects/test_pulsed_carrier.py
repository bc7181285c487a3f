# SPDX-License-Identifier: GPL-3.0-or-later
"""Pulses of a wave are found with their beat, width and frequency, and a twin plays them with their power."""

import numpy as np
import pytest
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.pulsed_carrier import Train, polished, trains

COUNT = 60_000


def noise(rng):
    return (rng.normal(size=COUNT) + 1j * rng.normal(size=COUNT)) / np.sqrt(2)


@pytest.mark.parametrize(
    "train, power",
    [
        (Train(period=5113.0, first=700.0, width=300.0, frequency=0.21, sweep=0.0), 0.1),
        (Train(period=911.0, first=100.0, width=40.0, frequency=-0.33, sweep=0.0), 0.7),
        (Train(period=17_000.0, first=3000.0, width=900.0, frequency=0.05, sweep=2e-5), 0.1),
    ],
)
def test_a_train_is_found_below_the_noise(train, power):
    rng, index = np.random.default_rng(2), np.arange(COUNT)
    turns = np.exp(2j * np.pi * rng.random(COUNT))[np.maximum(train.pulses(index)[0], -1).astype(int)]
    (found,) = trains(noise(rng) + np.sqrt(power) * turns * train.wave(index), 1.0)
    assert found.period == pytest.approx(train.period, abs=0.3 * train.width * train.period / COUNT + 0.2)
    assert found.width == pytest.approx(train.width, rel=0.15)
    assert found.frequency == pytest.approx(train.frequency, abs=1 / train.width)


@pytest.mark.parametrize(
    ("period", "width", "sweep"),
    [
        (1150.596, 175.4, 0.0),
        (1150.596, 175.4, 4.57e-4),
        (1150.596, 175.4, -7.7e-4),
        (2530.6, 1214.7, 2.05e-4),
        (5853.9, 2517.2, 5.77e-5),
    ],
)
def test_pulses_far_above_the_noise_leave_no_more_than_it(period, width, sweep):
    train, index = Train(period=period, first=731.3, width=width, frequency=0.2371, sweep=sweep), np.arange(COUNT)
    rng = np.random.default_rng(5)
    number = np.maximum(train.pulses(index)[0], -1).astype(int)
    pulses = 100.0 * np.exp(2j * np.pi * rng.random(COUNT))[number] * train.wave(index)  # 40 dB
    y = pulses + noise(rng)
    tame = y * np.minimum(1.0, 3.0 / np.abs(y))
    found = polished(y, trains(tame, 1.0)[0])
    number, wave = np.maximum(found.pulses(index)[0], -1).astype(int), found.wave(index)
    own = [number == k for k in np.unique(number[wave != 0])]
    left = y - sum(o * wave * np.vdot(wave[o], y[o]) / np.vdot(wave[o], wave[o]) for o in own)
    assert np.mean(np.abs(left) ** 2) < 1.05


@pytest.mark.parametrize("seed", range(4))
def test_noise_has_no_train(seed):
    assert trains(noise(np.random.default_rng(seed)), 1.0) == []


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("width", [0.04, 0.005])
def test_a_steady_band_of_noise_has_no_train(width, seed):
    rng = np.random.default_rng(seed)
    band = np.fft.ifft((np.abs(np.fft.fftfreq(COUNT) - 0.21) < width / 2) * np.fft.fft(noise(rng)))
    assert trains(noise(rng) + 10 * band, 1.0) == []


def test_a_twin_plays_pulses_with_the_power_and_the_gate_that_it_tells():
    class Scene:
        sample_rate_hz, wanted_rms, rms, count, span, index = 1e6, 0.5, 0.5, COUNT, COUNT, np.arange(COUNT)

    parameters = {"period_s": 2e-3, "duty_cycle": 0.1, "power_dbc": -20.0}
    effect = FAMILIES["pulsed_interference"].parse(Scene, parameters, {"first_s": 3e-4, "carrier_hz": 1e5})
    family = FAMILIES[effect.family]
    wave = family._wave(Scene, family.played(Scene, effect, np.random.default_rng(1)))
    on = np.abs(wave) > 0
    assert on.mean() == pytest.approx(0.1, rel=0.02)
    assert np.mean(np.abs(wave[on]) ** 2) == pytest.approx(0.5**2 * 0.01, rel=1e-6)
    assert np.flatnonzero(on)[0] == 300
