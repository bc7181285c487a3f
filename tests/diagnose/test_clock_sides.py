# SPDX-License-Identifier: GPL-3.0-or-later
"""Whose sample clock runs fast: a transmitter's stretches what is sent, so that a path of τ is τ·(1 + ε) of its samples late."""

import numpy as np
import pytest
from gr_cast.diagnose import diagnose, read_case
from gr_cast.signals import recording


def sampled(samples: np.ndarray, at: np.ndarray) -> np.ndarray:
    """A periodic waveform (p,) between its samples, by its Fourier series, where `at` (n,) falls."""
    k = np.fft.fftfreq(len(samples), 1 / len(samples))
    terms = np.fft.fft(samples) / len(samples)
    return sum(np.exp(2j * np.pi * f / len(samples) * at) * term for f, term in zip(k, terms, strict=True) if abs(term) > 1e-12)


@pytest.mark.parametrize("side", ["tx", "rx"])
def test_a_clock_on_either_side_is_a_clock_and_no_path_that_is_late(world, tmp_path, side):
    ppm, world.taps, world.noise_rms = 180e-6, [(0, 1.0), (120, 0.6 * np.exp(0.7j))], 0.003
    band = np.abs(np.fft.fftfreq(len(world.x))) < 0.3
    world.x = np.fft.ifft(np.fft.fft(world.x) * band)
    stretched = lambda d: (world.n - d) * (1 + ppm) if side == "tx" else world.n * (1 + ppm) - d  # noqa: E731
    y = 0.3 * sum(a * sampled(world.x, stretched(d) - 37) for d, a in world.taps)
    twin = world.twin() | {"waveforms": {"w1": {"file": "sent", "repeat": True}}}
    world.twin = lambda: twin
    folder = world.write(tmp_path / "case", world.noisy(y))
    recording.write(folder / "sent", world.x, sample_rate_hz=1e6)
    (told,) = diagnose(read_case(folder), budget_s=300).document["effects"]
    assert told["family"] == "sample_clock_offset"
    clock = told["parameters"]["offset_ppm"]
    assert clock["value"] == pytest.approx(180.0, abs=4 * clock["std"])
    assert told["model"]["at"] == side and told["owner"]["level"] == side
