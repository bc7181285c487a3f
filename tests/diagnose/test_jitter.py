# SPDX-License-Identifier: GPL-3.0-or-later
"""An oscillator's phase of which a part is too fast to be followed: noise across the signal, in the signal's own band."""

import numpy as np
import pytest
import yaml
from conftest_world import RATE_HZ, noise, sent_once
from gr_cast.diagnose import diagnose, read_case
from gr_cast.signals import codes, recording
from scipy import signal

SLOW, FAST = (1 / 20_000, 20 / 20_000), (0.02, 0.06)  # cycles per sample


def _course(rng, count, rms, low, high):
    f = np.abs(np.fft.fftfreq(count))
    course = np.fft.ifft(np.fft.fft(rng.normal(size=count)) * ((f >= low) & (f <= high))).real
    return course * rms / np.std(course)


@pytest.fixture
def jittery(world, tmp_path):
    """fast (rad), interference (rms) → the effects that are found."""

    def found(fast, interference):
        world.taps, world.code["samples_per_chip"] = world.taps[:1], 4
        world.x = codes.from_spec(world.code).astype(complex)
        rng, n = np.random.default_rng(3), len(world.n)
        phase = _course(rng, n, 0.05, *SLOW) + _course(rng, n, max(fast, 1e-12), *FAST)
        band = np.abs(np.fft.fftfreq(n)) < 0.06
        hiss = np.fft.ifft(np.fft.fft(noise(rng, n)) * band)
        hiss *= interference / np.sqrt(np.mean(np.abs(hiss) ** 2))
        y = world.noisy(world.clean() * np.exp(1j * phase) + hiss)
        return diagnose(read_case(world.write(tmp_path / "case", y)), budget_s=3000).document["effects"]

    return found


@pytest.mark.parametrize("fast", [0.010, 0.016])
def test_a_phase_too_fast_to_be_followed_is_phase_noise_and_neither_a_fading_tap_nor_interference(jittery, fast):
    (told,) = jittery(fast, 0.0)
    assert told["family"] == "phase_noise"
    assert told["parameters"]["rms_rad"]["value"] == pytest.approx(np.hypot(0.05, fast), rel=0.03)


def test_interference_in_the_signals_band_beside_phase_noise_is_interference(jittery):
    assert {e["family"] for e in jittery(0.0, 0.006)} == {"phase_noise", "narrowband_interference"}


def test_what_a_fast_phase_adds_in_the_signals_band_is_no_colour_of_a_receivers_filter(world, tmp_path):
    """A shaped waveform, whose band the filter would have to hold to a hundredth of a decibel."""
    world.taps, world.code["samples_per_chip"] = world.taps[:1], 4
    code = codes.from_spec(world.code).astype(complex)
    world.x = signal.filtfilt(*signal.butter(4, 0.5), np.tile(code, 3))[len(code) : 2 * len(code)]
    rng, n = np.random.default_rng(3), len(world.n)
    phase = _course(rng, n, 0.05, *SLOW) + _course(rng, n, 0.03, *FAST)
    folder = world.write(tmp_path / "case", world.noisy(world.clean() * np.exp(1j * phase)))
    recording.write(folder / "sent", world.x, sample_rate_hz=RATE_HZ)
    twin = yaml.safe_load((folder / "twin.yaml").read_text()) | {"waveforms": {"w1": {"file": "sent", "repeat": True}}}
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin))
    told = [e["family"] for e in diagnose(read_case(folder), budget_s=3000).document["effects"]]
    assert "phase_noise" in told and "front_end_filter" not in told


@pytest.mark.parametrize(("corner", "rms_rad"), [(0.025, 0.1), (0.025, 0.03), (10.0, 0.05)], ids=["loop", "weak", "white"])
def test_a_phase_of_which_nothing_can_be_followed_is_phase_noise_and_no_law_of_the_noise(world, tmp_path, corner, rms_rad):
    rng, n = np.random.default_rng(8), len(world.n)
    phase = np.fft.ifft(np.fft.fft(rng.normal(size=n)) / np.hypot(1, np.fft.fftfreq(n) / corner)).real  # cycles per sample
    y = world.noisy(world.clean() * np.exp(1j * phase * rms_rad / np.std(phase)))
    document = diagnose(read_case(world.write(tmp_path / "case", y)), budget_s=3000).document
    (told,) = document["effects"]
    assert document["verdict"] == "identified" and told["family"] == "phase_noise"
    assert told["parameters"]["rms_rad"]["value"] == pytest.approx(rms_rad, rel=0.05)


def test_noise_that_follows_the_signal_has_no_direction_and_is_no_phase_noise(world, tmp_path):
    y = world.clean()
    y = world.noisy(y + 0.05 * np.abs(y) * noise(np.random.default_rng(8), len(y)))
    (told,) = diagnose(read_case(world.write(tmp_path / "case", y)), budget_s=3000).document["effects"]
    assert told["family"] == "signal_dependent_noise"


@pytest.mark.parametrize("rails", [0.04, 0.09])
def test_rails_which_eat_noise_along_the_signal_are_no_phase_noise(tmp_path, rails):
    rng, n = np.random.default_rng(8), 20_000
    x = noise(rng, n)
    y = 0.1 * x + noise(rng, n, 0.01)
    y = np.clip(y.real, -rails, rails) + 1j * np.clip(y.imag, -rails, rails)
    told = [e["family"] for e in diagnose(sent_once(tmp_path, y, x), budget_s=3000).document["effects"]]
    assert told == ["adc_clipping"]
