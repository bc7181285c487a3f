# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gr_cast.signals import codes
from gr_cast.sounding.cir import estimate_taps
from gr_cast.sounding.correlate import Template, circular_cir
from hypothesis import given, settings
from hypothesis import strategies as st

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
