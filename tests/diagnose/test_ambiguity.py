# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be told apart is told as two families, with the easiest experiment that separates them."""

import numpy as np
import pytest
from gr_cast.diagnose import align, diagnose, read_case
from gr_cast.diagnose.next_recording import EXPERIMENTS, Hypothesis, record_next, separation
from gr_cast.diagnose.policy import TELLS_NATS
from gr_cast.diagnose.search import refit
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start


def _document(world, folder, y):
    return diagnose(read_case(world.write(folder, y)), budget_s=3000).document


def _with_late_phase(world, radians):
    """What arrives where the second path's phase differs by so much from what the twin says."""
    return 0.3 * np.exp(0.4j) * (world.path(0) + world.taps[1][1] * np.exp(1j * radians) * world.path(9))


@pytest.mark.parametrize("inverted", [True, False])
def test_of_a_real_code_over_two_paths_an_inversion_is_a_phase_of_the_late_one(world, tmp_path, inverted):
    # (1 + a·exp(jφ))* = 1 + a·exp(jφ)·exp(−2jφ): with a real code the two are one recording, but for the gain's phase
    phase = np.angle(world.taps[1][1])
    y = np.conj(world.clean()) if inverted else _with_late_phase(world, -2 * phase)
    document = _document(world, tmp_path / "case", world.noisy(y))
    assert document["verdict"] == "ambiguous"
    (entry,) = document["ambiguous"]
    assert set(entry["families"]) == {"spectral_inversion", "tap_gain_error"}
    assert entry["record_next"] in ("offset_carrier", "complex_waveform")


@pytest.mark.parametrize("gain", [0.14 * np.exp(-1.58j), 0.63 * np.exp(1.4555j), 0.9 * np.exp(1.0j)])
def test_however_far_the_late_path_turns_it_may_be_the_inversion(world, tmp_path, gain):
    """By nearly half a turn too, of a path nearly as strong as the first: the complex gain goes there straight."""
    world.taps = [(0, 1.0), (9, gain)]
    document = _document(world, tmp_path / "case", world.noisy(np.conj(world.clean())))
    assert [set(entry["families"]) for entry in document["ambiguous"]] == [{"spectral_inversion", "tap_gain_error"}]


def test_an_inversion_that_several_late_paths_tell_is_identified(world, tmp_path):
    world.taps = [*world.taps, (21, 0.4 * np.exp(2.0j)), (40, 0.3 * np.exp(-1.0j))]
    document = _document(world, tmp_path / "case", world.noisy(np.conj(world.clean())))
    assert document["verdict"] == "identified"
    assert [e["family"] for e in document["effects"]] == ["spectral_inversion"]


@pytest.mark.parametrize(("decay", "families"), [(0.8, {"front_end_filter", "diffuse_tail"}), (8.0, set())])
@pytest.mark.parametrize("noise_rms", [1e-2, 1e-3])
def test_a_tail_that_is_over_within_what_the_band_resolves_may_be_a_filter(world, tmp_path, decay, families, noise_rms):
    """Both are a row of taps; nothing but its length tells of scattering."""
    world.noise_rms, world.taps = noise_rms, [(0, 1.0)]
    index = np.arange(1021)
    world.code = {"code": "zadoff_chu", "length": 1021, "root": 7, "samples_per_chip": 1}
    world.x = np.exp(-1j * np.pi * 7 * index * (index + 1) / 1021)
    law = np.sqrt(0.3 * np.exp(-np.arange(64) / decay) / decay / 2)
    row = law * (world.rng.normal(size=64) + 1j * world.rng.normal(size=64))
    y = world.clean() + 0.3 * sum(gain * world.path(1 + k) for k, gain in enumerate(row))
    document = _document(world, tmp_path / "case", world.noisy(y))
    assert {family for entry in document["ambiguous"] for family in entry["families"]} == families
    assert families or [e["family"] for e in document["effects"]] == ["diffuse_tail"]


def test_one_family_at_two_places_is_no_pair_of_families(world, tmp_path):
    index = np.arange(509)
    world.code = {"code": "zadoff_chu", "length": 509, "root": 7, "samples_per_chip": 1}
    world.x = np.exp(-1j * np.pi * 7 * index * (index + 1) / 509)
    # the common gain is not known: either path may be the wrong one
    y = world.clean() - 0.1 * 0.3 * np.exp(0.4j) * world.taps[1][1] * world.path(9)
    document = _document(world, tmp_path / "case", world.noisy(y))
    assert [e["family"] for e in document["effects"]] == ["tap_gain_error"]
    assert document["verdict"] == "identified"
    assert document["ambiguous"] == []
    assert document["effects"][0]["evidence"]["runner_up"] != "tap_gain_error"


def _hypotheses(world, folder, y, *effects):
    case = read_case(world.write(folder, world.noisy(y)))
    _, data, model = align.build(case, case.observations[0])
    model = model.without(0) if model.inverted else model
    return [Hypothesis.of(refit(data, model.adding(effect))) for effect in effects]


def test_a_silent_transmitter_tells_dc_by_its_energy_over_the_noise(world, tmp_path):
    dc = start(FAMILIES["dc_offset"], [0.0, 0.0, 0.0], free=[True, True, False])
    leak = start(FAMILIES["lo_leakage"], [0.0, 0.0], aux={"source": 0})
    pair = _hypotheses(world, tmp_path / "case", world.clean() + 0.02, dc, leak)
    expected = len(world.n) * 0.02**2 / world.noise_rms**2
    assert separation(*pair, "mute_transmitter") == pytest.approx(expected, rel=0.05)
    assert separation(*pair, "complex_waveform") < TELLS_NATS
    assert record_next(pair) == next(name for name in EXPERIMENTS if separation(*pair, name) > TELLS_NATS)


def test_an_easy_experiment_that_tells_nothing_is_not_named(world, tmp_path):
    tap = start(FAMILIES["tap_gain_error"], [0.0, 0.0], aux={"tap": 1})
    turn = start(FAMILIES["spectral_inversion"], [])
    pair = _hypotheses(world, tmp_path / "case", np.conj(world.clean()), tap, turn)
    assert separation(*pair, "mute_transmitter") < 1
    assert separation(*pair, "second_power") < 1
    assert record_next(pair) == "offset_carrier"
    assert separation(*pair, "complex_waveform") > TELLS_NATS


def test_of_hypotheses_that_no_experiment_separates_a_longer_recording_is_asked(world, tmp_path):
    tap = start(FAMILIES["tap_gain_error"], [0.0, 0.0], aux={"tap": 1})
    same = _hypotheses(world, tmp_path / "case", world.clean(), tap, tap)
    assert record_next(same) == "longer_recording"
