# SPDX-License-Identifier: GPL-3.0-or-later
"""Twin and recording brought together: where a waveform is, which part of a long recording is looked at, what is held out."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import yaml
from conftest_world import RATE_HZ, noise, sent_once
from gr_cast.core.errors import CastError
from gr_cast.diagnose import align, delays, diagnose, policy, read_case
from gr_cast.diagnose.search import beginnings, delayed_again, refit
from gr_cast.signals import codes, recording
from gr_cast.twin import document
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start
from gr_cast.twin.entries import source_of


@pytest.fixture
def burst(tmp_path):
    """burst(recorded, sent): a case of a waveform that is sent once."""
    return partial(sent_once, tmp_path)


def test_a_recording_is_trimmed_to_what_is_known_and_the_waveform_stays_in_place(burst):
    rng = np.random.default_rng(1)
    x = noise(rng, 9000)
    y = 0.1 * np.roll(x, 7) + noise(rng, 9000, 0.01)
    x[:3000] = x[3800:] = np.nan
    found = burst(y, x)
    (part, near), *others = align.parts_of(found, found.observations[0])
    assert not others and near == (7 - part.first, False)
    assert part.first == 3007 - policy.ALIGN_MARGIN and len(part.samples) == 800 + 2 * policy.ALIGN_MARGIN


@pytest.mark.parametrize("recorded", [10_007, 53_017, 139_241, 260_003])  # primes
def test_parts_are_as_long_as_transforms_are_quick_and_hardly_less_than_the_recording(burst, recorded):
    x = noise(np.random.default_rng(1), recorded)
    found = burst(0.1 * x, x)
    parts = [part for part, _ in align.parts_of(found, found.observations[0])]
    for part in parts:
        left = len(part.samples)
        for factor in (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31):
            while left % factor == 0:
                left //= factor
        assert left == 1
    assert recorded - sum(len(part.samples) for part in parts) < recorded / 400
    assert parts[0].whole == recorded and align.quick(97) == 97 and align.quick(1 << 12) == 1 << 12


def test_a_burst_is_found_in_a_long_recording_and_only_its_surroundings_are_looked_at(burst):
    rng = np.random.default_rng(2)
    x, at = noise(rng, 20_000), 101_234
    y = noise(rng, 260_000, 0.02)
    y[at : at + len(x)] += 0.1 * x * np.exp(2j * np.pi * 30.0 * np.arange(len(x)) / RATE_HZ)
    found = burst(y, x)
    parts = align.parts_of(found, found.observations[0])
    assert all(near == (at - part.first, False) for part, near in parts)
    assert min(part.first for part, _ in parts) >= at - 2 * policy.LEAST_PART


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("offset_hz", [0.0, -790.0, RATE_HZ / 80])
@pytest.mark.parametrize(("sent", "recorded", "at"), [(20_000, 84_000, 9_169), (2_000, 84_000, 50_000), (4_000, 3_000, -700)])
def test_no_offset_hides_what_is_sent_once_wherever_it_is(burst, sent, recorded, at, offset_hz, inverted):
    rng = np.random.default_rng(6)
    x, y = noise(rng, sent), noise(rng, recorded, 0.2)
    first, last = max(0, at), min(recorded, at + sent)
    y[first:last] += 0.1 * (x * np.exp(2j * np.pi * offset_hz * np.arange(sent) / RATE_HZ))[first - at : last - at]
    found = burst(np.conj(y) if inverted else y, x)
    assert align.locate(found, found.observations[0]) == (at, inverted)


def test_a_silence_and_a_loud_stranger_are_not_taken_for_a_burst(burst):
    rng = np.random.default_rng(7)
    x, y, at = noise(rng, 3_000), noise(rng, 60_000, 0.02), 31_000
    x[:300], x[1_000:1_900], y[:4_000] = 0.0, 0.0, 0.0
    y[at : at + len(x)] += 0.1 * x
    y[45_000:50_000] += noise(rng, 5_000, 10.0)
    found = burst(y, x)
    assert align.locate(found, found.observations[0]) == (at, False)


def test_pulses_with_silence_between_them_are_found_in_noise(burst):
    rng = np.random.default_rng(8)
    x, y, at = np.zeros(3_000, complex), noise(rng, 3_900), 500
    x[::300] = 1.0
    y[at : at + len(x)] += 6 * x
    found = burst(y, x)
    assert align.locate(found, found.observations[0]) == (at, False)


def test_a_burst_of_one_code_again_and_again_is_where_it_begins_and_ends(burst):
    rng = np.random.default_rng(10)
    x, y, at = np.tile(np.sign(rng.normal(size=378)), 33), noise(rng, 17_000, 0.1), 2_227
    y[at : at + len(x)] += x
    found = burst(y, x)
    assert align.locate(found, found.observations[0]) == (at, False)


def test_one_click_is_not_taken_for_a_burst(burst):
    rng = np.random.default_rng(9)
    x, y, at = noise(rng, 3_000), noise(rng, 9_000), 5_000
    y[at : at + len(x)] += x
    y[2_500] += 1_000.0
    found = burst(y, x)
    assert align.locate(found, found.observations[0]) == (at, False)


def test_the_vault_is_one_valid_run_in_eight_whatever_is_valid():
    for count, run in ((800, 4), (64_000, 16)):
        valid = np.zeros(3 * count, bool)
        valid[1::3] = True
        vault = align.split(valid)
        assert vault.sum() == count // 8 and not (vault & ~valid).any()
        runs = vault[valid].reshape(-1, run)
        assert (runs.all(1) == runs.any(1)).all() and (runs[:, 0].reshape(-1, 8).sum(1) == 1).all()


def test_a_long_file_stays_on_disk_and_its_slices_are_those_of_the_whole(burst, tmp_path, monkeypatch):
    rng = np.random.default_rng(3)
    x = noise(rng, 5000)
    monkeypatch.setattr(document, "LONGEST_IN_MEMORY", 4000)
    found = burst(0.1 * x, x)
    stored, whole = found.observations[0].samples, recording.read(tmp_path / "recording").samples
    assert isinstance(stored, recording.Stored) and len(stored) == 5000
    assert (stored[1234:2345] == whole[1234:2345]).all() and (stored[4990:9999] == whole[4990:]).all()
    assert found.waveforms["w1"].level[0] == pytest.approx(np.mean(np.abs(x) ** 2))
    assert align.parts_of(found, found.observations[0])[0][1] == (0, False)


@pytest.mark.parametrize("offset_hz", [-11e3, 3e3])
def test_a_carrier_offset_does_not_hide_a_waveform_that_is_sent_once(burst, offset_hz):
    rng = np.random.default_rng(3)
    x = noise(rng, 30_000)
    turned = np.roll(x, 12) * np.exp(2j * np.pi * offset_hz * np.arange(len(x)) / RATE_HZ)
    found = burst(0.1 * turned + noise(rng, len(x), 0.03), x)
    assert align.locate(found, found.observations[0]) == (12, False)
    short = burst(0.1 * turned[:9000] + noise(rng, 9000, 0.03), x[:6000])
    assert align.locate(short, short.observations[0]) == (12, False)


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("carrier", [0.0, 0.002, -0.05])
def test_a_repeated_code_20_db_below_the_noise_is_found_under_any_carrier_and_either_way_round(
    world, tmp_path, carrier, inverted
):
    rng = np.random.default_rng(4)
    world.x = noise(rng, 510)
    y = world.path(0) * np.exp(2j * np.pi * carrier * world.n)
    folder = world.write(tmp_path / "case", (np.conj(y) if inverted else y) + noise(rng, len(y), 10.0))
    recording.write(folder / "sent", world.x, sample_rate_hz=RATE_HZ)
    link = world.twin()["links"][0] | {"taps": [{"delay_s": 0.0}]}
    twin = world.twin() | {"waveforms": {"w1": {"file": "sent", "repeat": True}}, "links": [link]}
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin))
    case = read_case(folder)
    assert align.locate(case, case.observations[0]) == (37, inverted)


def test_lines_of_a_waveform_say_nothing_of_its_delay_and_nothing_else_is_taken_for_one():
    """Two thirds of the power in one line; a code, noise, a comb of pilots and a tone stay as they are."""
    rng, n = np.random.default_rng(11), np.arange(1921)
    x = noise(rng, len(n))

    def elsewhere(sent):
        held = np.abs(np.fft.ifft(np.abs(np.fft.fft(sent)) ** 2)) ** 2
        return held[1:].mean() / held[0]

    lined = x + 1.5 * np.exp(2j * np.pi * 1579 * n / len(n))
    assert elsewhere(lined) > 0.4 and elsewhere(delays.without_lines(lined)) < 0.01
    comb = np.fft.ifft(np.where(np.arange(2040) % 12 == 0, np.exp(2j * np.pi * rng.random(2040)), 0))
    code = codes.from_spec({"code": "glfsr", "degree": 8, "mask": 0, "seed": 1, "samples_per_chip": 4})
    for other in (x, comb, code.astype(complex), np.exp(2j * np.pi * 5 * n / len(n))):
        assert np.array_equal(delays.without_lines(other), other)


@pytest.mark.parametrize("seed", range(4))
def test_a_weak_waveform_of_which_stretches_are_known_is_not_taken_for_its_mirror_image(tmp_path, seed):
    rng = np.random.default_rng(seed)
    sent = np.where(np.arange(24_000) // 100 % 6 == 0, noise(rng, 24_000), np.nan)
    y = np.where(np.isnan(sent), noise(rng, 24_000), sent)
    case = sent_once(tmp_path, y + noise(rng, 24_000, 10**0.65), sent)
    assert align.locate(case, case.observations[0]) == (0, False)


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("carrier", [-0.1, 0.065])
def test_a_waveform_that_is_sent_once_is_found_under_a_carrier_of_a_tenth_of_the_rate(burst, carrier, inverted):
    rng = np.random.default_rng(8)
    x = noise(rng, 12_000)
    y = noise(rng, 12_500, 0.1)
    y[137 : 137 + len(x)] += x * np.exp(2j * np.pi * carrier * np.arange(len(x)))
    found = burst(np.conj(y) if inverted else y, x)
    assert align.locate(found, found.observations[0]) == (137, inverted)


def _chirps(rng) -> np.ndarray:
    """A packet as a chirp radio sends it: eight upwards, two downwards, twelve that begin in their middle; two samples per
    chip of 256."""
    chip = np.arange(512) / 2
    up = [np.exp(2j * np.pi * np.cumsum(((chip + shift) % 256) / 256 - 0.5) / 2) for shift in (0, *rng.integers(0, 256, 12))]
    return np.concatenate([np.tile(up[0], 8), np.tile(np.conj(up[0]), 2), *up[1:]])


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("carrier", [0.0, 0.0096, -0.03, 0.05])
def test_a_chirp_with_a_carrier_is_not_taken_for_a_chirp_a_little_later(burst, carrier, inverted):
    rng = np.random.default_rng(9)
    x = _chirps(rng)
    y = noise(rng, len(x) + 900, 0.3)
    y[402 : 402 + len(x)] += x * np.exp(2j * np.pi * carrier * np.arange(len(x)))
    found = burst(np.conj(y) if inverted else y, x)
    assert align.locate(found, found.observations[0]) == (402, inverted)


@pytest.mark.parametrize("carrier", [0.0059, -0.012])
def test_a_slow_chirp_with_a_carrier_is_not_taken_for_one_a_sweep_later(burst, carrier):
    """A Zadoff–Chu sequence of root 11 sweeps its band eleven times, and is like itself after each; two samples per chip."""
    rng, k = np.random.default_rng(9), np.arange(4999)
    x = np.fft.ifft(np.pad(np.fft.fft(np.exp(-1j * np.pi * 11 * k * (k + 1) / len(k))), (0, len(k)))) * 2
    x *= np.exp(-0.5j * np.pi * np.arange(len(x)))  # around the carrier again
    y = noise(rng, len(x) + 4_000, 0.3)
    y[1_402 : 1_402 + len(x)] += x * np.exp(2j * np.pi * carrier * np.arange(len(x)))
    found = burst(y, x)
    assert align.locate(found, found.observations[0]) == (1_402, False)


def test_what_is_like_itself_is_not_taken_for_the_beginning_of_a_burst(burst):
    rng = np.random.default_rng(31)
    symbol, x = noise(rng, 100), noise(rng, 6_000)
    x += np.tile(symbol, 60)  # and so it is once more, half as well, after every 100 samples
    y, at = noise(rng, 5_900, 0.1), 2_218  # later than what is looked at first
    y[at:] += 0.2 * x[: len(y) - at] * np.exp(0.4j)
    found = burst(y, x)
    assert align.locate(found, found.observations[0]) == (at, False)


def carrying(world, tmp_path, hz, entries):
    """The fit of a twin that tells `entries`, [(family, parameter, value, std)], to a recording that turns with `hz`."""
    twin = world.twin() | {
        "effects": [
            {"family": family, "owner": {"level": "rx", "name": "rx1"}, "parameters": {name: {"value": value, "std": std}}}
            for family, name, value, std in entries
        ]
    }
    world.twin = lambda: twin
    y = world.noisy(world.clean() * np.exp(2j * np.pi * hz * world.n / RATE_HZ))
    case = read_case(world.write(tmp_path / "case", y))
    _, data, model = align.build(case, case.observations[0])
    return refit(data, model)


@pytest.mark.parametrize("sigmas", [-1.7, 0.3, 2.5])
def test_a_twins_carrier_is_where_the_recording_has_it_within_what_the_twin_leaves_open(world, tmp_path, sigmas):
    fit = carrying(world, tmp_path, 900.0 + 150.0 * sigmas, [("carrier_frequency_offset", "offset_hz", 900.0, 150.0)])
    assert fit.sigma2 < 1.1 * world.noise_rms**2


def test_a_twins_carrier_is_not_where_the_twin_says_it_cannot_be(world, tmp_path):
    fit = carrying(world, tmp_path, 900.0 + 10 * 150.0, [("carrier_frequency_offset", "offset_hz", 900.0, 150.0)])
    assert fit.sigma2 > 5 * world.noise_rms**2


def test_a_carrier_beside_a_fast_clock_may_be_told_in_the_seconds_of_either(world, tmp_path):
    carrier, clock = 90e3, 200e-6  # as told; seen by that clock it lies 18 Hz off
    told = [("carrier_frequency_offset", "offset_hz", carrier, 0.0), ("sample_clock_offset", "offset_ppm", 1e6 * clock, 0.0)]
    lines, period = np.fft.fft(world.x) / len(world.x), len(world.x)
    tones = [(a, np.fft.fftfreq(period)[k]) for k, a in enumerate(lines) if k != period // 2]
    world.path = lambda delay: sum(a * np.exp(2j * np.pi * f * (world.n * (1 + clock) - delay - 37)) for a, f in tones)
    fit = carrying(world, tmp_path, carrier * (1 + clock), told)
    assert fit.sigma2 < 1.5 * world.noise_rms**2


@pytest.mark.parametrize("late", [0, 100, 777])
def test_of_a_repeated_waveform_nothing_is_fitted_where_it_is_not_known(tmp_path, late):
    rng = np.random.default_rng(41)
    x = noise(rng, 1_000)
    recording.write(
        tmp_path / "recording", np.resize(np.roll(x, late), 20_000) + noise(rng, 20_000, 0.01), sample_rate_hz=RATE_HZ
    )
    x[400:700] = np.nan
    found = sent_once(tmp_path, np.resize(np.roll(np.nan_to_num(x), late), 20_000), x)
    twin = (tmp_path / "twin.yaml").read_text().replace("repeat: false", "repeat: true")
    (tmp_path / "twin.yaml").write_text(twin)
    found = read_case(tmp_path)
    _, data, _ = align.build(found, found.observations[0])
    fitted = (np.flatnonzero(data.use) - late) % 1_000
    assert len(fitted) > 8_000 and not ((fitted >= 400) & (fitted < 700)).any()


def _in_pieces(folder, known, late):
    """A case of a repeated waveform of which `known` samples of every 120 are known, over paths of 0 and `late` samples."""
    rng = np.random.default_rng(44)
    x = noise(rng, 960)
    heard = np.resize(x + 0.6 * np.roll(x, late), 40_000) + noise(rng, 40_000, 0.01)
    sent_once(folder, heard, np.where(np.arange(960) % 120 < known, x, np.nan))
    twin = yaml.safe_load((folder / "twin.yaml").read_text())
    twin["waveforms"]["w1"]["repeat"] = True
    twin["links"][0]["taps"].append({"delay_s": late / RATE_HZ, "gain_db": float(20 * np.log10(0.6)), "phase_rad": 0.0})
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin))
    return read_case(folder)


def test_pieces_that_are_hardly_longer_than_the_paths_are_compared_where_all_of_them_is_known(tmp_path):
    found = _in_pieces(tmp_path, known=90, late=50)
    _, data, _ = align.build(found, found.observations[0])
    at = np.flatnonzero(data.use) % 120
    assert len(at) > 4000 and at.min() >= 50 and at.max() < 90
    assert diagnose(found).document["verdict"] == "no_mismatch"


def test_pieces_that_are_shorter_than_the_paths_are_refused(tmp_path):
    found = _in_pieces(tmp_path, known=40, late=50)
    with pytest.raises(CastError, match="known nowhere for as long as the paths are, 50 samples"):
        diagnose(found)


def test_an_edge_of_what_is_known_does_not_ring_into_what_is_read_beside_it(tmp_path):
    rng, delay = np.random.default_rng(43), 30.5  # between two samples
    lines = np.where(np.abs(np.fft.fftfreq(2_000)) < 0.125, noise(rng, 2_000), 0.0)  # a signal of a quarter of the band
    x = np.fft.ifft(lines) * np.sqrt(2_000 * 4)
    late = np.fft.ifft(lines * np.exp(-2j * np.pi * np.fft.fftfreq(2_000) * delay)) * np.sqrt(2_000 * 4)
    recording.write(tmp_path / "recording", np.resize(late, 20_000), sample_rate_hz=RATE_HZ)
    for begin in range(0, 2_000, 200):
        x[begin : begin + 90] = np.nan
    sent_once(tmp_path, np.resize(late, 20_000), x)
    (tmp_path / "twin.yaml").write_text((tmp_path / "twin.yaml").read_text().replace("repeat: false", "repeat: true"))
    found = read_case(tmp_path)
    fit = refit(*align.build(found, found.observations[0])[1:])
    assert 10 * np.log10(fit.sigma2 / np.mean(np.abs(late) ** 2)) < -52


@pytest.mark.parametrize("lost", [700, -300, 3000])
def test_a_waveform_is_found_where_the_twin_says_it_is_whatever_samples_the_twin_knows_to_be_lost(tmp_path, lost):
    rng = np.random.default_rng(4)
    sent = noise(rng, 12_000, 1.0)
    air = np.concatenate([np.zeros(900), sent, np.zeros(1500)])
    recorded = np.concatenate([air[:4000], air[4000 + lost :]])  # most of it lies behind the joint
    sent_once(tmp_path, recorded + noise(rng, len(recorded), 0.3), sent)
    loss = {"time_s": {"value": 4000 / RATE_HZ, "std": 0.0}, "samples": {"value": lost, "std": 0.0}}
    twin = yaml.safe_load((tmp_path / "twin.yaml").read_text())
    twin["effects"] = [{"family": "sample_loss", "owner": {"level": "rx", "name": "rx1"}, "parameters": loss}]
    (tmp_path / "twin.yaml").write_text(yaml.safe_dump(twin))
    case = read_case(tmp_path)
    assert align.locate(case, case.observations[0]) == (900, False)
    assert diagnose(case).document["verdict"] == "no_mismatch"


def _band_limited(samples):
    return np.fft.ifft(np.fft.fft(samples) * (np.abs(np.fft.fftfreq(len(samples))) < 0.4))


@pytest.mark.parametrize("late", [0, 5, 300])
def test_a_waveform_sent_once_is_where_it_is_however_late_its_first_path_is(tmp_path, late):
    rng, count = np.random.default_rng(4), 30_000
    sent = _band_limited(noise(rng, count + 1000, 1.0))
    recorded = np.concatenate([np.zeros(late), sent])[:count]
    sent_once(tmp_path, recorded + noise(rng, count, 0.03), sent)
    twin = yaml.safe_load((tmp_path / "twin.yaml").read_text())
    twin["links"][0]["taps"] = [{"delay_s": late / RATE_HZ, "gain_db": 0.0, "phase_rad": 0.0, "doppler_hz": 0.0}]
    (tmp_path / "twin.yaml").write_text(yaml.safe_dump(twin))
    case = read_case(tmp_path)
    assert align.locate(case, case.observations[0]) == (0, False)
    assert align.locate(case, case.observations[0], (7, False)) == (0, False)
    assert diagnose(case).document["verdict"] == "no_mismatch"


@pytest.mark.parametrize("late", [-1, 0, 1])
@pytest.mark.parametrize("family, side", [("sample_loss", "rx"), ("gain_step", "rx"), ("gain_step", "tx")])
def test_what_the_twin_knows_to_happen_at_a_moment_may_happen_at_the_sample_before_or_behind(tmp_path, family, side, late):
    """Times are rounded: k/rate·rate is not k for every k. At a transmitter it is as late as the path."""
    rng, at, count, behind = np.random.default_rng(4), 14_203, 30_000, 5
    sent = _band_limited(noise(rng, count + 400, 1.0))
    heard = np.concatenate([np.zeros(behind), sent])
    told = {"time_s": {"value": at / RATE_HZ, "std": 0.0}}
    if family == "sample_loss":
        recorded = np.concatenate([heard[: at + late], heard[at + late + 182 :]])[:count] + noise(rng, count, 0.03)
        told["samples"] = {"value": 182, "std": 0.0}
    else:
        step = np.where(np.arange(count) < at + late + (behind if side == "tx" else 0), 1.0, 10 ** (5.4 / 20))
        recorded = heard[:count] * step + noise(rng, count, 0.03) * (1.0 if side == "tx" else step)
        told["step_db"] = {"value": 5.4, "std": 0.0}
    sent_once(tmp_path, recorded, sent)
    twin = yaml.safe_load((tmp_path / "twin.yaml").read_text())
    twin["links"][0]["taps"] = [{"delay_s": behind / RATE_HZ, "gain_db": 0.0, "phase_rad": 0.0, "doppler_hz": 0.0}]
    twin["effects"] = [{"family": family, "owner": {"level": side, "name": side + "1"}, "parameters": told}]
    (tmp_path / "twin.yaml").write_text(yaml.safe_dump(twin))
    case = read_case(tmp_path)
    _, data, _ = align.build(case, case.observations[0])
    beside = np.abs(data.scene.index - at - (behind if side == "tx" else 0)) < 2
    assert beside.sum() == 3 and not data.use[beside].any() and not data.vault[beside].any()
    assert diagnose(case).document["verdict"] == "no_mismatch"


def test_a_delay_is_found_again_once_the_carrier_is_known(world, tmp_path):
    """A code at a delay of its own is 255 times what it is at any other (its periodic autocorrelation)."""
    turned = world.clean() * np.exp(2j * np.pi * 3000.0 * world.n / RATE_HZ)
    case = read_case(world.write(tmp_path / "case", world.noisy(turned)))
    _, data, model = align.build(case, case.observations[0])
    offset = start(FAMILIES["carrier_frequency_offset"], [3000.0 * len(world.n) / RATE_HZ, 0.0], free=[True, False])
    wrong = refit(data, replace(model, base=model.base + 150 * np.eye(len(model.base))[0]).adding(offset))
    found = delayed_again(data, wrong)
    assert abs(wrong.model.base[0] - 37) > 100 and abs(found.model.base[0] - 37) < 0.1
    assert found.sigma2 < 1.2 * world.noise_rms**2


def test_a_transmitters_carrier_turns_late_paths_by_what_they_are_late_at_every_delay(world, tmp_path):
    world.taps, carrier = [(0, 1.0), (51, 0.9 * np.exp(-1.5j))], 65_300.0  # in 51 µs it turns by 3.33 cycles
    late = sum(a * world.path(d) * np.exp(2j * np.pi * carrier * (world.n - d) / RATE_HZ) for d, a in world.taps)
    case = read_case(world.write(tmp_path / "case", world.noisy(0.3 * late)))
    _, data, model = align.build(case, case.observations[0])
    wrong = replace(model, base=np.array([37.0 - 51.0 + 510.0, 1e-3, 0.0]))  # one path stands where the other is
    found = beginnings(data, wrong)[0]
    assert abs(found.model.base[0] - 37) < 0.1 and found.sigma2 < 1.2 * world.noise_rms**2


def test_codes_of_several_periods_are_no_chirp():
    rng, y = np.random.default_rng(2), np.ones(2_000, complex)
    sources = [source_of(name, noise(rng, size), 1.0, True) for name, size in (("a", 510), ("b", 254))]
    taps = [[document.Tap(delay_s=0.0)]] * 2
    assert delays.of_one_carrier([y], sources, taps, RATE_HZ, [3]) is None


def test_a_clipped_chirp_with_a_carrier_stays_where_it_is(tmp_path):
    rng = np.random.default_rng(9)
    x = _chirps(rng)
    y = noise(rng, len(x) + 900, 0.002)
    y[402 : 402 + len(x)] += 0.1 * x * np.exp(2j * np.pi * 0.0247 * np.arange(len(x)))
    y = np.clip(y.real, -0.099, 0.099) + 1j * np.clip(y.imag, -0.099, 0.099)
    told = {e["family"]: e for e in diagnose(sent_once(tmp_path, y, x), budget_s=3000).document["effects"]}
    assert set(told) == {"carrier_frequency_offset", "adc_clipping"}
    assert told["carrier_frequency_offset"]["parameters"]["offset_hz"]["value"] == pytest.approx(0.0247 * RATE_HZ, abs=1)


@pytest.mark.parametrize("carrier", [0.06, -0.095])
@pytest.mark.parametrize("inverted", [False, True])
def test_bursts_of_one_training_sequence_are_where_they_are_under_a_fast_carrier(tmp_path, carrier, inverted):
    """Frequency modulation of one level: with a carrier that nobody knows, short stretches of any two bursts are alike. What
    follows what does not change with the carrier."""
    rng = np.random.default_rng(7)
    training, bursts = rng.integers(0, 2, 26), []
    for _ in range(3):
        bits = np.concatenate([rng.integers(0, 2, 58), training, rng.integers(0, 2, 58)])
        smooth = np.convolve(np.repeat(2.0 * bits - 1, 5), np.hanning(13) / np.hanning(13).sum(), "same")
        bursts += [np.exp(0.5j * np.pi * np.cumsum(smooth) / 5), np.zeros(2000)]
    sent, at, count = np.concatenate(bursts), 13_403, 33_240
    y = np.zeros(count, complex)
    y[at : at + len(sent)] = sent
    y = y * np.exp(2j * np.pi * carrier * np.arange(count)) + noise(rng, count, 0.03)
    case = sent_once(tmp_path, np.conj(y) if inverted else y, sent)
    found, mirrored = align.locate(case, case.observations[0])
    assert abs(found - at) <= 2 and mirrored == inverted
