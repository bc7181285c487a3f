# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gr_cast.signals import codes
from gr_cast.signals.recording import Recording
from gr_cast.sounding.carrier import (
    _noise_by_differences,
    _window_energy,
    find_beyond,
    find_offset,
    find_offset_once,
    strongest_frequency,
)
from gr_cast.sounding.correlate import Template
from gr_cast.sounding.receive import Periods, remove_offset, whole_periods

CODE = codes.glfsr(8)
RATE_HZ = 10e6


def periods_of(offset_hz, count, snr_db, seed=1):
    random = np.random.default_rng(seed)
    n = np.arange(count * 255)
    noise = (random.standard_normal(len(n)) + 1j * random.standard_normal(len(n))) / np.sqrt(2)
    signal = np.tile(np.roll(CODE, 40) + 0.5j * np.roll(CODE, 90), count) * np.exp(2j * np.pi * offset_hz / RATE_HZ * n)
    samples = (10 ** (snr_db / 20) * signal + noise).astype(np.complex64)
    return whole_periods(Recording(samples=samples, sample_rate_hz=RATE_HZ), 255)


@pytest.mark.parametrize("offset_hz", [0.0, 3.0, -450.0, 9_800.0, 19_607.8, -20_000.0, 80_000.0])
@pytest.mark.parametrize(("count", "snr_db"), [(400, -10.0), (60, 10.0), (2, 20.0)])
def test_an_offset_is_found_within_its_reported_deviation(offset_hz, count, snr_db):
    z = []
    for seed in range(8):
        found = find_offset(periods_of(offset_hz, count, snr_db, seed), Template(CODE), max_offset=0.01)
        assert found.found
        z.append((found.cycles_per_sample - offset_hz / RATE_HZ) / found.std_cycles_per_sample)
    assert np.sqrt(np.mean(np.square(z))) < 2.0


def test_an_early_gap_does_not_lead_to_a_sidelobe():
    random = np.random.default_rng(2)
    for offset_hz in (1000.0, 1035.0, -770.0):
        n = np.delete(np.arange(255 * 1500), slice(2600, 2700))
        samples = np.exp(2j * np.pi * offset_hz / 50e6 * n) * np.resize(CODE, 255 * 1500)[n]
        samples += 0.1 * (random.standard_normal(len(n)) + 1j * random.standard_normal(len(n)))
        captures = ({"core:sample_start": 0}, {"core:sample_start": 2600, "cast:lost_samples": 100})
        record = Recording(samples=samples.astype(np.complex64), sample_rate_hz=50e6, captures=captures)
        found = find_offset(whole_periods(record, 255), Template(CODE), max_offset=0.001)
        assert found.cycles_per_sample * 50e6 == pytest.approx(offset_hz, abs=0.1)


@pytest.mark.parametrize("offset_hz", [3967.0, 4272.0])
def test_a_long_waveform_sent_once_is_tracked_to_its_end(offset_hz):
    random = np.random.default_rng(5)
    known = (random.choice([-1, 1], 100_000) + 1j * random.choice([-1, 1], 100_000)) / np.sqrt(2)
    turned = known * np.exp(2j * np.pi * offset_hz / RATE_HZ * np.arange(100_000))
    samples = np.pad(turned, 500) + 0.03 * (random.standard_normal(101_000) + 1j * random.standard_normal(101_000))
    found, start = find_offset_once(samples, known, max_offset=0.002)
    assert start == 500
    assert found.cycles_per_sample * RATE_HZ == pytest.approx(offset_hz, abs=0.1)


def test_noise_alone_has_no_offset():
    assert not any(find_offset(periods_of(0, 20, -200, seed), Template(CODE), max_offset=0.01).found for seed in range(100))


@pytest.mark.parametrize("offset_hz", [0.0, 20_000.0, -47_000.0])
def test_a_waveform_sent_once_is_found_where_it_starts(offset_hz):
    random = np.random.default_rng(3)
    known = codes.zadoff_chu(1023, 5)
    samples = 0.5 * (random.standard_normal(20_000) + 1j * random.standard_normal(20_000))
    samples[15_000:] *= 30  # something louder elsewhere
    samples[7_000:8_023] += known * np.exp(2j * np.pi * offset_hz / RATE_HZ * np.arange(1023))
    found, start = find_offset_once(samples, known, max_offset=0.005)
    assert start == 7_000
    assert found.cycles_per_sample * RATE_HZ == pytest.approx(offset_hz, abs=300)


def test_removing_an_offset_keeps_its_phase_across_rows():
    samples = np.exp(2j * np.pi * 0.013 * np.arange(1_000_000, 1_000_600)).astype(np.complex64).reshape(3, 200)
    still = remove_offset(samples, 0.013, 1_000_000 + 200 * np.arange(3))
    assert np.allclose(still, 1, atol=1e-4)


@pytest.mark.parametrize("offset_hz", [2e6, -1.234e6, 4.9e6])
@pytest.mark.parametrize(("count", "snr_db"), [(400, -10.0), (1, 20.0)])
def test_a_carrier_beyond_the_range_searched_is_named(offset_hz, count, snr_db):
    periods = periods_of(offset_hz, count, snr_db)
    found_hz = find_beyond(periods.samples, Template(CODE)) * RATE_HZ
    assert found_hz == pytest.approx(offset_hz, abs=RATE_HZ / 255)


def test_of_noise_and_of_a_carrier_within_the_range_none_beyond_is_named():
    for seed in range(5):
        assert find_beyond(periods_of(7000.0, 100, -300.0, seed).samples, Template(CODE)) is None
        assert find_beyond(periods_of(7000.0, 100, 0.0, seed).samples, Template(CODE)) is None


@pytest.mark.parametrize("offset_hz", [150.0, -4000.0])
@pytest.mark.parametrize(("count", "snr_db"), [(400, 0.0), (5, 20.0)])
def test_an_offsets_deviation_is_rife_and_boorstyns(offset_hz, count, snr_db):
    """√(6 / (S n³)) / 2π with S of the strongest tap, over n samples: all of the code's energy tells one frequency."""
    found = [find_offset(periods_of(offset_hz, count, snr_db, seed), Template(CODE), max_offset=0.01) for seed in range(12)]
    n = 255 * count
    others = 0.25 if count < 8 else 0.0  # of few periods the second tap's chips are noise
    bound = np.sqrt(6 * (10 ** (-snr_db / 10) + others) / n**3) / (2 * np.pi)
    assert np.mean([one.std_cycles_per_sample for one in found]) == pytest.approx(bound, rel=0.2)
    error = [one.cycles_per_sample - offset_hz / RATE_HZ for one in found]
    assert np.std(error) < 2.5 * bound and all(one.searched >= 0.01 for one in found)


def test_as_far_as_is_asked_for_is_searched_in_half_cycles_of_a_period():
    periods = periods_of(0.0, 40, 20.0)
    for asked in (0.0, 1e-4, 0.0049, 0.02):
        searched = find_offset(periods, Template(CODE), max_offset=asked).searched
        assert searched == pytest.approx(np.ceil(asked * 510) / 510)
    assert find_offset(periods, Template(CODE), max_offset=0.0).cycles_per_sample == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("offset", [0.0, 3e-5, -0.0017])
def test_a_line_in_noise_is_found_with_its_deviation_whatever_its_steps(offset):
    rng = np.random.default_rng(2)
    time = np.cumsum(rng.choice([100, 100, 100, 700], 400))
    z = []
    for _ in range(30):
        track = 2 * np.exp(2j * np.pi * (offset * time + 0.3)) + rng.normal(size=400) + 1j * rng.normal(size=400)
        found, std = strongest_frequency(track * np.exp(-2j * np.pi * offset * time), time, 100, 20_000)
        z.append(found / std)
        law = np.sqrt(2 / (2 * 4 * np.sum((time - time.mean()) ** 2))) / (2 * np.pi)
        assert std == pytest.approx(law, rel=0.25)
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.5


def test_a_line_without_noise_or_of_one_sample_has_a_deviation_that_is_a_number():
    time = 10.0 * np.arange(50)
    found, std = strongest_frequency(np.exp(2j * np.pi * 1e-4 * time), time, 10, 50)
    assert found == pytest.approx(1e-4, rel=1e-4) and 0 < std < 1e-6
    assert np.isfinite(strongest_frequency(np.ones(1, complex), np.zeros(1), 10, 10)).all()


@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_noise_is_what_changes_from_period_to_period_but_a_turn(noise):
    rng = np.random.default_rng(4)
    samples = np.exp(2j * np.pi * 0.1 * np.arange(200))[:, None] * CODE
    samples = samples + np.sqrt(noise / 2) * (rng.normal(size=samples.shape) + 1j * rng.normal(size=samples.shape))
    told = _noise_by_differences(Periods(samples=samples, start_sample=255 * np.arange(200)))
    assert told == pytest.approx(noise, rel=0.02, abs=1e-20)
    for count, is_told in ((3, False), (4, True)):
        some = Periods(samples=samples[:count], start_sample=255 * np.arange(count))
        assert (_noise_by_differences(some) is not None) == is_told
    assert _noise_by_differences(Periods(samples=np.zeros((5, 7), complex), start_sample=np.arange(5))) == 0


@pytest.mark.parametrize("fourfold", [3.5, 4.5])
def test_a_carrier_beyond_stands_out_fourfold_over_what_is_here(fourfold):
    """Two codes at once: one here, and one a whole number of cycles per period away with so many times its power."""
    n = np.arange(255 * 50)
    both = np.tile(CODE, 50) + np.sqrt(fourfold) * np.tile(np.roll(CODE, 60), 50) * np.exp(2j * np.pi * 20 / 255 * n)
    found = find_beyond(both.reshape(50, 255), Template(CODE))
    assert found == (None if fourfold < 4 else pytest.approx(20 / 255, abs=1e-6))


def test_energy_of_every_stretch_is_its_sum():
    x = np.random.default_rng(5).normal(size=(2, 40)).T @ [1, 1j]
    want = [np.sum(np.abs(x[k : k + 7]) ** 2) for k in range(34)]
    np.testing.assert_allclose(_window_energy(x, 7), want)


@pytest.mark.parametrize("lead", [-300, 0, 900])
def test_a_waveform_sent_once_may_begin_before_the_recording_and_is_told_where(lead):
    random = np.random.default_rng(8)
    known = (random.choice([-1, 1], 6000) + 1j * random.choice([-1, 1], 6000)) / np.sqrt(2)
    known[:400] *= 0.1  # of more than 4096 samples the strongest are looked for
    whole = np.concatenate([np.zeros(1000), known, np.zeros(1000)])[1000 - lead :]
    whole = whole + 0.05 * (random.standard_normal(len(whole)) + 1j * random.standard_normal(len(whole)))
    found, start = find_offset_once(whole, known, max_offset=0.001)
    assert start == lead and found.found and found.cycles_per_sample == 0  # within its deviation of none, which it is


def test_a_waveform_that_was_not_sent_is_not_found():
    random = np.random.default_rng(9)
    for _ in range(20):
        noise, known = random.standard_normal((2, 3000)), random.choice([-1.0, 1.0], 500)
        found, _ = find_offset_once(noise[0] + 1j * noise[1], known, max_offset=0.002)
        assert not found.found and found.cycles_per_sample == 0


@pytest.mark.parametrize("steps", [-3, 3])
def test_the_edge_of_what_is_searched_is_searched_for_what_is_sent_once_too(steps):
    random = np.random.default_rng(10)
    known = random.choice([-1.0, 1.0], 512) + 0j
    offset = steps * 0.5 / 512
    samples = np.pad(known * np.exp(2j * np.pi * offset * np.arange(512)), 200)
    samples = samples + 0.01 * (random.standard_normal(912) + 1j * random.standard_normal(912))
    found, start = find_offset_once(samples, known, max_offset=3 * 0.5 / 512)
    assert start == 200 and found.cycles_per_sample == pytest.approx(offset, abs=1e-5)
    assert found.searched == pytest.approx(3 * 0.5 / 512)


def test_a_waveform_sent_once_is_found_where_chance_would_not_have_it():
    """Noise has a share s of n samples' energy with (1 − s)^(n−1): 6000 trials of 400 samples at 10⁻⁴ ask for 4.5 %."""
    random = np.random.default_rng(11)
    known, found = random.choice([-1.0, 1.0], 400), 0
    for _ in range(20):
        samples = (random.standard_normal(2000) + 1j * random.standard_normal(2000)) / np.sqrt(2)
        samples[900:1300] += np.sqrt(0.07 / 0.93) * known
        one, start = find_offset_once(samples, known, max_offset=0.5 / 400)
        found += one.found and start == 900
    assert 14 <= found
