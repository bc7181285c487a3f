# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gr_cast.signals import codes
from gr_cast.signals.recording import Recording
from gr_cast.signals.waveform import Waveform
from gr_cast.sounding.doppler import tap_doppler
from gr_cast.sounding.sound import SoundingOptions, sound

CODE = codes.glfsr(8)
WAVEFORM = Waveform(samples=CODE.astype(np.complex64), name="glfsr:8")
RATE_HZ = 10e6
TIME = 255.0 * np.arange(2000)


def line(frequency, snr_db, seed, time=TIME):
    rng = np.random.default_rng(seed)
    noise = 10 ** (-snr_db / 10)
    scatter = np.sqrt(noise / 2) * (rng.normal(size=time.size) + 1j * rng.normal(size=time.size))
    return np.exp(2j * np.pi * (frequency * time + rng.random())) + scatter, noise


def moving(taps, periods, noise_db=-60.0, seed=1, hold_samples=1, offset_hz=0.0):
    """Received samples of taps {delay: (gain in dB, Doppler in Hz)}, whose phases are held for so many samples."""
    rng = np.random.default_rng(seed)
    n = np.arange(255 * periods)
    held = n // hold_samples * hold_samples
    turned = sum(
        10 ** (gain_db / 20) * np.exp(2j * np.pi * doppler_hz / RATE_HZ * held) * np.tile(np.roll(CODE, delay), periods)
        for delay, (gain_db, doppler_hz) in taps.items()
    )
    noise = rng.standard_normal((2, n.size)) * np.sqrt(10 ** (noise_db / 10) / 2)
    samples = turned * np.exp(2j * np.pi * offset_hz / RATE_HZ * n) + noise[0] + 1j * noise[1]
    return Recording(samples=samples.astype(np.complex64), sample_rate_hz=RATE_HZ)


@pytest.mark.parametrize("snr_db", [20, 0, -5])
def test_a_line_is_found_within_its_deviation_and_near_the_bound(snr_db):
    found = [tap_doppler(*line(-3.3e-4, snr_db, seed), TIME) for seed in range(60)]
    z = [(one.mean + 3.3e-4) / one.std for one in found if one]
    bound = np.sqrt(6 * 10 ** (-snr_db / 10) / TIME.size**3) / (2 * np.pi * 255)  # Rife and Boorstyn 1974
    assert len(z) >= 55 and 0.4 < np.sqrt(np.mean(np.square(z))) < 1.5
    assert np.median([one.std for one in found if one]) < 6 * bound


def test_of_two_lines_the_mean_is_weighted_by_power_and_the_spread_is_their_own():
    both = line(1e-4, 40, 1)[0] + 0.5 * line(1.5e-4, 40, 2)[0]
    found = tap_doppler(both, 1e-4, TIME)
    assert found.mean == pytest.approx(1.1e-4, rel=0.02) and found.spread == pytest.approx(2e-5, rel=0.1)


def test_a_gap_does_not_turn_a_tap():
    time = TIME.copy()
    time[900:] += 12_345
    track, noise = line(2e-4, 10, 3, time)
    found = tap_doppler(track, noise, time)
    assert abs(found.mean - 2e-4) < 5 * found.std < 1e-7


def test_of_noise_no_doppler_is_told():
    rng = np.random.default_rng(4)
    told = [tap_doppler(rng.normal(size=500) + 1j * rng.normal(size=500), 2.0, 255.0 * np.arange(500)) for _ in range(100)]
    assert sum(one is not None for one in told) == 0


def test_every_tap_of_a_moving_channel_has_its_own_doppler():
    taps = {20: (0.0, 110.0), 60: (-10.0, -70.0), 200: (-20.0, 0.0)}
    result = sound(moving(taps, 1500), WAVEFORM, SoundingOptions(carrier_offset_hz=0.0))
    assert result.is_moving and result.blocks > 1 and result.offset.known
    assert np.rint(result.taps.delay_samples).tolist() == list(taps)
    found_hz = [one.mean * RATE_HZ for one in result.doppler]
    assert found_hz == pytest.approx([110.0, -70.0, 0.0], abs=0.5)
    assert 10 * np.log10(result.taps.power) == pytest.approx([0, -10, -20], abs=0.05)


def test_without_a_known_carrier_dopplers_count_from_what_was_taken_out():
    result = sound(moving({20: (0.0, 110.0), 60: (-10.0, -70.0)}, 1500, offset_hz=4000.0), WAVEFORM)
    carrier_hz = result.offset.cycles_per_sample * RATE_HZ
    assert result.is_moving and not result.offset.known
    assert [carrier_hz + one.mean * RATE_HZ for one in result.doppler] == pytest.approx([4110.0, 3930.0], abs=0.5)


@pytest.mark.parametrize("noise_db", [-60.0, 0.0])
@pytest.mark.parametrize("known_hz", [None, 0.0])
def test_a_channel_that_stands_still_does_not_move(noise_db, known_hz):
    still = {20: (0.0, 0.0), 60: (-10.0, 0.0), 200: (-20.0, 0.0)}
    for seed in range(2):
        options = SoundingOptions(carrier_offset_hz=known_hz)
        assert not sound(moving(still, 500, noise_db, seed), WAVEFORM, options).is_moving


@pytest.mark.parametrize("seed", range(3))
def test_taps_that_jump_within_a_period_leave_no_others_behind(seed):
    """Held for 1 ms, as an emulator updates: at 60 dB over the noise the jumps leave what no code adds up to."""
    rng = np.random.default_rng(seed)
    taps = {20: (0.0, 150.0 * rng.uniform(-1, 1)), 60: (-6.0, 150.0 * rng.uniform(-1, 1)), 100: (-12.0, 90.0)}
    result = sound(moving(taps, 2000, seed=seed, hold_samples=10_000), WAVEFORM, SoundingOptions(carrier_offset_hz=0.0))
    assert np.rint(result.taps.delay_samples).tolist() == list(taps)
    assert 10 * np.log10(result.taps.power.min()) > result.smallest_path_gain_db


def test_two_samples_tell_nothing_and_of_three_pairs_on_the_line_is_told():
    steady = np.ones(3, complex)
    assert tap_doppler(steady[:1], 1e-6, TIME[:1]) is None
    assert tap_doppler(steady[:2], 1e-6, TIME[:2]) is None
    turned = np.exp(2j * np.pi * 1e-3 * TIME[:3])
    found = tap_doppler(turned, 1e-6, TIME[:3])
    assert found.mean == pytest.approx(1e-3, rel=1e-6) and found.spread == 0
    assert tap_doppler(turned, 1e-6, TIME[:3] * [1, 1, 3]) is None  # a gap leaves one pair


@pytest.mark.parametrize(("share", "told"), [(0.99, True), (1.01, False)])
def test_power_is_five_deviations_of_the_noise_or_no_doppler_is_told(share, told):
    noise = share * np.sqrt(TIME.size) / 5
    track = np.sqrt(1 + noise) * np.exp(2j * np.pi * 1e-4 * TIME)
    assert (tap_doppler(track, noise, TIME) is not None) == told


@pytest.mark.parametrize(("noise", "lag"), [(2.0, 1), (0.1, 2)])
def test_what_gaps_leave_few_pairs_of_is_looked_at_only_where_it_tells_the_phase_within_half_a_radian(noise, lag):
    """Every other step is a gap but for three places, which alone have pairs two steps apart."""
    step = np.where(np.arange(1999) % 2, 5000.0, 255.0)
    step[[101, 901, 1501]] = 255.0
    time = np.concatenate([[0.0], np.cumsum(step)])
    pairs = {1: (step == 255).sum(), 2: ((step[1:] == 255) & (step[:-1] == 255)).sum()}[lag]
    track = np.sqrt(1 + noise) * np.exp(2j * np.pi * 1e-5 * time)
    found = tap_doppler(track, noise, time)
    law = np.sqrt((noise**2 + 2 * noise) / pairs / 2) / (2 * np.pi * lag * 255)
    assert found.std == pytest.approx(law, rel=1e-6) and found.mean == pytest.approx(1e-5, rel=1e-6)


def test_a_lines_deviation_is_that_of_its_longest_lag():
    """Without spread: √((n² + 2 p n) / 2 m) / p over 2π·lag·step, of the longest lag of powers of two up to half of all."""
    track, noise = line(2e-5, 10, 5)
    found = tap_doppler(track, noise, TIME)
    lag, pairs = 512, 2000 - 512
    lag, pairs = (lag, pairs) if lag * 2 > 1000 else (1024, 976)
    power = np.mean(np.abs(track) ** 2) - noise
    law = np.sqrt((noise**2 + 2 * power * noise) / pairs / 2) / power / (2 * np.pi * lag * 255)
    assert found.std == pytest.approx(law, rel=1e-6) and found.spread == 0
