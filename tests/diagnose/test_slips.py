# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples that were lost where nothing is known, or between two parts of a recording: how many, and between which samples."""

import numpy as np
import pytest
from conftest_world import RATE_HZ, noise, sent_once
from gr_cast.diagnose import align, diagnose, pieces, policy, read_case, residual, run, search
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start


def _bursts(rng, count=24_000, every=3000, known=900):
    """(sent, what the twin knows of it): bursts of which the rest was never published."""
    x = noise(rng, count)
    told = np.where(np.arange(count) % every < known, x, np.nan)
    return x, told


def _without(y, at, lost):
    return np.concatenate([y[:at], y[at + lost :]])


def _turned(y, cycles):
    return y * np.exp(2j * np.pi * cycles * np.arange(len(y)))


@pytest.mark.parametrize("lost", [41, 1500, -300])
def test_stretches_end_where_samples_were_lost_between_bursts(lost):
    rng = np.random.default_rng(1)
    x, told = _bursts(rng)
    y = np.concatenate([noise(rng, 57), 0.1 * x])
    at = 57 + 4 * 3000 + 1900
    y = _without(y, at, lost) if lost > 0 else np.concatenate([y[:at], noise(rng, -lost), y[at:]])
    y = _turned(y, 3e-4) + noise(rng, len(y), 0.03)
    first, second = pieces.segments(y, [told], 57)
    assert (first[0], second[1]) == (0, len(y)) and 57 + 4 * 3000 + 900 <= first[1] == second[0] <= 57 + 5 * 3000 - lost
    assert abs(first[2] - 57) <= policy.SPREAD and abs(second[2] - (57 - lost)) <= policy.SPREAD


def test_a_clock_that_drifts_and_an_echo_that_takes_over_are_no_jumps():
    rng = np.random.default_rng(2)
    x, told = _bursts(rng)
    slow = np.interp(np.arange(24_000) * (1 - 4e-4), np.arange(24_000), np.convolve(x, np.ones(4) / 2, "same"))
    told = np.where(np.isnan(told), np.nan, np.convolve(x, np.ones(4) / 2, "same"))
    fading = 0.5 * np.sin(np.arange(24_000) / 2000)
    y = (0.5 + fading) * slow + (0.5 - fading) * np.roll(slow, 6)
    assert len(pieces.segments(y + noise(rng, 24_000, 0.1), [told], 0)) == 1


def test_samples_lost_between_bursts_are_counted_and_placed_between_them(tmp_path):
    rng = np.random.default_rng(3)
    x, told = _bursts(rng)
    y = _without(_turned(0.1 * np.concatenate([np.zeros(57), x]), 3e-4), 57 + 4 * 3000 + 1900, 41)
    y += noise(rng, len(y), 0.005)
    document = diagnose(sent_once(tmp_path, y, told)).document
    found = {e["family"]: e for e in document["effects"]}
    assert document["verdict"] == "identified" and set(found) == {"sample_loss", "carrier_frequency_offset"}
    assert found["sample_loss"]["parameters"]["samples"]["value"] == 41
    low, high = (t * RATE_HZ for t in found["sample_loss"]["where"]["time_s"])
    assert low <= 57 + 4 * 3000 + 1900 <= high and high - low < 2500
    assert found["carrier_frequency_offset"]["parameters"]["offset_hz"]["value"] == pytest.approx(300, abs=0.5)


def test_samples_lost_between_two_parts_of_a_long_recording_are_found_once(world, tmp_path, monkeypatch):
    monkeypatch.setattr(align, "LONGEST_WHOLE", 15_000)
    monkeypatch.setattr(align, "PART", 5_000)
    later = sum(gain * world.path(delay - 44) for delay, gain in world.taps)
    y = world.noisy(np.where(world.n < 10_000, world.clean(), 0.3 * np.exp(0.4j) * later))
    document = diagnose(read_case(world.write(tmp_path / "case", y))).document
    (loss,) = document["effects"]
    assert loss["family"] == "sample_loss" and document["verdict"] == "identified"
    assert loss["parameters"]["samples"]["value"] == 44
    low, high = (t * RATE_HZ for t in loss["where"]["time_s"])
    assert low <= 10_000 <= high and high - low < 500


def test_samples_lost_in_a_short_frame_are_found(tmp_path):
    rng = np.random.default_rng(4)
    x = np.repeat(rng.integers(0, 2, 180), 2).astype(complex)  # on-off keying
    y = _without(_turned(np.concatenate([0.2 * x, np.zeros(80)]), -0.035), 170, 37)
    y += noise(rng, len(y), 0.01)
    document = diagnose(sent_once(tmp_path, y, np.concatenate([x, np.zeros(80)]))).document
    found = {e["family"]: e for e in document["effects"]}
    assert set(found) == {"sample_loss", "carrier_frequency_offset"}
    assert found["sample_loss"]["parameters"]["samples"]["value"] == 37
    assert found["sample_loss"]["parameters"]["time_s"]["value"] * RATE_HZ == pytest.approx(170, abs=6)


def test_rails_that_are_none_leave_the_search_where_it_would_have_begun(tmp_path, monkeypatch):
    rng = np.random.default_rng(4)
    x = np.repeat(rng.integers(0, 2, 180), 2).astype(complex)
    y = _without(_turned(np.concatenate([0.2 * x, np.zeros(80)]), -0.035), 170, 37)
    y += noise(rng, len(y), 0.01)
    peak = float(max(np.abs(y.real).max(), np.abs(y.imag).max()))
    rails = start(FAMILIES["adc_clipping"], [peak, 0.0], free=[False, False], aux={"read": True, "lone": True})
    case, told = sent_once(tmp_path, y, np.concatenate([x, np.zeros(80)])), []
    for found in ([], [(rails, {"level": 1e-3, "samples": 9})]):
        monkeypatch.setattr(run.gate, "discrete", lambda y, datatype, found=found: found)
        told.append(diagnose(case).document["effects"])
    assert told[0] == told[1] and len(told[0]) == 2


def test_what_is_left_in_a_later_part_stands_at_its_time_in_the_recording(world, tmp_path, monkeypatch):
    monkeypatch.setattr(align, "LONGEST_WHOLE", 15_000)
    monkeypatch.setattr(align, "PART", 5_000)
    wrong = (world.n >= 16_000) & (world.n < 16_300)
    y = world.noisy(np.where(wrong, np.conj(world.clean()) * np.exp(0.01j * world.n**1.5), world.clean()))
    document = diagnose(read_case(world.write(tmp_path / "case", y))).document
    told = [w["time_s"] for w in document["residual"]["where"] if "time_s" in w]
    assert document["verdict"] == "unexplained" and "impulsive_noise" not in {e["family"] for e in document["effects"]}
    assert any(a * RATE_HZ < 16_300 and b * RATE_HZ > 16_000 for a, b in told)


def _short_frame(rng, folder, wrong):
    """The diagnosis of 255 chips, sent once, of which the samples `wrong` are heard amiss."""
    x = np.sign(rng.normal(size=255)).astype(complex)
    y = 0.2 * x + noise(rng, 255, 0.005)
    y[wrong] += noise(rng, len(wrong), 0.3)
    folder.mkdir()
    return diagnose(sent_once(folder, y, x)).document


def test_a_wrong_stretch_of_a_short_frame_is_placed_and_impulses_are_named(tmp_path):
    document = _short_frame(np.random.default_rng(5), tmp_path / "stretch", np.arange(140, 156))
    told = [w["time_s"] for w in document["residual"]["where"] if "time_s" in w]
    assert document["verdict"] == "unexplained" and not document["effects"]
    assert any(a * RATE_HZ < 156 and b * RATE_HZ > 140 for a, b in told)
    rng = np.random.default_rng(6)
    (impulses,) = _short_frame(rng, tmp_path / "impulses", rng.choice(255, 12, replace=False))["effects"]
    assert impulses["family"] == "impulsive_noise"


def test_beside_a_wrong_stretch_everything_else_is_found_as_without_it(world, tmp_path):
    turn = np.exp(2j * np.pi * 7.0 * world.n / RATE_HZ)
    wrong = (world.n >= 9_000) & (world.n < 10_500)
    y = world.noisy(np.where(wrong, np.roll(world.clean(), 5), world.clean()) * turn)
    document = diagnose(read_case(world.write(tmp_path / "case", y))).document
    assert document["verdict"] == "unexplained"
    (place,) = document["residual"]["where"]
    assert [t * RATE_HZ for t in place["time_s"]] == pytest.approx([9_000, 10_500], abs=200)
    (offset,) = document["effects"]
    assert offset["family"] == "carrier_frequency_offset"
    assert offset["parameters"]["offset_hz"]["value"] == pytest.approx(7.0, abs=4 * offset["parameters"]["offset_hz"]["std"])
    # the picture of the fit leaves the stretch in
    assert document["fit"]["corrected_nmse_db"] > document["fit"]["noise_floor_db"] + 10


@pytest.mark.parametrize("cause", ["none", "gain", "phase", "lost", "burst", "noise"])
def test_no_stretch_is_foreign_that_the_twin_only_hears_otherwise(world, tmp_path, cause):
    rng, y, inside = np.random.default_rng(7), world.clean(), (world.n >= 9_000) & (world.n < 11_000)
    changed = {
        "none": y,
        "gain": np.where(inside, 2.5 * y, y),
        "phase": np.where(inside, -y, y),
        "lost": np.where(world.n >= 16_000, np.roll(y, -40), y),
        "burst": np.where(inside | (world.n // 1000 % 5 == 1), y + noise(rng, len(y), 0.5), y),
        "noise": y + noise(rng, len(y), 0.3),
    }
    case = read_case(world.write(tmp_path / "case", world.noisy(changed[cause])))
    _, data, model = align.build(case, case.observations[0])
    assert residual.foreign(search.beginnings(data, model)[0]) is None


def test_what_follows_lost_samples_until_a_burst_ends_is_not_foreign(tmp_path):
    rng = np.random.default_rng(8)
    x = np.concatenate([noise(rng, 9_000), np.zeros(6_000)])
    case = sent_once(tmp_path, _without(0.2 * x, 7_000, 41) + noise(rng, 15_000 - 41, 0.01), x)
    _, data, model = align.build(case, case.observations[0])
    assert residual.foreign(search.beginnings(data, model)[0]) is None


@pytest.mark.parametrize(("at", "lost"), [(7_000, 15), (6_040, 1)])  # one in the middle lets a delay hide it from whole lags
def test_samples_lost_behind_a_delay_between_two_samples_are_counted_and_placed_exactly(tmp_path, at, lost):
    rng, count = np.random.default_rng(9), 12_000
    f = np.fft.fftfreq(count)
    spectrum = np.where(np.abs(f) < 0.1, rng.normal(size=count) + 1j * rng.normal(size=count), 0)
    x, late = (np.fft.ifft(spectrum * np.exp(-2j * np.pi * f * d)) * np.sqrt(count) for d in (0.0, 40.5))
    y = _without(0.2 * late, at, lost)
    (loss,) = diagnose(sent_once(tmp_path, y + noise(rng, len(y), 0.002), x)).document["effects"]
    assert loss["family"] == "sample_loss" and loss["parameters"]["samples"]["value"] == lost
    assert loss["parameters"]["time_s"]["value"] * RATE_HZ == pytest.approx(at, abs=1)
