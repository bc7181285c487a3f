# SPDX-License-Identifier: GPL-3.0-or-later
"""The mean of a tap that fades is a part of its fading, as large as Clarke (1968) has it over a recording, and no more."""

import numpy as np
import pytest
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start
from scipy import fft

FADING, ERROR = FAMILIES["tap_fading"], FAMILIES["tap_gain_error"]
ORDERS, STEPS = 40, 2000


class Scene:
    sample_rate_hz, duration_s, taps = 1e6, 0.1, ()


def _scene(taps):
    scene = Scene()
    scene.taps = [type("Tap", (), {"delay": 10.0 * k, "source": 0})() for k in range(taps)]
    return scene


def _faded(rng, power, doppler_hz):
    """(fading effect without its mean, mean) of a course by many rays from all around."""
    t, angle = np.arange(STEPS) / STEPS * Scene.duration_s, rng.uniform(0, 2 * np.pi, 64)
    rays = np.exp(2j * np.pi * (doppler_hz * np.cos(angle) * t[:, None] + rng.uniform(size=64)))
    course = np.sqrt(power / 64) * rays.sum(axis=1)
    c = fft.dct(course.real, axis=0) / STEPS + 1j * fft.dct(course.imag, axis=0) / STEPS
    p = np.stack([c.real, c.imag], axis=1)[1 : ORDERS + 1].ravel() / np.sqrt(2)
    return start(FADING, p, aux={"tap": 0}), complex(course.mean())


def _error(gain, tap):
    return start(ERROR, [np.log(abs(gain)), np.angle(gain)], aux={"tap": tap})


@pytest.mark.parametrize("doppler_hz", [5.0, 30.0, 120.0])
def test_its_own_mean_is_a_part_of_a_fading_and_an_error_of_a_decibel_is_not(doppler_hz):
    rng, held, scene = np.random.default_rng(1), 0, _scene(2)
    for _ in range(200):
        fading, mean = _faded(rng, 10**-3.2, doppler_hz)
        held += FADING.holds(scene, fading, _error(1 + mean, 0)) and FADING.holds(scene, fading, _error(1 / (1 + mean), 1))
        assert doppler_hz < 100.0 or not FADING.holds(scene, fading, _error(10 ** (1 / 20), 0))
    assert held > 0.97 * 200


def test_of_three_paths_an_error_of_another_one_is_its_own():
    fading, mean = _faded(np.random.default_rng(1), 10**-3.2, 20.0)
    assert FADING.holds(_scene(3), fading, _error(1 + mean, 0))
    assert not FADING.holds(_scene(3), fading, _error(1 / (1 + mean), 1))
