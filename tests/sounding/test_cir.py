# SPDX-License-Identifier: GPL-3.0-or-later
from dataclasses import replace

import numpy as np
import pytest
from gr_cast.signals import codes
from gr_cast.sounding.cir import Taps, _unsteady, detection_threshold, estimate_taps
from gr_cast.sounding.correlate import Template, circular_cir
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import gamma

CODE = codes.glfsr(8)


def white_noise(random, *shape):
    return (random.standard_normal(shape) + 1j * random.standard_normal(shape)) / np.sqrt(2)


def delayed(code, delay):
    """Band-limited delay written out as a trigonometric sum, one line at a time: no FFT."""
    n, length = np.arange(len(code)), len(code)
    spectrum = [np.sum(code * np.exp(-2j * np.pi * k * n / length)) for k in range(length)]
    lines = [k if k < length / 2 else k - length for k in range(length)]
    total = np.zeros(length, complex)
    for k, line in zip(lines, spectrum, strict=True):
        wave = np.exp(2j * np.pi * k * (n - delay) / length)
        if 2 * abs(k) == length:
            wave = np.cos(np.pi * delay) * np.exp(2j * np.pi * k * n / length)
        total += line * wave / length
    return total


@pytest.mark.parametrize("code", [codes.glfsr(5), codes.ga128(), codes.zadoff_chu(17, 3)], ids=len)
@pytest.mark.parametrize("delay", [0.0, 3.0, 7.31, -0.4])
def test_a_delayed_waveform_is_its_trigonometric_interpolation(code, delay):
    assert np.allclose(Template(code).columns([delay])[:, 0], delayed(code, delay), atol=1e-9)


@pytest.mark.parametrize("code", [codes.glfsr(5), codes.ga128()], ids=len)
def test_slopes_are_the_derivative_of_the_columns(code):
    template, step = Template(code), 1e-5
    difference = (template.columns([4.3 + step]) - template.columns([4.3 - step])) / (2 * step)
    assert np.allclose(template.slopes([4.3]), difference, atol=1e-6)


def test_a_waveform_sent_once_does_not_wrap_round():
    template = Template(np.array([1.0, 2.0, 3.0]), circular=False, window=8)
    assert np.allclose(template.columns([2.0])[:, 0], [0, 0, 1, 2, 3, 0, 0, 0], atol=1e-12)
    assert np.allclose(template.columns([6.0])[:, 0], [0, 0, 0, 0, 0, 0, 1, 2], atol=1e-12)


def test_the_papers_estimator_is_the_correlation_over_the_energy():
    received = 0.5 * np.roll(CODE, 9)
    cir = circular_cir(received, CODE)
    direct = [np.sum(np.roll(received, -lag) * CODE) / np.sum(CODE**2) for lag in range(255)]
    assert np.allclose(cir, direct)


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_taps_without_noise_are_found_exactly(data):
    count = data.draw(st.integers(1, 5))
    slots = data.draw(st.lists(st.integers(0, 80), min_size=count, max_size=count, unique=True))
    delays = np.sort([3 * slot + data.draw(st.floats(-0.45, 0.45)) for slot in slots])
    gains = np.array([data.draw(st.floats(0.05, 1)) * np.exp(1j * data.draw(st.floats(-3, 3))) for _ in slots])
    received = sum(gain * delayed(CODE, delay) for gain, delay in zip(gains, delays, strict=True))
    taps = estimate_taps(received, Template(CODE), noise_variance=1e-8)
    assert np.allclose(taps.delay_samples, delays, atol=1e-3)
    assert np.allclose(taps.gain[:, 0], gains, atol=2e-4)


@pytest.mark.parametrize("code", [CODE, np.repeat(codes.glfsr(6), 4), codes.ls()], ids=["glfsr8", "glfsr6x4", "ls"])
@pytest.mark.parametrize("snr_db", [-5, 10, 30])
def test_errors_of_a_single_tap_reach_the_cramer_rao_bound(code, snr_db):
    random, trials = np.random.default_rng(snr_db + 100), 250
    template, amplitude = Template(code), 10 ** (snr_db / 20)
    errors, stds = [], []
    for _ in range(trials):
        delay, phase = random.uniform(0, len(code) - 1), random.uniform(-np.pi, np.pi)
        received = amplitude * np.exp(1j * phase) * template.columns([delay])[:, 0] + white_noise(random, len(code))
        taps = estimate_taps(received, template, noise_variance=1.0)
        k = np.argmax(np.abs(taps.gain[:, 0]))
        turn = np.angle(taps.gain[k, 0] * np.exp(-1j * phase))
        errors.append([taps.delay_samples[k] - delay, np.abs(taps.gain[k, 0]) - amplitude, turn])
        stds.append([taps.delay_std_samples[k], taps.gain_std[k], taps.phase_std_rad[k]])
    energy = np.sum(np.abs(code) ** 2)
    spectrum, f = np.abs(np.fft.fft(code)) ** 2, np.fft.fftfreq(len(code))
    spectrum[np.abs(f) == 0.5] = 0  # the Nyquist line tells nothing of a delay
    slope_energy = np.sum((2 * np.pi * f) ** 2 * spectrum) / len(code)
    bound = np.sqrt([1 / (2 * amplitude**2 * slope_energy), 1 / (2 * energy), 1 / (2 * amplitude**2 * energy)])
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / bound
    assert np.all(ratio < 1.2), f"RMS error over the bound: {ratio}"
    assert np.all(np.abs(np.mean(errors, axis=0)) < 4 * bound / np.sqrt(trials)), "unbiased"
    assert np.allclose(np.median(stds, axis=0), bound, rtol=0.1), "the reported deviations are the bound's"


@pytest.mark.parametrize(("blocks", "noise"), [(1, 1.0), (1, None), (4, 1.0)])
def test_false_alarms_come_at_the_stated_rate(blocks, noise):
    random, template, rate, trials = np.random.default_rng(5), Template(codes.glfsr(6)), 0.02, 3000
    alarms = sum(
        len(estimate_taps(white_noise(random, 63, blocks), template, noise_variance=noise, false_alarm_rate=rate).gain) > 0
        for _ in range(trials)
    )
    assert rate / 2 < alarms / trials < rate * 2


def test_blocks_that_fade_on_their_own_are_averaged_in_power():
    random, template = np.random.default_rng(8), Template(CODE)
    fading = white_noise(random, 2000)
    received = template.columns([30.25]) * fading[None, :] + 3.0 * white_noise(random, 255, 2000)
    taps = estimate_taps(received, template, noise_variance=9.0)
    assert taps.delay_samples == pytest.approx([30.25], abs=0.02)
    assert taps.power[0] == pytest.approx(np.mean(np.abs(fading) ** 2), rel=0.02)


@pytest.mark.parametrize("blocks", [1, 40])
def test_the_stated_limit_is_where_taps_begin_to_be_seen_and_none_below_it_is_reported(blocks):
    random = np.random.default_rng(blocks)
    code = codes.glfsr(8)
    template = Template(code)
    noise = 0.1
    limit = estimate_taps(white_noise(random, 255, blocks) * np.sqrt(noise), template, noise_variance=noise).smallest_power
    seen = {}
    for over_db in (-3.0, 3.0):
        amplitude = np.sqrt(limit * 10 ** (over_db / 10))
        counts = 0
        for _ in range(40):
            phases = np.exp(2j * np.pi * random.random(blocks))
            observed = np.outer(np.roll(code, 70), amplitude * phases) + np.sqrt(noise) * white_noise(random, 255, blocks)
            taps = estimate_taps(observed, template, noise_variance=noise)
            assert (taps.power >= taps.smallest_power).all()
            counts += any(abs(taps.delay_samples - 70) < 1)
        seen[over_db] = counts / 40
    assert seen[-3.0] < 0.35 and seen[3.0] > 0.9


def test_a_template_sees_its_window_of_a_waveform_sent_once_and_what_was_not_known_is_nothing():
    known = np.array([1.0, np.nan, 3.0, 4.0])
    template = Template(known, circular=False, window=4, skip=2)
    assert np.allclose(template.columns([0.0])[:, 0], [3, 4, 0, 0], atol=1e-12)
    assert np.allclose(template.columns([3.0])[:, 0], [0, 1, 0, 3], atol=1e-12)
    assert template.energy == pytest.approx(26) and template.window == 4 and template.grid >= 4 + 4 + 2


@pytest.mark.parametrize("code", [codes.glfsr(5), codes.ga128(), codes.zadoff_chu(64, 3)], ids=len)
@pytest.mark.parametrize("oversampling", [1, 4])
def test_a_matched_filter_is_the_inner_product_with_every_delayed_column(code, oversampling):
    template, random = Template(code), np.random.default_rng(1)
    received = white_noise(random, len(code), 2)
    delays = np.arange(len(code) * oversampling) / oversampling
    want = template.columns(delays).conj().T @ received
    got = template.matched_filter(received, oversampling)
    whole = slice(None, None, oversampling)
    assert np.allclose(got[whole], want[whole], atol=1e-9)
    if len(code) % 2:  # an even one has a line at half the rate, whose phase between samples is nobody's
        assert np.allclose(got, want, atol=1e-9)
    assert np.allclose(template.matched_filter(received[:, 0], oversampling), got[:, 0])


def test_of_a_band_only_the_middle_counts():
    code = codes.glfsr(7)
    template = Template(code, band=0.5)
    f = np.fft.fftfreq(127)
    kept = np.where(np.abs(f) <= 0.25, np.fft.fft(code), 0)
    assert np.allclose(template.columns([0.0])[:, 0], np.fft.ifft(kept), atol=1e-12)
    assert template.energy == pytest.approx(np.sum(np.abs(kept) ** 2) / 127)
    assert np.allclose(Template(code, band=1.0).spectrum, np.fft.fft(code))


def test_rms_bandwidth_is_that_of_the_spectrum_round_its_middle():
    n = np.arange(255)
    for turn in (0, 40):
        shaped = np.fft.ifft(np.fft.fft(CODE) * np.exp(-((np.fft.fftfreq(255) / 0.1) ** 2))) * np.exp(2j * np.pi * turn * n / 255)
        f, power = np.fft.fftfreq(255), np.abs(np.fft.fft(shaped)) ** 2
        share = power / power.sum()
        law = 2 * np.pi * np.sqrt(np.sum(share * f**2) - np.sum(share * f) ** 2)
        assert Template(shaped).rms_bandwidth_rad == pytest.approx(law, rel=1e-9)


def test_two_unit_echoes_have_the_inner_product_of_the_flat_band():
    """Over a share of the band of edges ±b/2 it is a sinc of their distance."""
    delays = np.array([0.0, 1.5, 4.25])
    gram = Template(CODE).gram(delays)
    f = np.fft.fftfreq(255)
    law = [[np.mean(np.exp(2j * np.pi * f * (a - b))) for b in delays] for a in delays]
    np.testing.assert_allclose(gram, law, atol=1e-12)
    narrow = Template(codes.glfsr(10), band=0.5).gram(delays)
    apart = np.subtract.outer(delays, delays)
    np.testing.assert_allclose(narrow, np.sinc(0.5 * apart), atol=0.04)
    assert np.allclose(np.diag(narrow), 1)


def test_every_tap_of_several_has_the_errors_that_repeated_soundings_have():
    """Two close taps and a far one: delays and gains pull at each other, which the stated deviations count."""
    random, template = np.random.default_rng(3), Template(CODE)
    delays, gains = np.array([40.0, 41.6, 100.3]), np.array([1.0, 0.7j, -0.4])
    clean = template.columns(delays) @ gains
    errors, stds = [], []
    for _ in range(250):
        taps = estimate_taps(clean + 0.1 * white_noise(random, 255), template, noise_variance=0.01)
        assert len(taps.gain) == 3
        turn = np.angle(taps.gain[:, 0] / gains)
        errors.append([taps.delay_samples - delays, np.abs(taps.gain[:, 0]) - np.abs(gains), turn])
        stds.append([taps.delay_std_samples, taps.gain_std, taps.phase_std_rad])
    ratio = np.std(errors, axis=0) / np.mean(stds, axis=0)
    assert np.all(np.abs(ratio - 1) < 0.17), ratio


def test_the_threshold_is_where_a_chi_square_process_crosses_as_often_as_stated():
    """Expected up-crossings by Rice's formula with the gamma density written out; with few degrees of freedom it is higher."""
    delays, beta, rate = 255.0, 1.8, 1e-3
    for blocks in (1, 3, 50):
        u = detection_threshold(rate, delays, beta, blocks)
        crossings = delays * beta * np.sqrt(u / np.pi) * gamma.pdf(u, blocks)
        assert crossings == pytest.approx(rate, rel=1e-5)
        unsure = [detection_threshold(rate, delays, beta, blocks, freedom) for freedom in (1e12, 1e3, 100, 20)]
        assert unsure[0] == pytest.approx(u) and unsure == sorted(unsure) and unsure[3] > 1.05 * u


@pytest.mark.parametrize("seen", [1, 2, 5])
def test_no_more_taps_are_reported_than_are_asked_for(seen):
    received = sum(np.roll(CODE, 20 * k) * 0.8**k for k in range(5)) + 0j
    taps = estimate_taps(received, Template(CODE), noise_variance=1e-6, max_taps=seen)
    assert np.rint(taps.delay_samples).tolist() == [20 * k for k in range(seen)]


@pytest.mark.parametrize(("apart", "count"), [(0.4, 1), (0.9, 1), (1.5, 2)])
def test_two_taps_are_a_sample_apart_or_one(apart, count):
    template = Template(CODE)
    received = template.columns([30.0, 30.0 + apart]) @ np.array([1.0, 1j])
    taps = estimate_taps(received, template, noise_variance=1e-3, max_taps=2)
    assert sum(abs(delay - 30.5) < 2 for delay in taps.delay_samples) >= count
    assert (np.diff(taps.delay_samples) >= 0.5).all()


def test_a_tap_at_the_end_of_the_period_lies_beside_one_at_its_beginning():
    template = Template(CODE)
    received = template.columns([-0.3, 100.0]) @ np.array([1.0, 0.5])
    taps = estimate_taps(received, template, noise_variance=1e-6)
    assert taps.delay_samples == pytest.approx([-0.3, 100.0], abs=1e-3)
    late = estimate_taps(template.columns([254.4])[:, 0], template, noise_variance=1e-6)
    assert late.delay_samples == pytest.approx([254.4], abs=1e-3)
    early = estimate_taps(template.columns([254.6])[:, 0], template, noise_variance=1e-6)
    assert early.delay_samples == pytest.approx([-0.4], abs=1e-3)


def test_of_a_waveform_sent_once_only_the_delays_asked_for_are_searched():
    code = np.random.default_rng(5).choice([1.0, -1.0], 200)
    template = Template(code, circular=False, window=400)
    received = template.columns([50.0, 150.0]) @ np.array([1.0, 0.3])
    for searched, delays in ((100, [50]), (400, [50, 150])):
        taps = estimate_taps(received, template, noise_variance=0.2, delays_searched=searched)
        assert np.rint(taps.delay_samples).tolist() == delays


def test_power_over_blocks_is_without_the_noise_and_its_deviation_shrinks_with_them():
    gain = np.array([[3.0, 4.0j], [1e-9, 1e-9]])
    taps = Taps(delay_samples=np.arange(2.0), gain=gain, gain_std=np.array([0.5, 0.5]), delay_std_samples=np.zeros(2),
                phase_std_rad=np.zeros(2), noise_variance=1.0, smallest_power=0.0)  # fmt: skip
    assert taps.power[0] == pytest.approx(12.5 - 2 * 0.25) and 0 < taps.power[1] < 1e-300
    assert taps.gain_std_db[0] == pytest.approx(20 / np.log(10) * 0.5 / np.sqrt(2 * 12.0))
    one = replace(taps, gain=gain[:, :1])
    assert one.power[0] == 9 and one.gain_std_db[0] == pytest.approx(20 / np.log(10) * 0.5 / 3)


def test_what_a_tap_leaves_at_other_delays_hides_weaker_ones():
    """−40 dB of a tap of 1: what lies 42 dB below it is no tap, what lies 38 dB below it is one."""
    for level_db, seen in ((-42.0, 1), (-38.0, 2)):
        received = CODE + 10 ** (level_db / 20) * np.roll(CODE, 90)
        taps = estimate_taps(received + 0j, Template(CODE), noise_variance=1e-8, spur=0.01)
        assert len(taps.gain) == seen and 10 * np.log10(taps.smallest_power) >= -40.1


def test_noise_read_off_the_delays_without_taps_is_the_noise():
    random, template = np.random.default_rng(9), Template(codes.glfsr(10))
    for blocks in (1, 4):
        observed = template.columns([40.0]) @ np.ones((1, blocks)) + 0.2 * white_noise(random, 1023, blocks)
        taps = estimate_taps(observed, template)
        assert taps.noise_variance == pytest.approx(0.04, rel=0.1) and len(taps.gain) == 1


def test_what_moves_within_a_period_raises_the_limit_and_white_noise_does_not():
    """Of one pattern over the delays in all blocks, exponential of mean `unsteady`, the median is ln 2 of it."""
    random = np.random.default_rng(11)
    blocks, noise = 40, 0.1
    white = np.sum(np.abs(white_noise(random, 4000, blocks)) ** 2, axis=1) * noise
    assert _unsteady(white, blocks, noise) == 0
    pattern = random.exponential(1.0, 4000) * blocks
    assert _unsteady(white + pattern, blocks, noise) == pytest.approx(1.0, rel=0.1)
    assert _unsteady(white + pattern, 1, noise) == 0
    passed = np.percentile(white + pattern, 50) / blocks  # for noise it passed: the quartiles still tell
    assert _unsteady(white + pattern, blocks, passed) > 0.3
