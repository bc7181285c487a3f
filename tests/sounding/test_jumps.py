# SPDX-License-Identifier: GPL-3.0-or-later
"""A transmitter that runs out of samples: the jump of its code is found, and sounded around; a channel's changes are none."""

import numpy as np
import pytest
from gr_cast.signals import codes
from gr_cast.signals.recording import Recording
from gr_cast.signals.waveform import Waveform
from gr_cast.sounding import jumps
from gr_cast.sounding.correlate import Template
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


def profile(*levels):
    """A delay profile of 255 delays with (delay, power) of its paths."""
    found = np.zeros(255)
    for delay, power in levels:
        found[delay % 255] = power
    return found


PATHS = ((3, 1.0), (67, 0.2), (120, 0.4))


def later(samples):
    return profile(*((delay + samples, power) for delay, power in PATHS))


@pytest.mark.parametrize(
    ("moved", "told"), [(0, 0), (1, 0), (2, 2), (-2, -2), (127, 127), (128, -127), (-1, 0), (254, 0), (257, 2)]
)
def test_a_jump_is_two_samples_at_least_and_half_a_period_at_most(moved, told):
    shift, gain = jumps._shift(later(0), later(moved), jumps.ALIKE)
    assert shift == told and (gain == pytest.approx(1) if told else gain == 0)


@pytest.mark.parametrize(("share", "told"), [(0.91, 50), (0.89, 0)])
def test_profiles_are_one_where_their_coherence_is_nine_tenths(share, told):
    """The other part lies where nothing was: coherence is the share."""
    after = share * later(50) / np.linalg.norm(later(50)) + np.sqrt(1 - share**2) * profile((200, 1.0))
    assert jumps._shift(later(0), after, jumps.ALIKE)[0] == told


@pytest.mark.parametrize(("stays", "told"), [(0.49, 40), (0.51, 0)])
def test_profiles_must_be_twice_as_alike_shifted_as_where_they_stand(stays, told):
    before = profile((0, 1.0))
    after = profile((40, 1.0), (0, stays))
    assert jumps._shift(before, after, jumps.ALIKE_NEAR)[0] == told
    assert jumps._shift(np.zeros(255), after, jumps.ALIKE_NEAR) == (0, 0.0) == jumps._shift(before, np.zeros(255), 0.6)


@pytest.mark.parametrize(("share", "steady"), [(0.30, True), (0.36, False)])
def test_profiles_are_steady_where_each_is_alike_their_sum(share, steady):
    """Of many that are one and another with `share` of its amplitude elsewhere, coherence is √(1 − share²)."""
    profiles = np.tile(later(0), (1000, 1))
    profiles[500] = np.sqrt(1 - share**2) * later(0) + share * np.linalg.norm(later(0)) * profile((200, 1.0))
    coherence = np.sqrt(1 - share**2)
    assert (coherence > 0.95) == steady == jumps.is_steady(profiles.T)


@pytest.mark.parametrize(
    ("places", "count", "run"),
    [([], 10, (0, 10)), ([4], 10, (5, 10)), ([6], 10, (0, 5)), ([3, 9], 12, (4, 8)), ([1, 2], 3, (0, 1)), ([5], 10, (0, 4))],
)
def test_the_longest_stretch_leaves_out_a_period_on_either_side_of_a_jump(places, count, run):
    assert jumps.longest_run([(place, 7) for place in places], count) == slice(*run)


@pytest.mark.parametrize("periods", [3, 4, 5])
@pytest.mark.parametrize("jump", [1, 2])
def test_of_four_periods_a_jump_is_found_and_of_three_none(periods, jump):
    sent = received(periods, -60.0, [(255 * jump, 40)]).samples.reshape(periods, 255)
    found = jumps.code_jumps(sent, Template(CODE))
    assert found == [] if periods < 4 else len(found) <= 1
    if found:
        assert found[0][1] == 40 and abs(found[0][0] - jump) <= 1


@pytest.mark.parametrize("at", [10, 97, 200, 310, 385])
def test_the_period_behind_a_jump_is_found_to_the_period(at):
    sent = received(400, -20.0, [(255 * at + 100, 60)]).samples.reshape(400, 255)
    ((place, shift),) = jumps.code_jumps(sent, Template(CODE))
    assert shift == 60 and at <= place <= at + 1


def test_correlation_in_pieces_is_that_in_one(monkeypatch):
    sent = received(300, -10.0, [(30_000, 60)]).samples.reshape(300, 255)
    whole = jumps.code_jumps(sent, Template(CODE)), jumps._profile(sent, Template(CODE))
    monkeypatch.setattr(jumps, "CHUNK", 255 * 7)
    assert jumps.code_jumps(sent, Template(CODE)) == whole[0]
    np.testing.assert_allclose(jumps._profile(sent, Template(CODE)), whole[1])


def test_of_noise_no_delay_stands_out_and_of_a_path_its_power():
    rng = np.random.default_rng(7)
    noise = rng.normal(size=(50, 255)) + 1j * rng.normal(size=(50, 255))
    assert not jumps._profile(noise, Template(CODE)).any()
    heard = jumps._profile(0.1 * noise + np.roll(CODE, 40), Template(CODE))
    assert np.argmax(heard) == 40 and heard[40] == pytest.approx(255**2, rel=0.02)
    assert np.count_nonzero(heard) < 255
