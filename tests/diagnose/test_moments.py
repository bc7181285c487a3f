# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens at one moment of a recording: samples that are lost, however near its ends, several times, beside a tone."""

import numpy as np
import pytest
from conftest_world import RATE_HZ, noise, sent_once
from gr_cast.diagnose import align, diagnose, read_case
from gr_cast.diagnose.search import refit, search
from gr_cast.signals import codes
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start

RUN = 25  # samples at a stretch of the vault, in which no joint is placed


def lost(world, *joints):
    """The clean signal with (first sample behind it, samples lost) at every joint."""
    ahead = sum((lost * (world.n >= at) for at, lost in joints), np.zeros_like(world.n))
    other = type(world)()
    other.n, other.taps, other.x = world.n + ahead, world.taps, world.x
    return other.clean()


def losses(document):
    told = [e for e in document["effects"] if e["family"] == "sample_loss"]
    return {round(e["parameters"]["time_s"]["value"] * RATE_HZ): e["parameters"]["samples"]["value"] for e in told}


@pytest.mark.parametrize(("at", "samples"), [(19_880, 44), (19_930, 5), (80, 44), (120, -7), (19_900, 1)])
def test_samples_lost_in_the_first_and_last_hundredth_are_found(world, tmp_path, at, samples):
    case = read_case(world.write(tmp_path / "case", world.noisy(lost(world, (at, samples)))))
    document = diagnose(case, budget_s=3000).document
    assert document["verdict"] == "identified" and len(document["effects"]) == 1
    ((time, number),) = losses(document).items()
    assert abs(time - at) <= RUN and number % 510 == samples % 510


def test_every_loss_of_several_is_found(world, tmp_path):
    joints = [(4_321, 40), (9_876, -13), (15_432, 7)]
    case = read_case(world.write(tmp_path / "case", world.noisy(lost(world, *joints))))
    document = diagnose(case, budget_s=3000).document
    assert document["verdict"] == "identified" and len(document["effects"]) == 3
    found = sorted(losses(document).items())
    assert [number % 510 for _, number in found] == [number % 510 for _, number in joints]
    assert np.allclose([time for time, _ in found], [at for at, _ in joints], atol=RUN)


@pytest.mark.parametrize("at", [150, 19_850])
def test_a_step_of_gain_in_the_first_and_last_hundredth_is_found(world, tmp_path, at):
    y = world.noisy(world.clean() * np.where(world.n < at, 1.0, 10 ** (3 / 20)))
    (step,) = diagnose(read_case(world.write(tmp_path / "case", y)), budget_s=3000).document["effects"]
    assert step["family"] == "gain_step"
    assert step["parameters"]["time_s"]["value"] * RATE_HZ == pytest.approx(at, abs=RUN)


def test_samples_lost_near_the_end_are_found_beside_a_step_of_gain(world, tmp_path):
    y = lost(world, (19_700, 5)) * np.where(world.n < 12_345, 1.0, 10 ** (0.8 / 20))
    document = diagnose(read_case(world.write(tmp_path / "case", world.noisy(y))), budget_s=3000).document
    assert {e["family"] for e in document["effects"]} == {"gain_step", "sample_loss"} and document["verdict"] == "identified"


def test_a_tone_goes_on_in_the_air_while_samples_are_lost(world, tmp_path):
    at, samples, cycles_per_sample = 11_111, 44, 0.20317
    air = world.n + samples * (world.n >= at)
    y = lost(world, (at, samples)) + 0.05 * np.exp(2j * np.pi * cycles_per_sample * air)
    document = diagnose(read_case(world.write(tmp_path / "case", world.noisy(y))), budget_s=3000).document
    assert document["verdict"] == "identified"
    assert sorted(e["family"] for e in document["effects"]) == ["sample_loss", "tone_interference"]
    ((time, number),) = losses(document).items()
    assert abs(time - at) <= 2 and number == samples


def test_samples_that_were_miscounted_beside_a_wrong_clock_are_counted_again(world, tmp_path):
    """One sample too many and a clock that gives most of it back: what a search may begin with beside a carrier offset."""
    at, samples = 7200, 5
    world.taps, world.code["samples_per_chip"] = world.taps[:1], 4
    world.x = codes.from_spec(world.code).astype(complex)
    y = lost(world, (at, samples)) * np.exp(2j * np.pi * 3000.0 * (world.n + samples * (world.n >= at)) / RATE_HZ)
    case = read_case(world.write(tmp_path / "case", world.noisy(y)))
    _, data, model = align.build(case, case.observations[0])
    carrier = start(FAMILIES["carrier_frequency_offset"], [60.0, 0.0])
    loss = start(FAMILIES["sample_loss"], [at, samples + 1.0], free=[False, False])
    clock = start(FAMILIES["sample_clock_offset"], [-1.38])
    begun = refit(data, model.adding(carrier).adding(loss).adding(clock))
    best = search(data, [begun])[0]
    found = {e.family: e.p for e in best.model.found}
    assert found["sample_loss"].tolist() == [at, samples]
    assert set(found) == {"sample_loss", "carrier_frequency_offset"}


def test_samples_lost_soon_after_a_burst_begins_are_found_beside_a_strong_tone(tmp_path):
    """The tone makes some delays in the end likelier, alone, than the true one is in the few samples before the joint."""
    rng, count, begins, at, samples = np.random.default_rng(3), 26_000, 1100, 1450, -46
    chips = rng.choice([1, 1j, -1, -1j], 8000)
    shaped = np.convolve(np.kron(chips, [1, 0, 0, 0]), np.hanning(9), "same")
    time = np.arange(count) + samples * (np.arange(count) >= at) - begins - min(samples, 0)
    sent = np.concatenate([shaped[:27_000], np.zeros(count)])
    y = np.where(time >= 0, sent[np.maximum(time, 0)], 0)
    y = y + 0.12 * np.exp(2j * np.pi * 0.130014 * time) + noise(rng, count, 0.01)
    found = diagnose(sent_once(tmp_path, y, shaped[:27_000]), budget_s=3000).document
    assert sorted(e["family"] for e in found["effects"]) == ["sample_loss", "tone_interference"]
    ((place, number),) = losses(found).items()
    assert abs(place - at) <= RUN and number == samples
