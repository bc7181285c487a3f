# SPDX-License-Identifier: GPL-3.0-or-later
from dataclasses import replace

import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.emulation.reference import interpolator
from gr_cast.signals import codes, recording
from gr_cast.signals.recording import Recording
from gr_cast.signals.waveform import Waveform, waveform_from_file
from gr_cast.sounding.sound import (
    LinkBudget,
    SoundingOptions,
    _averaging_loss_db,
    _block_means,
    _coherent_blocks,
    _jump_warnings,
    _longest_known_run,
    _max_offset,
    _noise_of_differences,
    sound,
)

CODE = codes.glfsr(8)
WAVEFORM = Waveform(samples=CODE.astype(np.complex64), name="glfsr:8")
FOUR_TAPS = {0: -3.0, 64: -20.0, 100: -15.0, 200: -8.0}  # delay in samples of 20 ns to gain in dB


def air(taps_db, periods, noise_db=-200.0, seed=1, rate_hz=50e6, offset_hz=0.0, **about):
    random = np.random.default_rng(seed)
    one = sum(10 ** (gain / 20) * np.roll(CODE, delay) for delay, gain in taps_db.items())
    n = np.arange(255 * periods)
    noise = random.standard_normal((2, len(n))) * np.sqrt(10 ** (noise_db / 10) / 2)
    samples = np.tile(one, periods) * np.exp(2j * np.pi * offset_hz / rate_hz * n) + noise[0] + 1j * noise[1]
    return Recording(samples=samples.astype(np.complex64), sample_rate_hz=rate_hz, **about)


def test_four_taps_over_1500_frames_have_exact_delays_and_unbiased_gains():
    result = sound(air(FOUR_TAPS, 1500, noise_db=-20.0), WAVEFORM)
    assert np.array_equal(np.rint(result.taps.delay_samples), list(FOUR_TAPS))
    z = (result.taps.delay_samples - list(FOUR_TAPS)) / result.taps.delay_std_samples
    assert np.abs(z).max() < 4.5
    gains_db = 10 * np.log10(result.taps.power)
    assert np.abs(gains_db - list(FOUR_TAPS.values())).max() < 0.05
    assert result.frames == 1500
    assert 10 * np.log10(result.noise_power) == pytest.approx(-20.0, abs=0.05)


def test_frames_scatter_as_the_noise_says():
    result = sound(air(FOUR_TAPS, 1500, noise_db=-20.0), WAVEFORM)
    for tap, gain_db in enumerate(FOUR_TAPS.values()):
        amplitude = np.abs(result.frame_gain[:, tap])
        assert np.std(amplitude) == pytest.approx(np.sqrt(0.01 / 255 / 2), rel=0.1)
        assert np.mean(amplitude) == pytest.approx(10 ** (gain_db / 20), abs=5e-4)


@pytest.mark.parametrize("offset_hz", [-20_000.0, -3_000.0, 700.0, 20_000.0])
def test_a_carrier_offset_costs_less_than_a_tenth_of_a_db(offset_hz):
    result = sound(air({30: -10.0}, 200, -20.0, rate_hz=10e6, offset_hz=offset_hz), WAVEFORM)
    assert result.path_gain_db == pytest.approx(-10.0, abs=0.1)
    assert result.offset.cycles_per_sample * 10e6 == pytest.approx(offset_hz, abs=1)


def test_an_uncorrected_offset_costs_what_the_sinc_says():
    options = SoundingOptions(correct_offset=False, average=1)
    result = sound(air({30: 0.0}, 60, -40.0, rate_hz=10e6, offset_hz=20_000.0), WAVEFORM, options)
    loss_db = 20 * np.log10(np.abs(np.sinc(20_000.0 * 255 / 10e6)))  # 4.1 dB: the published sounder's loss
    strongest = int(np.argmax(result.taps.power))
    frames_db = 10 * np.log10(np.mean(np.abs(result.frame_gain[:, strongest]) ** 2))
    assert frames_db == pytest.approx(loss_db, abs=0.3)


def test_missing_frames_are_told_from_weak_ones():
    weak = air({10: -30.0}, 400, -30.0)
    samples = weak.samples.copy()
    samples[255 * 100 : 255 * 200] = air({10: -300.0}, 100, -30.0, seed=2).samples
    result = sound(Recording(samples=samples, sample_rate_hz=50e6), WAVEFORM, SoundingOptions(average=1))
    assert not result.frame_detected[100:200].any()
    assert result.frame_detected[:100].all() and result.frame_detected[200:].all()
    assert any("100 of 400 frames are missing" in warning for warning in result.warnings)


def test_silence_is_no_signal_and_not_a_small_number():
    result = sound(air({0: -300.0}, 100, -30.0), WAVEFORM)
    assert (result.path_gain_db, result.path_loss_db, len(result.taps.power)) == (None, None, 0)
    assert not result.frame_detected.any()
    assert any("no signal" in warning for warning in result.warnings)


def test_path_loss_counts_power_gains_and_base_loss():
    # The laboratory of the paper: 30 dB of attenuator and 4.06 dB of cables, 15 dB of gain at either end.
    budget = LinkBudget(tx_power_dbm=10, tx_gain_db=15, rx_gain_db=15, rx_full_scale_dbm=10, base_loss_db=4.06)
    result = sound(air({3: -4.06}, 50, -60.0), WAVEFORM, SoundingOptions(budget=budget))
    assert result.path_loss_db == pytest.approx(30.0, abs=0.01)


def test_path_gain_is_the_mean_response_over_the_band():
    turns = np.exp(-2j * np.pi * np.fft.fftfreq(255) * 31.5)
    beside = 0.8 * np.fft.ifft(np.fft.fft(CODE) * turns)  # 1.5 samples after the first tap
    record = air({30: 0.0}, 400, -20.0)
    samples = (record.samples + np.tile(beside, 400)).astype(np.complex64)
    in_band_db = 10 * np.log10(np.mean(np.abs(1 + 0.8 * np.exp(-2j * np.pi * 1.5 * np.fft.fftfreq(255))) ** 2))
    result = sound(Recording(samples=samples, sample_rate_hz=50e6), WAVEFORM, SoundingOptions(average=10))
    assert result.path_gain_db == pytest.approx(in_band_db, abs=4 * result.path_gain_std_db)
    assert result.tap_sum_db == pytest.approx(10 * np.log10(1.64), abs=0.02) and result.tap_sum_db > in_band_db + 0.5
    assert 10 * np.log10(np.mean(result.frame_power)) == pytest.approx(in_band_db, abs=0.02)


def test_the_deviation_of_the_path_gain_is_that_of_repeated_soundings():
    found = [sound(air({30: 0.0, 31: -2.0}, 20, 0.0, seed=seed), WAVEFORM) for seed in range(60)]
    stated_db = np.mean([one.path_gain_std_db for one in found])
    assert np.std([one.path_gain_db for one in found]) == pytest.approx(stated_db, rel=0.3)


def test_a_code_shorter_than_the_spread_is_warned_of():
    def warned(rate_hz):
        result = sound(air({0: 0.0}, 20, -20.0, rate_hz=rate_hz), WAVEFORM)
        return any("alias" in warning for warning in result.warnings)

    assert warned(50e6) and not warned(49e6)


def test_clipping_is_warned_of_and_a_clean_code_is_not():
    loud = air(FOUR_TAPS, 100, -20.0)
    rails = np.clip(loud.samples.real, -0.6, 0.6) + 1j * np.clip(loud.samples.imag, -0.6, 0.6)
    clipped = sound(Recording(samples=rails.astype(np.complex64), sample_rate_hz=50e6), WAVEFORM)
    assert any("clipping" in warning for warning in clipped.warnings)
    for clean in (loud, air({0: 0.0}, 100)):
        assert not any("clipping" in warning for warning in sound(clean, WAVEFORM).warnings)


def test_a_channel_that_turns_within_a_frame_is_warned_of():
    samples = air({5: 0.0}, 400, -30.0).samples
    turning = samples * np.exp(2j * np.pi * 3.0 * np.cos(np.arange(len(samples)) / 4000))
    record = Recording(samples=turning.astype(np.complex64), sample_rate_hz=50e6)
    assert any("averaging 50 periods loses" in w for w in sound(record, WAVEFORM, SoundingOptions(average=50)).warnings)


def test_a_gap_keeps_the_delay_axis_and_is_reported():
    whole = air({77: -6.0}, 100, -20.0)
    samples = np.delete(whole.samples, slice(10_000, 10_333))
    captures = ({"core:sample_start": 0}, {"core:sample_start": 10_000, "cast:lost_samples": 333})
    result = sound(Recording(samples=samples, sample_rate_hz=50e6, captures=captures), WAVEFORM)
    assert result.taps.delay_samples == pytest.approx([77.0], abs=0.01)
    assert any("1 gaps, 333 samples lost" in warning for warning in result.warnings)


def test_a_fading_tap_has_its_mean_power():
    random = np.random.default_rng(4)
    fade = np.convolve(random.standard_normal(5000) + 1j * random.standard_normal(5000), np.hanning(60), "valid")[:3000]
    fade /= np.sqrt(np.mean(np.abs(fade) ** 2))
    samples = np.tile(np.roll(CODE, 12), 3000) * np.repeat(fade, 255) * 0.1
    noise = random.standard_normal((2, len(samples))) * 0.1
    record = Recording(samples=(samples + noise[0] + 1j * noise[1]).astype(np.complex64), sample_rate_hz=50e6)
    assert sound(record, WAVEFORM).path_gain_db == pytest.approx(-20.0, abs=0.3)


def test_a_waveform_sent_once_gives_its_delay_and_gain():
    random = np.random.default_rng(6)
    sent = Waveform(samples=codes.zadoff_chu(1021, 3), repeat=False, name="burst")
    samples = 0.01 * (random.standard_normal(5000) + 1j * random.standard_normal(5000))
    samples[2000:3021] += 0.5 * sent.samples
    samples[2040:3061] += 0.05j * sent.samples
    result = sound(Recording(samples=samples.astype(np.complex64), sample_rate_hz=10e6), sent)
    assert result.taps.delay_samples == pytest.approx([2000, 2040], abs=0.05)
    assert np.abs(result.taps.gain[:, 0]) == pytest.approx([0.5, 0.05], rel=0.05)


def test_unknown_samples_at_the_head_of_a_waveform_make_no_false_taps():
    random = np.random.default_rng(9)
    known = (random.choice([-1, 1], 5000) + 1j * random.choice([-1, 1], 5000)) / np.sqrt(2)
    samples = 1e-3 * (random.standard_normal(6000) + 1j * random.standard_normal(6000))
    samples[300:5300] += known
    sent = known.astype(np.complex64)
    sent[:1000] = np.nan
    waveform = Waveform(samples=sent, repeat=False, name="headless")
    result = sound(Recording(samples=samples.astype(np.complex64), sample_rate_hz=10e6), waveform)
    assert result.taps.delay_samples == pytest.approx([300.0], abs=0.01)
    assert 10 * np.log10(result.noise_power) == pytest.approx(10 * np.log10(2e-6), abs=1.5)


def test_a_gap_in_a_waveform_sent_once_leaves_its_longest_run():
    random = np.random.default_rng(10)
    qpsk = (random.choice([-1, 1], 8000) + 1j * random.choice([-1, 1], 8000)) / np.sqrt(2)
    sent = Waveform(samples=qpsk.astype(np.complex64), repeat=False, name="burst")
    whole = np.concatenate([np.zeros(700), sent.samples, np.zeros(700)])
    whole = whole + 0.01 * (random.standard_normal(len(whole)) + 1j * random.standard_normal(len(whole)))
    captures = ({"core:sample_start": 0}, {"core:sample_start": 6000, "cast:lost_samples": 100})
    record = Recording(samples=np.delete(whole, slice(6000, 6100)).astype(np.complex64), sample_rate_hz=10e6, captures=captures)
    result = sound(record, sent)
    assert result.path_gain_db == pytest.approx(0.0, abs=0.1)
    assert result.taps.delay_samples == pytest.approx([700.0], abs=0.02)


def test_digital_silence_is_no_noise():
    samples = air({3: 0.0}, 100, -20.0).samples.copy()
    samples[: 255 * 60] = 0
    result = sound(Recording(samples=samples, sample_rate_hz=50e6), WAVEFORM)
    assert len(result.taps.power) == 1
    assert 10 * np.log10(result.noise_power) == pytest.approx(-20.0, abs=0.3)


def test_a_constant_envelope_and_a_weak_converter_do_not_clip():
    chirp = Waveform(samples=codes.zadoff_chu(255, 1), name="zc")
    exact = Recording(samples=np.tile(chirp.samples, 20), sample_rate_hz=1e6)
    random = np.random.default_rng(3)
    steps = np.rint(random.standard_normal((255 * 20, 2)) * 1.2).clip(-3, 3) / 128
    weak = Recording(samples=(steps[:, 0] + 1j * steps[:, 1]).astype(np.complex64), sample_rate_hz=1e6, datatype="ci8")
    short = Recording(samples=air({0: 0.0}, 1, -20.0).samples, sample_rate_hz=1e6)
    for record, sent in ((exact, chirp), (weak, WAVEFORM), (short, WAVEFORM)):
        assert not any("clipping" in warning for warning in sound(record, sent).warnings)


@pytest.mark.parametrize(
    ("record", "waveform", "words"),
    [
        (Recording(samples=np.ones(999, "c8"), sample_rate_hz=None), WAVEFORM, "rate"),
        (Recording(samples=np.ones(200, "c8"), sample_rate_hz=1e6), WAVEFORM, "no whole period"),
        (Recording(samples=np.zeros(600, "c8"), sample_rate_hz=1e6), WAVEFORM, "every sample is zero"),
        (Recording(samples=np.eye(1, 600, 599)[0].astype("c8"), sample_rate_hz=1e6), WAVEFORM, "whole periods is zero"),
        (air({0: 0.0}, 4), Waveform(samples=np.ones(64, "c8"), name="dc"), "no bandwidth"),
        (air({0: 0.0}, 4), Waveform(samples=WAVEFORM.samples, sample_rate_hz=1e6, name="w"), "resample"),
    ],
)
def test_a_recording_that_cannot_hold_the_waveform_is_refused(record, waveform, words):
    with pytest.raises(CastError, match=words):
        sound(record, waveform)


@pytest.mark.parametrize("receiver", [0, 1])
def test_two_frames_of_the_cosmos_testbed_agree_within_their_uncertainty(cast_data, receiver):
    folder = cast_data / "real" / "cosmos_pn"
    sent = waveform_from_file(folder / "reference", repeat=False)
    first, second = (sound(recording.read(folder / f"recording_rx{receiver}_frame{k}"), sent) for k in (0, 1))
    strongest = [int(np.argmax(result.taps.power)) for result in (first, second)]
    delays = [r.taps.delay_samples[k] for r, k in zip((first, second), strongest, strict=True)]
    stds = [r.taps.delay_std_samples[k] for r, k in zip((first, second), strongest, strict=True)]
    assert abs(delays[0] - delays[1]) < 3 * np.hypot(*stds)
    assert abs(first.path_gain_db - second.path_gain_db) < 3 * np.hypot(first.path_gain_std_db, second.path_gain_std_db)
    assert first.path_gain_db > first.smallest_path_gain_db + 20


def test_a_carrier_that_was_not_searched_for_is_no_channel_of_many_taps():
    far = air(FOUR_TAPS, 300, -60.0, offset_hz=2e6)
    with pytest.raises(CastError, match=r"not within ±25000 Hz.*about 2e\+06 Hz: add --max-offset 2\.1e\+06"):
        sound(far, WAVEFORM)
    assert len(sound(far, WAVEFORM, SoundingOptions(max_offset_hz=2.1e6)).taps.power) == 4


def test_another_code_than_the_one_sent_is_doubted():
    sent = Recording(samples=np.tile(codes.gold(511), 20).astype(np.complex64), sample_rate_hz=50e6)
    taken = Waveform(samples=codes.glfsr(9).astype(np.complex64), name="glfsr:9")
    assert any("is the code the one that was sent" in warning for warning in sound(sent, taken).warnings)


def test_rounding_that_repeats_with_the_code_is_no_tap():
    """Products of an m-sequence are the sequence again: what float32 rounds in four taps is an echo that no averaging lowers."""
    result = sound(air(FOUR_TAPS, 400, noise_db=-400.0), WAVEFORM)
    assert len(result.taps.power) == 4
    assert result.smallest_path_gain_db > -155.0


@pytest.mark.parametrize("degree", [9, 11])
@pytest.mark.parametrize("delays", [(92.5,), (0, 92.5, 213), (92.4, 123.3, 154.4)])
def test_what_interpolating_filters_leave_is_no_tap_however_long_the_code(degree, delays):
    """Taps between samples by the emulator's filters: by the definition of a least-squares filter they end 13 samples off."""
    code = codes.glfsr(degree)
    one = np.zeros(len(code), complex)
    for delay in delays:
        whole, fraction = divmod(delay, 1)
        filtered = [1.0] if not fraction else interpolator(fraction)
        for k, value in enumerate(filtered, start=int(whole) - (13 if fraction else 0)):
            one += value * np.roll(code, k)
    random = np.random.default_rng(1)
    samples = np.tile(one, 100)
    samples = samples + 1e-6 * (random.standard_normal(len(samples)) + 1j * random.standard_normal(len(samples)))
    air = Recording(samples=samples.astype(np.complex64), sample_rate_hz=50e6)
    result = sound(air, Waveform(samples=code.astype("c8"), name="code"), SoundingOptions(band=0.8))
    assert result.taps.delay_samples == pytest.approx(delays, abs=1e-3)
    assert result.smallest_path_gain_db < -85


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"average": -1}, "average: got -1"), ({"false_alarm_rate": 0.0}, "false alarm rate"), ({"band": 1.01}, "band"),
        ({"max_taps": 0}, "max taps"), ({"max_taps": 513}, "max taps"), ({"max_offset_hz": -1.0}, "max offset"),
        ({"max_offset_hz": np.inf}, "max offset"), ({"carrier_offset_hz": np.nan}, "carrier offset"), ({"band": 0.0}, "band"),
        ({"false_alarm_rate": 0.5}, "false alarm rate"),
        ({"max_spread_s": 0.0}, "max spread"), ({"max_spread_s": np.inf}, "max spread"),
        ({"average": 0, "max_taps": 512, "max_offset_hz": 0.0, "band": 1.0, "false_alarm_rate": 0.49}, None),
        ({"max_taps": 1, "carrier_offset_hz": -5.0, "band": 1e-3, "max_spread_s": 1e-9, "false_alarm_rate": 1e-9}, None),
    ],
)  # fmt: skip
def test_options_have_limits(wrong, says):
    if says is None:
        SoundingOptions(**wrong)
    else:
        with pytest.raises(CastError, match=says):
            SoundingOptions(**wrong)


def test_by_default_nothing_lies_between_the_samples_and_the_antennas():
    assert LinkBudget().path_loss_db(-7.0) == 7.0
    whole = LinkBudget(tx_power_dbm=1, tx_gain_db=2, rx_gain_db=4, rx_full_scale_dbm=8, base_loss_db=16)
    assert whole.path_loss_db(-32.0) == (1 + 2) - (-32 + 8 - 4) - 16


@pytest.mark.parametrize(("carrier_hz", "asked_hz", "searched_hz"), [
    (None, None, 25e3), (1e9, None, 25e3), (5e9, None, 50e3), (-5e9, None, 50e3), (1e9, 123.0, 123.0), (1e9, 9e9, 25e6),
])  # fmt: skip
def test_a_carrier_is_searched_over_ten_millionths_of_it_and_25_khz_at_least(carrier_hz, asked_hz, searched_hz):
    file = Recording(samples=np.ones(1, "c8"), sample_rate_hz=50e6, center_frequency_hz=carrier_hz)
    options = SoundingOptions(max_offset_hz=asked_hz)
    assert _max_offset(file, options) * 50e6 == pytest.approx(searched_hz)
    assert _max_offset(file, replace(options, correct_offset=False)) == 0


def test_a_carrier_that_cannot_all_be_searched_is_warned_of():
    random = np.random.default_rng(1)
    sent = Waveform(samples=random.choice([-1, 1], 4200).astype("c8"), repeat=False, name="long")
    heard = sent.samples + 0.1 * random.standard_normal(4200)
    for asked_hz, warned in ((3e5, True), (2e5, False)):  # 2000 half cycles over 4096 samples are 244 kHz
        result = sound(Recording(samples=heard.astype("c8"), sample_rate_hz=1e6), sent, SoundingOptions(max_offset_hz=asked_hz))
        assert any("carrier offset searched to ±" in warning for warning in result.warnings) == warned


@pytest.mark.parametrize("count", [3, 4, 5, 40])
@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_noise_is_what_second_differences_of_four_periods_or_more_leave(count, turn):
    rng = np.random.default_rng(2)
    found = []
    for _ in range(400):
        noise = 0.1 * (rng.normal(size=(count, 63)) + 1j * rng.normal(size=(count, 63)))
        steady = (1 + turn * np.arange(count))[:, None] * CODE[:63]  # what turns steadily cancels, too
        found.append(_noise_of_differences((steady + noise).astype(np.complex64)))
    if count < 4:
        assert set(found) == {None}
    else:
        assert np.mean(found) == pytest.approx(0.02, rel=0.02)


def test_digital_silence_and_a_burst_are_no_noise_and_float32_has_some():
    rng = np.random.default_rng(3)
    noise = 0.1 * (rng.normal(size=(60, 63)) + 1j * rng.normal(size=(60, 63)))
    noise[:20] = 0
    noise[30] *= 100
    assert _noise_of_differences(noise) == pytest.approx(0.02, rel=0.1)
    assert _noise_of_differences(np.zeros((9, 63))) is None
    assert _noise_of_differences(np.ones((9, 63), complex)) == 2.0**-48


def test_blocks_are_as_many_as_keep_99_hundredths_of_every_track_and_one_where_nothing_moves():
    n = np.arange(1024)
    still, turning = np.ones(1024, complex), np.exp(2j * np.pi * 0.01 * n)
    assert _coherent_blocks(np.stack([still], axis=1), 1e-6) == 1
    blocks = _coherent_blocks(np.stack([still, turning], axis=1), 1e-6)

    def kept(count):
        size = 1024 // count
        return (np.sin(np.pi * 0.01 * size) / (size * np.sin(np.pi * 0.01))) ** 2  # Dirichlet's kernel

    assert kept(blocks) > 0.99 > kept(blocks // 2)
    rng = np.random.default_rng(4)
    noise = np.sqrt(0.5) * (rng.normal(size=(1024, 1)) + 1j * rng.normal(size=(1024, 1)))
    weak = np.sqrt(0.1) * turning[:, None]  # 5 σ of the mean power are 0.16
    assert _coherent_blocks(weak + noise, 1.0) == 1 and _coherent_blocks(noise, 1.0) == 1
    assert _coherent_blocks(np.exp(2j * np.pi * 0.4 * n)[:, None], 1e-6) == 1024


def test_means_over_blocks_leave_out_what_is_left_over():
    samples = np.arange(22.0).reshape(11, 2)
    assert np.array_equal(_block_means(samples, 3), [[2, 8, 14], [3, 9, 15]])


@pytest.mark.parametrize("average", [2, 5, 10])
def test_averaging_a_track_that_turns_loses_what_dirichlets_kernel_says(average):
    track = np.exp(2j * np.pi * 0.03 * np.arange(1003))
    law_db = -20 * np.log10(np.sin(np.pi * 0.03 * average) / (average * np.sin(np.pi * 0.03)))
    assert _averaging_loss_db(track, average, 0.0) == pytest.approx(law_db, rel=1e-6)
    rng = np.random.default_rng(5)
    noise = np.sqrt(0.05) * (rng.normal(size=1003) + 1j * rng.normal(size=1003))
    assert _averaging_loss_db(track + noise, average, 0.1) == pytest.approx(law_db, abs=0.15)
    assert _averaging_loss_db(0.1 * track + np.sqrt(10) * noise, average, 1.0) == 0  # too weak to tell
    assert _averaging_loss_db(np.tile([1.0, -1.0], 500), 2, 0.0) == 0


@pytest.mark.parametrize(
    ("known", "run"), [("....", (0, 4)), ("x..x...x.", (4, 7)), ("..x.", (0, 2)), ("xx.", (2, 3)), (".x.", (0, 1))]
)
def test_the_longest_stretch_without_a_hole_is_known(known, run):
    samples = np.array([np.nan if c == "x" else 1.0 for c in known])
    assert _longest_known_run(samples) == run


@pytest.mark.parametrize("average", [0, 1, 7])
def test_frames_are_so_many_periods_long_and_at_their_times(average):
    record = air({30: -6.0}, 3200, -20.0)
    result = sound(record, WAVEFORM, SoundingOptions(average=average))
    each = average or 2  # some 1500 frames
    assert result.periods_per_frame == each and result.frames == 3200 // each and result.period_samples == 255
    np.testing.assert_allclose(result.frame_time_s, np.arange(3200 // each) * each * 255 / 50e6)
    assert np.std(np.abs(result.frame_gain[:, 0])) == pytest.approx(np.sqrt(0.01 / 255 / 2 / each), rel=0.12)
    assert np.mean(result.frame_power) == pytest.approx(10**-0.6, rel=2e-3)
    with pytest.raises(CastError, match="average: got 3201 periods, the recording holds 3200 whole ones"):
        sound(record, WAVEFORM, SoundingOptions(average=3201))


def test_the_response_for_the_picture_is_the_papers_estimator_and_less_its_taps_what_is_left():
    result = sound(air(FOUR_TAPS, 200, -40.0), WAVEFORM)
    strongest = np.abs(result.response[list(FOUR_TAPS)])
    heard = sum(10 ** (gain / 20) * np.roll(CODE, delay) for delay, gain in FOUR_TAPS.items())
    want = [abs(heard @ np.roll(CODE, delay)) / 255 for delay in range(255)]
    assert strongest == pytest.approx([want[delay] for delay in FOUR_TAPS], abs=1e-3) and len(result.response) == 255
    assert np.mean(np.abs(result.residual_response) ** 2) == pytest.approx(result.response_noise_power, rel=0.4)
    assert result.response_noise_power == pytest.approx(1e-4 / 200 / 255, rel=0.05) and result.response_start == 0


def test_what_the_taps_leave_unexplained_is_told_in_db_of_what_was_received():
    result = sound(air({30: 0.0}, 200, -10.0), WAVEFORM, SoundingOptions(average=1))
    assert result.residual_db == pytest.approx(10 * np.log10(0.1 / 1.1), abs=0.05)
    assert sound(air({30: 0.0}, 200, -400.0), WAVEFORM).residual_db < -100


def test_a_jump_is_told_with_its_time_and_what_was_kept():
    n = np.arange(255 * 300)
    place = n - 40 * (n >= 255 * 100)
    samples = CODE[place % 255] + 1e-2 * np.random.default_rng(1).normal(size=len(n))
    result = sound(Recording(samples=samples.astype("c8"), sample_rate_hz=1e6), WAVEFORM)
    (warning,) = [line for line in result.warnings if "jumps" in line]
    assert warning.startswith("the code jumps by +40 samples at 0.0255") and "times more" not in warning
    assert "Sounded the longest stretch without a jump, 0.05" in warning
    assert result.frame_time_s[0] == pytest.approx(0.0255, abs=1e-3)
    assert _jump_warnings([], 1.0) == []
    (several,) = _jump_warnings([(0.5, -3), (0.6, 4), (0.7, 5)], 2.0)
    assert several.startswith("the code jumps by -3 samples at 0.5 s, and 2 times more: ") and several.endswith("jump, 2 s")


def test_taps_at_the_limit_of_their_number_are_warned_of():
    for most, warned in ((4, True), (5, False)):
        result = sound(air(FOUR_TAPS, 100, -30.0), WAVEFORM, SoundingOptions(max_taps=most))
        assert any(f"more taps than the {most} that --max-taps allows" in warning for warning in result.warnings) == warned


def test_repeated_samples_must_be_known_and_a_rate_may_differ_by_rounding():
    holed = Waveform(samples=np.where(np.arange(255) == 3, np.nan, CODE).astype("c8"), name="w")
    with pytest.raises(CastError, match="w: a repeated waveform needs all its samples known; it holds NaN"):
        sound(air({0: 0.0}, 10), holed)
    for off, fits in ((0.9e-9, True), (1.1e-9, False)):
        rated = replace(WAVEFORM, sample_rate_hz=50e6 * (1 + off))
        if fits:
            assert len(sound(air({0: 0.0}, 10, -20.0), rated).taps.power) == 1
        else:
            with pytest.raises(CastError, match="resample one"):
                sound(air({0: 0.0}, 10), rated)


@pytest.mark.parametrize("known", [16, 15])
def test_a_waveform_sent_once_is_told_from_sixteen_samples_that_meet_it(known):
    sent = Waveform(samples=np.random.default_rng(7).choice([1, -1, 1j], 3000).astype("c8"), repeat=False, name="burst")
    file = Recording(samples=sent.samples[:known], sample_rate_hz=1e6)
    if known < 16:
        with pytest.raises(CastError, match="recording: 15 samples meet known samples of burst, needs 16 or more"):
            sound(file, sent)
    else:
        sound(file, sent)


@pytest.mark.parametrize(("turns", "blocks"), [(0.0, 1), (0.12, 2), (0.3, 4)])
def test_a_mean_of_powers_is_without_its_noise_and_one_gain_is_as_it_is(turns, blocks):
    """One tap that turns by so many cycles over the recording, in noise 10 dB over it: |gain|² less noise/energy of a block."""
    n = np.arange(255 * 400)
    turning = np.tile(CODE, 400) * np.exp(2j * np.pi * turns * n / len(n))
    rng = np.random.default_rng(3)
    samples = turning + np.sqrt(5) * (rng.standard_normal(len(n)) + 1j * rng.standard_normal(len(n)))
    record = Recording(samples=samples.astype(np.complex64), sample_rate_hz=50e6)
    result = sound(record, WAVEFORM, SoundingOptions(carrier_offset_hz=0.0))
    assert (result.blocks, result.taps.gain.shape) == (blocks, (1, blocks))
    noise = result.taps.noise_variance / 255 if blocks > 1 else 0.0
    law = np.mean(np.abs(result.taps.gain) ** 2) - noise
    assert 10 ** (result.path_gain_db / 10) == pytest.approx(law, rel=1e-4) and (noise > 1e-4 or blocks == 1)
