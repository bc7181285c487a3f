# SPDX-License-Identifier: GPL-3.0-or-later
"""Playing a twin: the contract's formula, one stream whatever the chunks, other conditions, and the loop back to a diagnosis."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from gr_cast.core.errors import CastError
from gr_cast.diagnose import diagnose, read_case
from gr_cast.diagnose.write import write
from gr_cast.signals import recording
from gr_cast.twin.document import Waveform, read_twin
from gr_cast.twin.playback import LONGEST_PERIOD, Conditions, Grid, Playback, Sent, Tape
from scipy import signal

PROGRAM = Path(__file__).resolve().parents[2] / "apps" / "cast_emulator.py"
RATE_HZ, PERIOD = 1e6, 600
BLOCK, STEP = Grid().block, Grid().step
SILENT = Conditions(noise_power_db=-np.inf)


def shaped(seed: int = 9) -> np.ndarray:
    """One period of a complex waveform that fills half of its band."""
    rng = np.random.default_rng(seed)
    x = signal.resample(rng.normal(size=PERIOD // 2) + 1j * rng.normal(size=PERIOD // 2), PERIOD)
    return (x / np.sqrt(np.mean(np.abs(x) ** 2))).astype(np.complex64).astype(complex)


X = shaped()


def at(t):
    """The waveform at times t in samples: its Fourier series."""
    k = np.fft.fftfreq(PERIOD, 1 / PERIOD)
    return np.exp(2j * np.pi * np.outer(t, k) / PERIOD) @ np.fft.fft(X) / PERIOD


ALL = [
    ("iq_imbalance", "tx1", {"gain_imbalance_db": 0.4, "phase_imbalance_rad": 0.03}),
    ("lo_leakage", "tx1", {"level_dbc": -30.0}),
    ("pa_nonlinearity", "tx1", {"compression_db": 1.0, "memory": False}),
    ("extra_path", "tx1>rx1", {"delay_s": 2.13e-5, "gain_db": -12.0, "phase_rad": 1.0, "doppler_hz": 40.0}),
    ("tap_delay_error", "tx1>rx1", {"delay_s": 7.3e-6, "error_s": 4e-7}),
    ("sample_clock_offset", "tx1", {"offset_ppm": 20.0}),
    ("sample_loss", "rx1", {"time_s": 0.0655, "samples": 77}),
    ("carrier_frequency_offset", "rx1", {"offset_hz": 120.0, "drift_hz_per_s": 50.0}),
    ("front_end_filter", "rx1", {"ripple_db": 1.0}),
    ("gain_step", "rx1", {"time_s": 0.07, "step_db": -0.5}),
    ("power_supply_hum", "rx1", {"frequency_hz": 100.0, "depth": 0.05}),
    ("dc_offset", "rx1", {"level_dbc": -31.0}),
    ("tone_interference", "environment", {"frequency_hz": 1.1e5, "power_dbc": -33.0}),
]
LAWS = [
    ("phase_noise", "rx1", {"rms_rad": 0.05}),
    ("tap_fading", "tx1>rx1", {"delay_s": 0.0, "k_factor_db": 15.0, "doppler_spread_hz": 200.0}),
    ("signal_dependent_noise", "rx1", {"slope_db": -3.0}),
    ("pulsed_interference", "environment", {"period_s": 1e-3, "duty_cycle": 0.2, "power_dbc": -20.0}),
    ("impulsive_noise", "environment", {"rate_hz": 3e3, "power_db": 0.0}),
    ("narrowband_interference", "environment", {"frequency_hz": -2e5, "bandwidth_hz": 5e4, "power_dbc": -20.0}),
    ("quantization", "rx1", {"step": 2.0**-6}),
    ("adc_clipping", "rx1", {"level": 2.0}),
]
FILTER = {"side": "rx", "low": -1, "taps": [0.05, 0.02, -0.03, 0.01]}


def twin(folder: Path, effects=(), repeat=True, periods=1, **more) -> Path:
    """A twin of two paths, and its waveform beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    recording.write(folder / "wave", np.tile(X, periods), sample_rate_hz=RATE_HZ)
    levels = {"tx1": "tx", "rx1": "rx", "tx1>rx1": "link", "environment": "environment"}
    document = {
        "cast_twin": 1,
        "sample_rate_hz": RATE_HZ,
        "center_frequency_hz": 1e9,
        "waveforms": {"w1": {"file": "wave", "repeat": repeat}},
        "nodes": {"tx1": {"transmit": "w1", "amplitude": 1.0}, "rx1": {}},
        "links": [
            {
                "tx": "tx1",
                "rx": "rx1",
                "taps": [{"delay_s": 0.0}, {"delay_s": 7.3e-6, "gain_db": -6.0, "phase_rad": 0.7, "doppler_hz": 30.0}],
            }
        ],
        "recordings": [{"file": "recording", "receiver": "rx1", "transmitters": ["tx1"]}],
        "noise": {"rx1": {"power_db": -40.0}},
        "effects": [
            {
                "family": family,
                "owner": {"level": levels[owner], "name": owner},
                "parameters": {k: {"value": v, "std": 0} if isinstance(v, float | int) else v for k, v in numbers.items()},
                **({"model": FILTER} if family == "front_end_filter" else {}),
            }
            for family, owner, numbers in effects
        ],
        **more,
    }
    path = folder / "twin.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def played(path, count, conditions=SILENT) -> np.ndarray:
    case = read_twin(path)
    return Playback(case, case.observations[0], count, conditions).samples()


@pytest.mark.parametrize("repeat", [True, False])
def test_a_twin_plays_the_formula_of_the_contract(tmp_path, repeat):
    count = 3 * BLOCK
    y = played(twin(tmp_path, repeat=repeat, periods=1 if repeat else count // PERIOD + 9), count)
    n = np.arange(count)
    echo = 10 ** (-6 / 20) * np.exp(0.7j + 2j * np.pi * 30 * n / RATE_HZ)
    want = np.tile(X, count // PERIOD + 1)[:count] + echo * np.tile(at(np.arange(PERIOD) - 7.3), count // PERIOD + 1)[:count]
    late = 0 if repeat else 2000  # before that a waveform sent once has only begun
    assert np.sqrt(np.mean(np.abs(y - want)[late:] ** 2)) < 1e-4
    assert np.abs(y - want)[STEP - 50 : STEP + 50].max() < 1e-3


@pytest.mark.parametrize("repeat", [True, False])
def test_the_stream_is_the_same_in_any_chunks(tmp_path, repeat):
    count = BLOCK + 30_000
    case = read_twin(twin(tmp_path, ALL + LAWS, repeat=repeat, periods=1 if repeat else count // PERIOD + 9))
    conditions = Conditions(seed=5)
    whole = Playback(case, case.observations[0], count, conditions).samples()
    other = Playback(case, case.observations[0], count, conditions)
    backwards = [other.samples(first, 8191) for first in reversed(range(0, count, 8191))]
    assert np.array_equal(whole, np.concatenate(backwards[::-1]))
    assert not np.array_equal(whole, Playback(case, case.observations[0], count, Conditions(seed=6)).samples())


def test_a_period_sent_again_and_again_is_the_repeated_waveform(tmp_path):
    count = BLOCK + 30_000
    circle = played(twin(tmp_path / "a", ALL), count)
    line = played(twin(tmp_path / "b", ALL, repeat=False, periods=count // PERIOD + 9), count)
    assert np.abs(circle)[3000:].min() < np.abs(circle - line)[3000:].max() * 1e9  # both are there
    assert np.sqrt(np.mean(np.abs(circle - line)[3000:] ** 2) / np.mean(np.abs(circle) ** 2)) < 1e-3


def test_half_the_amplitude_is_bent_a_quarter_as_much_and_leaks_as_much_as_before(tmp_path):
    entry = twin(tmp_path, [ALL[1], ALL[2]])
    document = yaml.safe_load(entry.read_text())
    leak, bend = document["effects"]
    leak["model"], bend["model"] = {"sent_power": 1.0}, {"peak": float(np.abs(X).max())}
    entry.write_text(yaml.safe_dump(document))
    plain, alone = twin(tmp_path / "plain"), [tmp_path / "twin_of_the_leak.yaml", tmp_path / "twin_of_the_amplifier.yaml"]
    for path, effect in zip(alone, (leak, bend), strict=True):
        path.write_text(yaml.safe_dump(document | {"effects": [effect]}))
    half = Conditions(amplitude={"tx1": 0.5}, noise_power_db=-np.inf)
    leaked, cube = (played(one, 6000) - played(plain, 6000) for one in alone)
    less, bent = (played(one, 6000, half) - played(plain, 6000, half) for one in alone)
    assert np.abs(leaked).mean() > 0.01 and np.abs(cube).max() > 0.1
    assert np.abs(less - leaked).max() < 1e-5 and np.abs(bent - cube / 8).max() < 1e-5


@pytest.mark.parametrize("owner", ["tx1", "rx1"])
def test_another_carrier_scales_offset_and_doppler_and_turns_paths(tmp_path, owner):
    path = twin(tmp_path, [("carrier_frequency_offset", owner, {"offset_hz": 100.0})])
    y = played(path, 20_000, Conditions(center_frequency_hz=2e9 + 1e5, noise_power_db=-np.inf))
    n = np.arange(20_000)
    ratio = 2e9 / 1e9 + 1e-4
    echo = 10 ** (-6 / 20) * np.exp(0.7j - 2j * np.pi * (1e9 + 1e5) * 7.3e-6 + 2j * np.pi * 30 * ratio * n / RATE_HZ)
    if owner == "tx1":  # what is sent with an offset is late with it
        echo = echo * np.exp(-2j * np.pi * 100 * ratio * 7.3e-6)
    want = np.resize(X, len(n)) + echo * np.resize(at(np.arange(PERIOD) - 7.3), len(n))
    turned = y / want * np.exp(-2j * np.pi * 100 * ratio * n / RATE_HZ)
    assert np.median(np.abs(turned - np.median(turned))) < 1e-3


@pytest.mark.parametrize("owner", ["tx1", "rx1"])
def test_a_transmitters_hum_is_late_with_every_path_in_every_block(tmp_path, owner):
    count = BLOCK + 30_000
    y = played(twin(tmp_path, [("power_supply_hum", owner, {"frequency_hz": 9e3, "depth": 0.2})]), count)
    n = np.arange(count)
    hum = lambda t: 1 + 0.2 * np.cos(2 * np.pi * 9e3 * t / RATE_HZ)  # noqa: E731
    late = 7.3 if owner == "tx1" else 0.0
    echo = 10 ** (-6 / 20) * np.exp(0.7j + 2j * np.pi * 30 * n / RATE_HZ) * np.resize(at(np.arange(PERIOD) - 7.3), count)
    want = np.resize(X, count) * hum(n) + echo * hum(n - late)
    assert np.abs(y - want).max() < 2e-3 * np.abs(want).max()


def test_noise_is_the_twins_floor_and_white(tmp_path):
    path = twin(tmp_path)
    noise = played(path, 100_000, Conditions(seed=3)) - played(path, 100_000)
    assert np.mean(np.abs(noise) ** 2) == pytest.approx(1e-4, rel=0.02)
    density = signal.welch(noise, nperseg=64, return_onesided=False, detrend=False)[1]
    assert density.max() / density.min() < 1.4


@pytest.mark.parametrize("live", [False, True])
def test_a_tone_is_as_strong_as_told_beside_what_is_received_or_will_be_by_the_taps_where_nobody_knows(tmp_path, live):
    taps = [{"delay_s": 0.0, "gain_db": -6.0}, {"delay_s": 0.0, "gain_db": -8.0, "phase_rad": np.pi}]  # most of them cancels
    links = [{"tx": "tx1", "rx": "rx1", "taps": taps}]
    tape = Tape()
    tape.push(np.tile(X, 60).astype(np.complex64))
    conditions = Conditions(noise_power_db=-np.inf, transmit={"tx1": tape} if live else {})
    tone = ("tone_interference", "environment", {"frequency_hz": 1.1e5, "power_dbc": -10.0})
    with_tone, without = (
        played(twin(tmp_path / name, e, links=links), 20_000, conditions) for name, e in (("a", [tone]), ("b", []))
    )
    known = 10**-0.6 + 10**-0.8 if live else np.mean(np.abs(without) ** 2)
    assert np.mean(np.abs(with_tone - without) ** 2) == pytest.approx(0.1 * known, rel=1e-3)


def test_what_is_cut_out_of_a_waveform_rises_and_falls_smoothly_outside_of_what_is_asked_for():
    wave = Waveform(name="w", samples=np.ones(100_000), repeat=False, built_in=False)
    cut = Sent.of(wave, 0.5).around(20_000, 30_000, 400)
    inside = cut.samples[: 10_000 + 2 * 400].real
    assert cut.origin == 20_000 - 400 and not cut.repeat and not cut.samples[len(inside) :].any()
    assert np.all(inside[200:-200] == 0.5) and inside[0] == inside[-1] == 0
    for edge in (np.diff(inside[:201]), -np.diff(inside[-201:])):
        assert (edge >= 0).all() and edge.max() < 1.1 * np.pi / 2 * 0.5 / 200  # sin² from 0 to 1 over 200 samples


def test_a_long_period_begins_again_wherever_it_is_cut():
    size, margin = LONGEST_PERIOD + 1000, 100
    sent = Sent.of(Waveform(name="w", samples=np.arange(1, size + 1) / size, repeat=True, built_in=False), 2.0)
    for first, last in ((-700, 900), (size - 50, 2 * size + 30), (3 * size + 5, 3 * size + 10)):
        cut = sent.around(first, last, margin)
        inside = cut.samples[margin // 2 : margin // 2 + last - first + margin]
        assert np.array_equal(inside, 2 * (np.arange(first - margin // 2, last + margin // 2) % size + 1) / size)


@pytest.mark.parametrize(
    ("measured", "gain_db"), [({"other": -6.0, "third": -8.0}, -7.0), ({"other": -6.0, "recording": -20.0}, -20.0), ({}, 0.0)]
)
def test_the_gain_is_that_which_was_measured_in_this_recording_or_else_in_others(tmp_path, measured, gain_db):
    path = twin(tmp_path, [("carrier_frequency_offset", "rx1", {"offset_hz": 10.0})])
    document = yaml.safe_load(path.read_text())
    document["effects"][0]["model"] = {"gain_db": measured}
    path.write_text(yaml.safe_dump(document))
    case = read_twin(path)
    assert Playback(case, case.observations[0], 6000, SILENT).gain_db == pytest.approx(gain_db)


def test_power_and_peak_of_what_is_sent_are_those_of_all_of_it_scaled():
    samples = np.ones(LONGEST_PERIOD + 1000, complex)
    samples[-1] = 3j
    for repeat in (True, False):
        source = Sent.of(Waveform(name="w", samples=samples, repeat=repeat, built_in=False), 0.5).source
        assert source.peak == pytest.approx(1.5) and source.power == pytest.approx(0.25 * np.mean(np.abs(samples) ** 2))


@pytest.mark.parametrize(
    ("effects", "named"), [([], "the taps"), ([("gain_step", "rx1", {"time_s": 0.001, "step_db": 90.0})], "gain_step")]
)
def test_samples_beyond_any_number_are_laid_to_what_could_make_them(tmp_path, effects, named):
    path = twin(tmp_path, effects)
    with pytest.raises(CastError, match=f"levels of {named} are too large"):
        played(path, 6000, Conditions(amplitude={"tx1": 1e38}, gain_db=90.0, noise_power_db=-np.inf))


def test_rails_and_quantiser_come_after_the_noise(tmp_path):
    y = played(twin(tmp_path, LAWS[-2:]), 20_000, Conditions(seed=3))
    assert np.abs(y.real).max() == 2.0 and np.allclose(y.real * 64, np.round(y.real * 64), atol=1e-4)


SMALL = Grid(block=4096, end=512, margin=256)


def small(path, count, conditions=SILENT) -> Playback:
    case = read_twin(path)
    return Playback(case, case.observations[0], count, conditions, SMALL)


def test_a_tape_holds_what_was_pushed_and_not_yet_dropped():
    tape = Tape()
    assert (tape.first, tape.last) == (0, 0)
    tape.push(np.arange(5))
    tape.push(np.arange(5, 8))
    assert (tape.first, tape.last) == (0, 8) and tape[2:6].tolist() == [2, 3, 4, 5]
    tape.drop(3)
    tape.drop(1)  # what is gone is gone
    assert (tape.first, tape.last) == (3, 8) and tape[3:8].tolist() == [3, 4, 5, 6, 7] and tape[5:7].tolist() == [5, 6]
    tape.drop(99)
    assert (tape.first, tape.last) == (8, 8)
    tape.push(np.array([8]))
    assert tape[8:9].tolist() == [8]


@pytest.mark.parametrize("first", [-1000, -3, 0, 95, 500, 1500])
def test_outside_of_a_tape_or_a_waveform_sent_once_nothing_is_sent(first):
    wave = np.arange(1, 101) * (1 + 0.5j)
    tape = Tape()
    tape.push(wave)
    for waveform in (tape, Waveform(name="w", samples=wave, repeat=False, built_in=False)):
        cut = Sent.of(waveform, 2.0).around(first, first + 10, 8)
        n = np.arange(first - 4, first + 14)  # the outer half of the margin fades
        assert cut.origin == first - 8 and cut.known.all() and not cut.repeat
        want = np.where((n >= 0) & (n < 100), 2 * (n + 1) * (1 + 0.5j), 0)
        np.testing.assert_allclose(cut.samples[4 : 4 + len(n)], want, atol=1e-12)


def test_a_live_transmitter_has_power_one_as_far_as_anybody_knows():
    source = Sent.of(Tape(), 0.5).source
    assert (source.power, source.peak, source.repeat) == (pytest.approx(0.25), pytest.approx(0.5), False)


@pytest.mark.parametrize("size", [LONGEST_PERIOD, LONGEST_PERIOD + 1])
def test_a_period_up_to_the_longest_is_a_circle_and_a_longer_one_is_cut(size):
    sent = Sent.of(Waveform(name="w", samples=np.ones(size), repeat=True, built_in=False), 1.0)
    assert sent.around(0, 100, 40).repeat == (size == LONGEST_PERIOD)


def test_samples_that_are_not_known_cannot_be_played():
    for wrong in (np.nan, np.inf):
        with pytest.raises(CastError, match="waveform w: holds unknown samples"):
            Sent.of(Waveform(name="w", samples=np.array([1, wrong]), repeat=True, built_in=False), 1.0)


@pytest.mark.parametrize(
    ("condition", "says"),
    [
        ({"seed": -1}, "seed: got -1"), ({"seed": 1 << 64}, "seed: got 18446744073709551616"),
        ({"amplitude": {"tx1": -1e-9}}, "amplitude of tx1"), ({"amplitude": {"tx1": np.inf}}, "amplitude of tx1"),
        ({"center_frequency_hz": 0.0}, "carrier: got 0.0 Hz"), ({"center_frequency_hz": np.inf}, "carrier: got inf Hz"),
        ({"seed": (1 << 64) - 1}, None), ({"amplitude": {"tx1": 0.0}}, None), ({"center_frequency_hz": 1e-3}, None),
    ],
)  # fmt: skip
def test_conditions_have_limits(condition, says):
    if says is None:
        Conditions(**condition)
    else:
        with pytest.raises(CastError, match=says):
            Conditions(**condition)


@pytest.mark.parametrize(("count", "fits"), [(0, False), (1, True), (1 << 53, True), ((1 << 53) + 1, False)])
def test_a_stream_is_as_long_as_a_double_counts(tmp_path, count, fits):
    if fits:
        assert len(small(twin(tmp_path), count).samples(0, 3)) == min(count, 3)
    else:
        with pytest.raises(CastError, match="duration: got .* samples, needs 1 to"):
            small(twin(tmp_path), count)


def test_pieces_end_where_the_stream_does(tmp_path):
    playback = small(twin(tmp_path), 10_000)
    whole = playback.samples()
    assert len(whole) == 10_000 and whole.dtype == np.complex64
    assert np.array_equal(np.concatenate(list(playback.chunks(3000))), whole)
    assert [len(piece) for piece in playback.chunks(3000)] == [3000, 3000, 3000, 1000]
    assert np.array_equal(playback.samples(9990, 50), whole[9990:]) and len(playback.samples(10_000, 5)) == 0
    assert len(playback.samples(20_000)) == 0


@pytest.mark.parametrize("name", ["nothing", "sample_clock_offset", "sample_loss"])
def test_a_block_needs_what_it_says_and_no_more_than_paths_clock_and_margin_ask_for(tmp_path, name):
    """All else that is sent may be anything: what is live need not be known before."""
    lost = {"time_s": 0.0045, "samples": 77}
    effects = {"sample_clock_offset": {"offset_ppm": 500.0}, "sample_loss": lost}
    owner = "rx1" if name == "sample_loss" else "tx1"
    path = twin(tmp_path, [(name, owner, effects[name])] if name in effects else [])
    count, k, size = 12_000, 1, SMALL.step
    sent = np.tile(X, 40)

    def sending(samples):
        wave = Waveform(name="w", samples=samples, repeat=False, built_in=False)
        return small(path, count, Conditions(noise_power_db=-np.inf, transmit={"tx1": wave}))

    plain = sending(sent)
    first, last = plain.needs(k)
    begin, end = k * size - SMALL.end, k * size - SMALL.end + SMALL.block
    late, early = 8, 0  # of the paths
    moved = {"nothing": (0, 0), "sample_clock_offset": (end * 5e-4 + 1,) * 2, "sample_loss": (0, 77)}[name]
    assert begin - late - SMALL.margin - moved[0] <= first <= begin - late - SMALL.margin + moved[0] + 1
    assert end - early + SMALL.margin - 1 <= last <= end - early + SMALL.margin + moved[1] + 1
    outside = np.arange(len(sent))
    other = np.where((outside >= first) & (outside < last), sent, 1e3)
    loud = sending(other)
    loud.scene.rms = plain.scene.rms
    assert np.abs(loud.block(k) - plain.block(k)).max() < 1e-4 * np.abs(plain.block(k)).max()


def test_gain_carrier_offset_and_amplitude_of_the_conditions_are_heard(tmp_path):
    path, count = twin(tmp_path), 9000
    plain = small(path, count).samples()
    n = np.arange(count)
    for asked, law in (
        ({"gain_db": -20.0}, 0.1),
        ({"carrier_offset_hz": 120.0}, np.exp(2j * np.pi * 120 * n / RATE_HZ)),
        ({"amplitude": {"tx1": 0.25}}, 0.25),
    ):
        got = small(path, count, Conditions(noise_power_db=-np.inf, **asked)).samples()
        turned = np.vdot(plain * law, got)  # a carrier's phase is anybody's
        assert np.abs(got - plain * law * turned / abs(turned)).max() < 2e-3 * np.abs(plain).max()
        assert turned == pytest.approx(abs(turned)) or "carrier_offset_hz" in asked


@pytest.mark.parametrize(
    ("asked", "told", "measured", "power_db"),
    [
        (-30.0, -40.0, -50.0, -30.0),
        (None, -40.0, -50.0, -40.0),
        (None, None, -50.0, -50.0),
        (None, None, None, None),
        (0.0, -40.0, None, 0.0),
    ],
)
def test_noise_is_what_is_asked_for_or_told_or_measured_or_none(tmp_path, asked, told, measured, power_db):
    path = twin(
        tmp_path,
        [("carrier_frequency_offset", "rx1", {"offset_hz": 0.0})],
        noise={} if told is None else {"rx1": {"power_db": told}},
    )
    document = yaml.safe_load(path.read_text())
    if measured is not None:
        document["effects"][0]["model"] = {"noise_power_db": {"recording": measured}}
    path.write_text(yaml.safe_dump(document))
    count = 20_000
    noisy = small(path, count, Conditions(noise_power_db=asked))
    assert noisy.noise_power_db == power_db
    noise = noisy.samples() - small(path, count).samples()
    power = np.mean(np.abs(noise) ** 2)
    assert power == pytest.approx(10 ** (power_db / 10), rel=0.05) if power_db is not None else power == 0


def test_noise_over_a_floor_that_nobody_knows_is_not_heard(tmp_path):
    law = [("signal_dependent_noise", "rx1", {"slope_db": 3.0})]
    noise = [
        small(path, 9000, Conditions(seed=3)).samples() - small(path, 9000).samples()
        for path in (twin(tmp_path / "a", law), twin(tmp_path / "b", law, noise={}))
    ]
    told, unknown = (np.mean(np.abs(one) ** 2) for one in noise)
    assert told > 1e-4 and unknown < 1e-10


def test_two_random_effects_are_random_for_themselves(tmp_path):
    sparks = ("impulsive_noise", "environment", {"rate_hz": 2e4, "power_db": 10.0})
    still = ("dc_offset", "rx1", {"level_dbc": -90.0})
    heard = [
        small(path, 60_000, Conditions(seed=3)).samples() - small(path, 60_000).samples()
        for path in (twin(tmp_path / "a", [sparks]), twin(tmp_path / "b", [still, sparks]))  # the first and the second entry
    ]
    power = [np.abs(one) ** 2 - np.mean(np.abs(one) ** 2) for one in heard]
    assert min(np.count_nonzero(np.abs(one) > 0.3) for one in heard) > 300
    assert abs(np.vdot(*power)) / np.sqrt(np.vdot(power[0], power[0]) * np.vdot(power[1], power[1])) < 0.05
    assert abs(np.vdot(*heard)) / np.sqrt(np.vdot(heard[0], heard[0]).real * np.vdot(heard[1], heard[1]).real) < 0.05


def test_a_second_transmitter_sends_its_own_waveform_as_strong_and_late_as_told(tmp_path):
    other = shaped(11)
    recording.write(tmp_path / "other", other, sample_rate_hz=RATE_HZ)
    waveforms = {"w1": {"file": "wave", "repeat": True}, "w2": {"file": "other", "repeat": True}}
    second = ("second_transmitter", "environment", {"code": "w2", "gain_db": -9.0, "delay_s": 2e-5})
    heard = small(twin(tmp_path, [second], waveforms=waveforms), 9000).samples() - small(twin(tmp_path / "a"), 9000).samples()
    law = 10 ** (-9 / 20) * np.resize(np.roll(other, 20), 9000)
    turned = np.vdot(law, heard) / np.vdot(law, law)  # its phase is anybody's
    assert abs(turned) == pytest.approx(1, rel=1e-3) and np.abs(heard - turned * law).max() < 1e-3


def test_behind_a_joint_all_that_is_sent_is_needed_by_what_was_lost_later(tmp_path):
    lost = [("sample_loss", "rx1", {"time_s": 0.0045, "samples": 77})]
    plain, cut = small(twin(tmp_path / "a"), 12_000), small(twin(tmp_path / "b", lost), 12_000)
    assert plain.sample_rate_hz == RATE_HZ
    for k, moved in ((0, (0, 0)), (1, (0, 77)), (2, (77, 77))):  # before the joint, over it, and behind it
        assert np.subtract(cut.needs(k), plain.needs(k)).tolist() == list(moved)


def test_a_carrier_that_the_twin_does_not_know_cannot_be_moved(tmp_path):
    path = twin(tmp_path, center_frequency_hz=None)
    document = {k: v for k, v in yaml.safe_load(path.read_text()).items() if v is not None}
    path.write_text(yaml.safe_dump(document))
    assert len(small(path, 100).samples()) == 100
    with pytest.raises(CastError, match="recording: carrier: the twin does not say its own"):
        small(path, 100, Conditions(center_frequency_hz=2e9))


def test_receivers_hear_noise_of_their_own(tmp_path):
    links = [{"tx": "tx1", "rx": rx, "taps": [{"delay_s": 0.0}]} for rx in ("rx1", "rx2")]
    recordings = [{"file": f"recording{rx}", "receiver": f"rx{rx}", "transmitters": ["tx1"]} for rx in (1, 2)]
    nodes = {"tx1": {"transmit": "w1", "amplitude": 1.0}, "rx1": {}, "rx2": {}}
    tones = [("narrowband_interference", "environment", {"frequency_hz": -2e5, "bandwidth_hz": 5e4, "power_dbc": -20.0})]
    noise = {rx: {"power_db": -20.0} for rx in ("rx1", "rx2")}
    for effects in ([], tones):
        case = read_twin(
            twin(tmp_path / str(len(effects)), effects, links=links, recordings=recordings, nodes=nodes, noise=noise)
        )
        count = 40_000
        heard = [Playback(case, o, count, Conditions(seed=3), SMALL).samples() for o in case.observations]
        clean = [Playback(case, o, count, SILENT, SMALL).samples() for o in case.observations]
        one, other = (a - b for a, b in zip(heard, clean, strict=True))
        assert np.mean(np.abs(one) ** 2) > 0.009
        own = np.mean(np.abs(one) ** 2)
        assert abs(np.vdot(one, other)) / count < (0.05 if not effects else 1.0) * own


class World:
    """Recordings made by closed formulas: amplifier on a grid eight times finer, two paths, receiver, noise."""

    def __init__(self, name: str, amplitude: float, seed: int):
        self.name, self.amplitude, self.rng = name, amplitude, np.random.default_rng(seed)
        self.n = np.arange(12_000)

    def recorded(self) -> np.ndarray:
        fine = signal.resample(self.amplitude * X, 8 * PERIOD)
        if self.name == "pa_nonlinearity":
            fine = fine / (1 + (np.abs(fine) / 3) ** 4) ** 0.25  # C. Rapp 1991
        sent = signal.resample(fine, PERIOD)
        paths = [(0, 1.0), (9, 0.5 * np.exp(0.7j))] + [(23, 0.05)] * (self.name == "extra_path")
        y = 0.3 * np.exp(0.4j) * sum(a * sent[(self.n - 37 - d) % PERIOD] for d, a in paths)
        if self.name == "iq_imbalance":
            y = y + 0.03 * np.exp(1j) * np.conj(y)
        if self.name == "carrier_frequency_offset":
            y = y * np.exp(2j * np.pi * 31 * self.n / RATE_HZ)
        if self.name == "phase_noise":
            y = y * np.exp(1j * np.cumsum(self.rng.normal(size=len(y))) * np.sqrt(2 * np.pi * 0.3 / RATE_HZ))
        y = y + 0.003 * (self.rng.normal(size=len(y)) + 1j * self.rng.normal(size=len(y)))
        if self.name == "adc_clipping":
            y = np.clip(y.real, -0.6, 0.6) + 1j * np.clip(y.imag, -0.6, 0.6)
        return y

    def write(self, folder: Path, effects=()) -> Path:
        taps = [{"delay_s": 0.0}, {"delay_s": 9e-6, "gain_db": float(20 * np.log10(0.5)), "phase_rad": 0.7}]
        entry = {"file": "recording", "receiver": "rx1", "transmitters": ["tx1"], "amplitude": {"tx1": self.amplitude}}
        links = [{"tx": "tx1", "rx": "rx1", "taps": taps}]
        noise = {"rx1": {"power_db": float(20 * np.log10(0.003 * np.sqrt(2)))}}
        twin(folder, links=links, recordings=[entry], noise=noise, effects=list(effects))
        recording.write(folder / "recording", self.recorded(), sample_rate_hz=RATE_HZ, center_frequency_hz=1e9)
        return folder


@pytest.mark.parametrize(
    "name", ["pa_nonlinearity", "iq_imbalance", "carrier_frequency_offset", "extra_path", "phase_noise", "adc_clipping"]
)
def test_a_corrected_twin_has_nothing_to_learn_from_a_second_recording(tmp_path, name):
    first = diagnose(read_case(World(name, 1.0, 1).write(tmp_path / "first")))
    assert name in [e["family"] for e in first.document["effects"]]
    write(first, tmp_path / "diagnosis", "")
    second = World(name, 0.9 if name == "adc_clipping" else 0.6, 2).write(tmp_path / "second")
    told = yaml.safe_load((second / "twin.yaml").read_text())
    corrected = yaml.safe_load((tmp_path / "diagnosis" / "twin_corrected.yaml").read_text())
    (second / "twin.yaml").write_text(yaml.safe_dump(told | {"effects": corrected["effects"]}))
    assert diagnose(read_case(second)).document["verdict"] == "no_mismatch"


def emulator(*arguments) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, PROGRAM, *map(str, arguments)], capture_output=True, text=True, timeout=120)


def test_the_program_plays_what_a_diagnosis_wrote_and_never_overwrites(tmp_path):
    path = twin(tmp_path / "twin", ALL)
    command = ["--twin", path, "--output", tmp_path / "out", "--duration", 0.1, "--amplitude", "tx1=0.5", "--seed", 3]
    assert emulator(*command).returncode == 0
    taken = recording.read(tmp_path / "out" / "recording")
    assert taken.sample_rate_hz == RATE_HZ and taken.center_frequency_hz == 1e9 and len(taken.samples) == 100_000
    want = played(path, 100_000, Conditions(amplitude={"tx1": 0.5}, seed=3))
    assert np.array_equal(taken.samples, want)
    again = emulator(*command)
    assert again.returncode == 2 and "nothing is overwritten" in again.stderr


@pytest.mark.parametrize(
    "wrong",
    [
        ["--amplitude", "tx9=1"], ["--amplitude", "loud"], ["--recording", "other"], ["--duration", "-1"],
        ["--amplitude", "nan"], ["--amplitude", "tx1=-0.5"], ["--carrier", "0"], ["--seed", "-1"],
    ],
)  # fmt: skip
def test_a_wrong_condition_is_one_line_and_leaves_nothing(tmp_path, wrong):
    out = emulator("play", "--twin", twin(tmp_path / "twin"), "--output", tmp_path / "out", *wrong)
    assert out.returncode == 2 and out.stderr.startswith("error: ") and out.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_recording_stands_for_the_twins_own_waveform(tmp_path):
    path = twin(tmp_path / "twin", ALL)
    recording.write(tmp_path / "sent", np.tile(X, 180), sample_rate_hz=RATE_HZ)
    command = ["--twin", path, "--output", tmp_path / "out", "--no-noise", "--transmit", f"tx1={tmp_path / 'sent'}"]
    assert emulator(*command).returncode == 0
    got, own = recording.read(tmp_path / "out" / "recording").samples, played(path, 180 * PERIOD)
    assert len(got) == 180 * PERIOD
    assert np.sqrt(np.mean(np.abs(got - own)[3000:-200] ** 2) / np.mean(np.abs(own) ** 2)) < 1e-3


@pytest.mark.parametrize("most", [137, 5000])
def test_live_samples_meet_the_same_twin_however_they_are_scheduled(tmp_path, most):
    from gnuradio import blocks, gr
    from gr_cast.blocks.twin import LIVE_GRID, TwinReceiver

    relative = {"lo_leakage", "pa_nonlinearity", "dc_offset", "tone_interference"}  # to a power that is not known here
    case = read_twin(twin(tmp_path / "twin", [e for e in ALL if e[0] not in relative] + LAWS[:3]))
    conditions = Conditions(seed=4, amplitude={"tx1": 0.7})
    sent = np.tile(X, 200).astype(np.complex64)
    top = gr.top_block(catch_exceptions=False)
    source, sink = blocks.vector_source_c(sent.tolist()), blocks.vector_sink_c()
    receiver = TwinReceiver(case, case.observations[0], ("tx1",), conditions)
    receiver.set_max_noutput_items(most)
    top.connect(source, receiver, sink)
    top.run()
    got = np.array(sink.data())
    wave = Waveform(name="sent", samples=sent, repeat=False, built_in=False)
    told = Conditions(seed=4, amplitude={"tx1": 0.7}, transmit={"tx1": wave})
    want = Playback(case, case.observations[0], receiver.playback.count, told, LIVE_GRID).samples(0, len(got))
    assert len(got) > len(sent) - LIVE_GRID.block - receiver.delay_samples
    assert np.abs(got - want).max() < 1e-5


def test_what_a_live_peer_sends_that_is_no_number_is_counted_and_taken_as_nothing(tmp_path):
    from gnuradio import blocks, gr
    from gr_cast.blocks.twin import TwinReceiver

    case = read_twin(twin(tmp_path / "twin", []))
    sent = np.tile(X, 100).astype(np.complex64)
    sent[[700, 701, 40_000]] = complex(np.nan, 0), complex(0, np.inf), complex(np.inf, np.nan)
    got = []
    for samples in (sent, np.where(np.isfinite(sent), sent, 0)):
        top = gr.top_block(catch_exceptions=False)
        receiver, sink = TwinReceiver(case, case.observations[0], ("tx1",), Conditions(seed=4)), blocks.vector_sink_c()
        top.connect(blocks.vector_source_c(samples, False), receiver, sink)
        top.run()
        got.append(np.array(sink.data()))
        assert receiver.finite["tx1"].count == np.sum(~np.isfinite(samples))
    np.testing.assert_array_equal(*got)


def test_ports_bring_what_is_sent_and_take_what_is_received(tmp_path):
    path = twin(tmp_path / "twin", [ALL[0], ALL[7]])
    recording.write(tmp_path / "sent", np.tile(X, 200), sample_rate_hz=RATE_HZ)
    ports = ["--port", f"tx1:tx=file:{tmp_path / 'sent'}", "--port", f"rx1:rx=file:{tmp_path / 'got'}"]
    done = emulator("play", "--twin", path, "--no-noise", *ports)
    assert done.returncode == 0, done.stderr
    got, own = recording.read(tmp_path / "got").samples, played(path, 60_000_000)[: 200 * PERIOD]
    assert len(got) > 190 * PERIOD - (1 << 14)
    ratio = got[3000:] / own[3000 : len(got)]
    assert np.abs(ratio / ratio[0] - 1).max() < 0.02
