# SPDX-License-Identifier: GPL-3.0-or-later
"""Signals between their samples: what is worked out block by block is what each sample alone would have."""

import numpy as np
import pytest
from gr_cast.twin.interpolate import turning
from gr_cast.twin.scene import Scene, Source


def times(kind: str) -> np.ndarray:
    u = np.arange(30_011) / 30_000
    jumped = u + 9e-4 * (u > 0.6)  # samples were lost
    return {"even": u, "lost": jumped, "a clock": u * (1 + 1e-4 * u), "one off": u + 1e-9 * (u == u[777]), "few": u[:100]}[kind]


@pytest.mark.parametrize("kind", ["even", "lost", "a clock", "one off", "few"])
@pytest.mark.parametrize("cycles", [0.0, -0.3, 17.25, 12_345.678])
def test_turns_of_many_times_are_those_of_each(kind, cycles):
    u = times(kind)
    np.testing.assert_allclose(turning(cycles, u), np.exp(2j * np.pi * cycles * u), atol=1e-9)
    np.testing.assert_allclose(turning(cycles, u), turning(cycles, u.copy()), atol=1e-9)
    assert turning(cycles, np.float64(0.25)) == pytest.approx(np.exp(0.5j * np.pi * cycles), abs=1e-9)


def test_a_new_array_is_not_taken_for_one_that_is_gone():
    for number in range(40):  # numbers in memory are given again
        u = times("lost" if number % 2 else "even")
        np.testing.assert_allclose(turning(9.5, u), np.exp(19j * np.pi * u), atol=1e-9)
        del u


@pytest.mark.parametrize("length", [510, 511])
def test_whole_samples_late_is_the_same_with_what_is_at_half_the_rate_too(length):
    wave = np.random.default_rng(1).choice([1, -1, 1j, -1j], length)
    sent = Source(name="w1", samples=wave, repeat=True, known=np.ones(length, bool), power=1.0, peak=1.0)
    scene = Scene(name="r", sample_rate_hz=1e6, count=length, sources=[sent], taps=[], transmitters=[], receiver="rx1", anchor=0)
    late = np.fft.ifft(np.fft.fft(wave) * scene.delayed(37.0, length))
    assert late == pytest.approx(np.roll(wave, 37), abs=1e-9)
