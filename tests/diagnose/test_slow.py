# SPDX-License-Identifier: GPL-3.0-or-later
"""What is too slow to be seen in one part of a long recording, or happens between two of its parts."""

import numpy as np
import pytest
import yaml
from conftest_world import COUNT, RATE_HZ, World, noise, sent_once
from gr_cast.diagnose import align, diagnose, read_case, slow
from gr_cast.twin.effects import Role


@pytest.fixture
def in_parts(monkeypatch):
    """Recordings of 20,000 samples are long: eight parts of 1500 with gaps of 1143 between them."""
    monkeypatch.setattr(align, "LONGEST_WHOLE", 15_000)
    monkeypatch.setattr(align, "PART", 1_500)


def _diagnosed(world, folder, factor):
    return diagnose(read_case(world.write(folder / "case", world.noisy(world.clean() * factor)))).document


def _of(world, folder, recorded, effects, **twin):
    """The diagnosis of a recording by a twin that has effects of its own."""
    folder = world.write(folder / "case", recorded)
    known = yaml.safe_load((folder / "twin.yaml").read_text()) | {"effects": effects} | twin
    (folder / "twin.yaml").write_text(yaml.safe_dump(known))
    return diagnose(read_case(folder)).document


def _own(family, level="rx", name="rx1", **parameters):
    return {"family": family, "owner": {"level": level, "name": name}, "parameters": parameters}


def _told(effect, name):
    return effect["parameters"][name]["value"], effect["parameters"][name]["std"]


def test_a_steady_gain_is_no_mismatch(world, tmp_path, in_parts):
    document = _diagnosed(world, tmp_path, 1.0)
    assert document["verdict"] == "no_mismatch" and not document["effects"]


def test_a_slow_drift_is_told_over_the_whole_recording(world, tmp_path, in_parts):
    document = _diagnosed(world, tmp_path, 10 ** (0.2 * world.n / COUNT / 20))
    (drift,) = document["effects"]
    assert document["verdict"] == "identified" and drift["family"] == "gain_drift"
    total_db, std = _told(drift, "total_db")
    assert std < 0.02 and total_db == pytest.approx(0.2, abs=4 * std)
    assert drift["where"]["time_s"] == [0.0, COUNT / RATE_HZ] and drift["evidence"]["heldout_gain_nats"] > 0


def test_a_receiver_whose_gain_drifts_has_no_other_noise_floor(world, tmp_path, in_parts, monkeypatch):
    monkeypatch.setattr(align, "PART", 2_500)
    y = world.noisy(world.clean()) * 10 ** (1.2 * world.n / COUNT / 20)
    document = diagnose(read_case(world.write(tmp_path / "case", y))).document
    (drift,) = document["effects"]
    total_db, std = _told(drift, "total_db")
    assert drift["family"] == "gain_drift" and std < 0.02 and total_db == pytest.approx(1.2, abs=4 * std)


def test_a_gain_that_warms_up_has_its_time_constant(world, tmp_path, in_parts):
    tau = 0.15
    shape = np.expm1(-world.n / COUNT / tau) / np.expm1(-1 / tau)
    (drift,) = _diagnosed(world, tmp_path, 10 ** (0.5 * shape / 20))["effects"]
    assert drift["family"] == "gain_drift"
    total_db, std = _told(drift, "total_db")
    assert total_db == pytest.approx(0.5, abs=4 * std)
    assert _told(drift, "time_constant_s")[0] * RATE_HZ / COUNT == pytest.approx(tau, rel=0.3)


@pytest.mark.parametrize("at", [7_200, 10_060, 12_000])
def test_a_step_between_two_parts_or_in_one_is_placed_where_it_is(world, tmp_path, in_parts, at):
    document = _diagnosed(world, tmp_path, np.where(world.n >= at, 10 ** (0.4 / 20), 1.0))
    (step,) = document["effects"]
    assert document["verdict"] == "identified" and step["family"] == "gain_step"
    step_db, std = _told(step, "step_db")
    assert step_db == pytest.approx(0.4, abs=4 * std)
    time_s, std = _told(step, "time_s")
    assert std * RATE_HZ < 300 and time_s * RATE_HZ == pytest.approx(at, abs=4 * std * RATE_HZ)


def test_samples_lost_between_two_parts_are_placed_exactly(world, tmp_path, in_parts):
    at = 10_060
    later = sum(gain * world.path(delay - 44) for delay, gain in world.taps)
    y = np.where(world.n < at, world.clean(), 0.3 * np.exp(0.4j) * later)
    (loss,) = diagnose(read_case(world.write(tmp_path / "case", world.noisy(y)))).document["effects"]
    assert loss["family"] == "sample_loss" and loss["parameters"]["samples"]["value"] == 44
    assert loss["parameters"]["time_s"]["value"] * RATE_HZ == pytest.approx(at, abs=2)


def _turning(world, hz):
    """The world's recording with its second path at a Doppler."""
    (_, first), (delay, second) = world.taps
    turn = np.exp(2j * np.pi * hz * world.n / RATE_HZ)
    return 0.3 * np.exp(0.4j) * (first * world.path(0) + second * turn * world.path(delay))


def test_a_path_that_the_twin_knows_to_move_has_turned_before_a_later_part(world, tmp_path, in_parts):
    links = world.twin()["links"]
    links[0]["taps"][1]["doppler_hz"] = 210.0
    document = _of(world, tmp_path, world.noisy(_turning(world, 210.0)), [], links=links)
    assert document["verdict"] == "no_mismatch" and not document["effects"]


@pytest.mark.parametrize("drift", [0.0, 0.02])  # cycles over the recording and its square
def test_a_carrier_that_hardly_turns_within_a_part_is_told_by_all(world, tmp_path, in_parts, drift):
    u, whole_s = world.n / COUNT, COUNT / RATE_HZ
    document = _diagnosed(world, tmp_path, np.exp(2j * np.pi * (0.02 * u + 0.5 * drift * u**2)))
    (offset,) = document["effects"]
    assert offset["family"] == "carrier_frequency_offset" and offset["where"]["time_s"] == [0.0, whole_s]
    for name, true in (("offset_hz", 0.02 / whole_s), ("drift_hz_per_s", drift / whole_s**2)):
        told, std = _told(offset, name)
        assert std < 0.15 * 0.02 / whole_s ** (1 + name.startswith("drift")) and told == pytest.approx(true, abs=4 * std)


def test_a_clock_that_hardly_slips_within_a_part_is_told_by_all(world, tmp_path, in_parts):
    gained, f = 0.03, np.fft.fftfreq(2 * COUNT)  # samples over the recording
    late = world.clean()
    spectrum = np.fft.fft(np.concatenate([late, late[::-1]]))
    slope = np.fft.ifft(2j * np.pi * f * spectrum)[:COUNT]
    document = diagnose(read_case(world.write(tmp_path / "case", world.noisy(late + gained * world.n / COUNT * slope)))).document
    (clock,) = document["effects"]
    told_ppm, std = _told(clock, "offset_ppm")
    assert clock["family"] == "sample_clock_offset" and told_ppm == pytest.approx(gained / COUNT * 1e6, abs=4 * std)


def test_a_step_too_small_to_be_seen_in_its_part_is_placed_by_the_level_there(world, tmp_path, in_parts, monkeypatch):
    monkeypatch.setattr(align, "PART", 2_500)
    at = 11_000
    (step,) = _diagnosed(world, tmp_path, np.where(world.n >= at, 10 ** (0.04 / 20), 1.0))["effects"]
    step_db, std = _told(step, "step_db")
    assert step["family"] == "gain_step" and step_db == pytest.approx(0.04, abs=4 * std)
    time_s, std = _told(step, "time_s")
    assert std * RATE_HZ < 1000 and time_s * RATE_HZ == pytest.approx(at, abs=4 * std * RATE_HZ)


def test_a_carrier_that_is_seen_within_parts_is_told_as_exactly_as_all_of_them_know(world, tmp_path, in_parts):
    hz = 0.5 / COUNT * RATE_HZ
    (offset,) = _diagnosed(world, tmp_path, np.exp(2j * np.pi * hz * world.n / RATE_HZ))["effects"]
    told_hz, std = _told(offset, "offset_hz")
    assert offset["family"] == "carrier_frequency_offset" and std < 0.1 and told_hz == pytest.approx(hz, abs=4 * std)


def test_a_drift_that_the_twin_has_is_in_every_part_with_the_noise_that_it_raises(world, tmp_path, in_parts, monkeypatch):
    monkeypatch.setattr(align, "PART", 2_500)
    for total_db, tau in ((1.2, None), (3.0, 0.05)):
        shape = world.n / COUNT if tau is None else np.expm1(-world.n / COUNT / tau) / np.expm1(-1 / tau)
        told = {"total_db": total_db} | ({} if tau is None else {"time_constant_s": tau * COUNT / RATE_HZ})
        y = world.noisy(world.clean()) * 10 ** (total_db * shape / 20)
        document = _of(world, tmp_path / str(total_db), y, [_own("gain_drift", **told)])
        assert document["verdict"] == "no_mismatch" and not document["effects"]


def test_samples_lost_behind_some_that_the_twin_knows_to_be_lost_are_those_alone(world, tmp_path, in_parts):
    heard = lambda lost: 0.3 * np.exp(0.4j) * sum(gain * world.path(delay - lost) for delay, gain in world.taps)  # noqa: E731
    y = world.noisy(np.where(world.n < 4_700, heard(0), np.where(world.n < 15_000, heard(30), heard(74))))
    (loss,) = _of(world, tmp_path, y, [_own("sample_loss", time_s=4_700 / RATE_HZ, samples=30)])["effects"]
    assert loss["family"] == "sample_loss" and loss["parameters"]["samples"]["value"] == 44
    assert loss["parameters"]["time_s"]["value"] * RATE_HZ == pytest.approx(15_000, abs=2)


def test_a_gain_without_a_course_is_left_unexplained(world, tmp_path, in_parts):
    document = _diagnosed(world, tmp_path, 10 ** (0.3 * np.sin(2 * np.pi * world.n / COUNT) / 20))
    assert document["verdict"] == "unexplained" and not document["effects"]
    assert "0.56 dB from part to part" in document["residual"]["where"][0]["test"]


@pytest.mark.parametrize("noise_rms", [2.0, 3.0])
def test_phases_that_may_have_turned_any_number_of_times_between_parts_tell_no_carrier(tmp_path, in_parts, noise_rms):
    world, hz = World(5), 4.5 / COUNT * RATE_HZ  # 0.34 cycles in a part, which the noise hides, and 0.6 from part to part
    world.noise_rms = noise_rms
    effects = _diagnosed(world, tmp_path, np.exp(2j * np.pi * hz * world.n / RATE_HZ))["effects"]
    assert all(abs(_told(e, "offset_hz")[0] - hz) < 4 * _told(e, "offset_hz")[1] for e in effects)


def test_a_part_that_is_silent_at_first_has_the_phase_of_what_is_heard(tmp_path, in_parts):
    rng, hz = np.random.default_rng(3), 0.03 / COUNT * RATE_HZ
    sent = noise(rng, COUNT)
    late = 0.5 * np.concatenate([np.zeros(3_000), sent[: COUNT - 3_000]])
    recorded = late * np.exp(2j * np.pi * hz * np.arange(COUNT) / RATE_HZ) + noise(rng, COUNT, 0.01)
    found = diagnose(sent_once(tmp_path, recorded, sent))
    first = found.findings[0]
    middle = first.scene.begins + slow._amidst(first, Role.DRIFT)
    assert first.scene.begins == 2_000 and middle == pytest.approx((3_000 + 2_000 + first.scene.span) / 2, abs=60)
    (offset,) = found.document["effects"]
    for name, true in (("offset_hz", hz), ("drift_hz_per_s", 0.0)):
        told, std = _told(offset, name)
        assert offset["family"] == "carrier_frequency_offset" and told == pytest.approx(true, abs=3.5 * std)
