# SPDX-License-Identifier: GPL-3.0-or-later
"""A transmitter that runs out of samples: the jump of its code is found, and sounded around; a channel's changes are none."""

import numpy as np
import pytest
from gr_cast.signals import codes
from gr_cast.signals.recording import Recording
from gr_cast.signals.waveform import Waveform
from gr_cast.sounding.sound import sound

CODE = codes.glfsr(8)
WAVEFORM = Waveform(samples=CODE.astype(np.complex64), name="glfsr:8")
TAPS = {3: 1.0, 67: 0.2j, 120: -0.4}
RATE_HZ = 1e6


def received(periods, noise_db, underruns=(), seed=0, offset_hz=0.0, taps=TAPS):
    """What a receiver gets of a code that stands still for some samples at each of `underruns` (sample, samples)."""
    n = np.arange(255 * periods)
    place = n.copy()
    for at, lost in underruns:
        place -= lost * (n >= at)
    y = sum(gain * CODE[(place - delay) % 255] for delay, gain in taps.items())
    rng = np.random.default_rng(seed)
    noise = np.sqrt(10 ** (noise_db / 10) / 2) * (rng.normal(size=len(n)) + 1j * rng.normal(size=len(n)))
    y = y * np.exp(2j * np.pi * offset_hz / RATE_HZ * n) + noise
    return Recording(samples=y.astype(np.complex64), sample_rate_hz=RATE_HZ, center_frequency_hz=1e9)


@pytest.mark.parametrize("noise_db", [-40.0, 0.0, 10.0])
@pytest.mark.parametrize("share", [0.1, 0.37, 0.8])
@pytest.mark.parametrize("lost", [40, 5000])
def test_an_underrun_is_told_with_its_place_and_does_no_harm(noise_db, share, lost):
    at = int(255 * 400 * share) + 91
    result = sound(received(400, noise_db, [(at, lost)], offset_hz=333.0), WAVEFORM)
    ((time_s, later),) = result.jumps
    assert (later - lost) % 255 == 0 and abs(later) <= 127
    assert time_s == pytest.approx(at / RATE_HZ, abs=2.1 * 255 / RATE_HZ)
    assert len(result.taps.delay_samples) == len(TAPS)
    moved = lost if share < 0.5 else 0  # the longer side is sounded
    expected = np.sort((np.array(list(TAPS)) + moved) % 255)
    assert np.sort(result.taps.delay_samples % 255) == pytest.approx(expected, abs=0.3)
    assert np.sort(np.abs(result.taps.gain[:, 0])) == pytest.approx(np.sort(np.abs(list(TAPS.values()))), rel=0.1)
    assert any("code jumps by" in warning for warning in result.warnings)


def test_several_underruns_are_all_told():
    underruns = [(20_000, 11), (60_000, 100), (70_000, 7)]
    result = sound(received(400, -10.0, underruns), WAVEFORM)
    assert [later for _, later in result.jumps] == [11, 100, 7]


@pytest.mark.parametrize("noise_db", [-60.0, 0.0, 20.0])
def test_a_code_that_does_not_jump_is_left_alone(noise_db):
    for seed in range(5):
        assert sound(received(300, noise_db, seed=seed), WAVEFORM).jumps == ()


def test_a_path_that_appears_and_another_that_fades_are_no_jump():
    one, two = received(150, -30.0, taps={3: 1.0, 60: 0.1}), received(150, -30.0, taps={3: 0.3, 60: 0.4, 90: 0.5}, seed=2)
    both = Recording(samples=np.concatenate([one.samples, two.samples]), sample_rate_hz=RATE_HZ)
    assert sound(both, WAVEFORM).jumps == ()


def test_a_code_that_drifts_is_no_jump():
    n = np.arange(255 * 400)
    drift = 20.0 * n / len(n)  # samples, over the recording
    spectrum, f = np.fft.fft(CODE), np.fft.fftfreq(255)
    y = sum(s * np.exp(2j * np.pi * k * (n - 3 - drift)) for s, k in zip(spectrum / 255, f, strict=True))
    assert sound(Recording(samples=y.astype(np.complex64), sample_rate_hz=RATE_HZ), WAVEFORM).jumps == ()
