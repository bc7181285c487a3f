# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gr_cast.signals import codes
from gr_cast.signals.recording import Recording
from gr_cast.sounding.carrier import find_beyond, find_offset, find_offset_once
from gr_cast.sounding.correlate import Template
from gr_cast.sounding.receive import remove_offset, whole_periods

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
