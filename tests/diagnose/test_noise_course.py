# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens in one stretch of a recording says nothing of causes that hold throughout it: it is what is left."""

import numpy as np
import pytest
from conftest_world import RATE_HZ, noise, sent_once
from gr_cast.diagnose import align, diagnose, read_case
from gr_cast.diagnose.search import candidates, refit
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.noise_family import NoiseView

COURSE = FAMILIES["noise_course"]


def _view(energy):
    return NoiseView(use=np.ones(len(energy), bool), energy=energy, wanted_power=np.ones(len(energy)), weighted=energy + 0j)


@pytest.mark.parametrize("count", [600, 5000, 50_000])
def test_even_noise_has_no_course(count):
    rng = np.random.default_rng(count)
    assert sum(COURSE.find(_view(rng.exponential(size=count)))[1] is not None for _ in range(100)) <= 1


def test_levels_are_those_of_the_noise_but_for_the_cells_in_which_they_change():
    rng, count = np.random.default_rng(1), 20_000
    power, at = np.ones(count), np.arange(count)
    power[:3000], power[12_000:14_000] = 20.0, 4.0
    _, effect = COURSE.find(_view(power * rng.exponential(size=count)))

    class Scene:
        index = at

    found = COURSE.variance(Scene, effect, None)
    apart = np.min([abs(at - moment) for moment in (3000, 12_000, 14_000)], axis=0) > count / 128
    assert found[apart] == pytest.approx(power[apart], rel=0.15)


def _shifted(rng, count, longest=24):
    """A wave of one amplitude whose frequency is one of eight for a symbol at a time."""
    symbols = rng.integers(8, size=count // longest + 1).repeat(longest)[:count]
    return np.exp(2j * np.pi * np.cumsum((symbols - 3.5) / 64))


def test_a_receiver_that_settles_speaks_for_no_cause_that_holds_throughout(tmp_path):
    """Beside a path that fades no gain, and of a wave of one amplitude no amplifier."""
    rng, count = np.random.default_rng(5), 5000
    sent, k = _shifted(rng, count), np.arange(count)
    turns = np.exp(2j * np.pi * k / count)
    fading = sum(noise(rng, 1, 0.25 / m)[0] * turns**m for m in (-3, -2, -1, 1, 2, 3))
    settles = np.minimum(1.0, 0.2 + k / 300) * (1 + 0.8 * np.exp(-k / 200) * np.cos(k / 15))
    heard = 0.3 * (1 + fading) * settles * sent + noise(rng, count, 0.3 * 10 ** (-44 / 20))
    case = sent_once(tmp_path, heard, sent)
    part, near = align.parts_of(case, case.observations[0])[0]
    _, data, model = align.build(case, part, near=near)
    faded = max((refit(data, model.adding(s.effect)) for s in candidates(refit(data, model))[:2]), key=lambda f: f.evidence)
    assert [e.family for e in faded.model.effects] == ["tap_fading"]
    best = candidates(faded)[0].effect
    assert best.family == "noise_course"
    (begin_s, end_s) = FAMILIES[best.family].where(data.scene, best, {})["time_s"]
    assert begin_s == 0.0 and 300 < end_s * RATE_HZ < 1200


def test_impulses_are_no_stretches_of_louder_noise_whatever_the_signal_promises(world, tmp_path):
    hit = world.rng.random(len(world.n)) < 0.002
    heard = world.noisy(world.clean() + 0.01 * world.path(200)) + noise(world.rng, len(world.n), 1.0) * hit
    case = read_case(world.write(tmp_path / "case", heard))
    _, data, model = align.build(case, case.observations[0])
    told = [s.effect.family for s in candidates(refit(data, model))]
    assert told[0] == "impulsive_noise" and "noise_course" in told


def test_a_burst_of_noise_at_the_end_of_a_long_recording_is_left(world, tmp_path):
    """Where the first parts of it fit: what lies in one stretch speaks for itself."""
    world.n = np.arange(240_000)
    heard = world.clean() + noise(world.rng, len(world.n), world.noise_rms)
    heard[205_000:220_000] += noise(world.rng, 15_000, 0.7 * world.noise_rms)
    document = diagnose(read_case(world.write(tmp_path / "case", heard)), budget_s=100).document
    assert (document["verdict"], document["effects"]) == ("unexplained", [])
    begin_s, end_s = document["residual"]["where"][0]["time_s"]
    assert [begin_s * RATE_HZ, end_s * RATE_HZ] == pytest.approx([205_000, 220_000], abs=1000)
