# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects that together leave nothing, and are pieces of what no family is: a filter that changes, an oscillator that hops."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest_world import RATE_HZ
from gr_cast.diagnose import align, diagnose, read_case
from gr_cast.diagnose.doubts import doubts
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start
from scipy import ndimage


def run(world, tmp_path, y):
    return diagnose(read_case(world.write(tmp_path / "case", y)), budget_s=300).document


@pytest.mark.parametrize("swings", [0.0, 0.9])
def test_an_echo_that_swings_is_no_two_echoes_of_one_place(world, tmp_path, swings):
    course = (1 - swings) + swings * np.cos(2 * np.pi * 3.2 * world.n / len(world.n) + 0.4)
    document = run(world, tmp_path, world.noisy(world.clean() + 0.12 * course * world.path(11)))
    assert all(e["family"] == "extra_path" for e in document["effects"])
    if not swings:
        assert document["verdict"] == "identified" and len(document["effects"]) == 1
        return
    assert document["verdict"] == "unexplained"
    rest = next(rest for rest in document["residual"]["where"] if rest["test"].startswith("two of one place"))
    assert np.array(rest["delay_s"]) * RATE_HZ == pytest.approx([11.0, 11.0], abs=0.2)


@pytest.mark.parametrize("alike", [True, False])
def test_paths_that_all_change_alike_do_not_fade(world, tmp_path, alike):
    def course():
        steps = world.rng.normal(size=(2, 24)).T @ [1, 1j]
        smooth = ndimage.zoom(steps.real, len(world.n) / 24, order=3) + 1j * ndimage.zoom(steps.imag, len(world.n) / 24, order=3)
        return 1 + 0.4 * smooth

    first = course()
    paths = [a * world.path(d) * (first if alike or not k else course()) for k, (d, a) in enumerate(world.taps)]
    document = run(world, tmp_path, world.noisy(0.3 * sum(paths)))
    tests = [rest["test"] for rest in document["residual"]["where"]]
    assert any(test.startswith("paths change alike") for test in tests) is alike
    assert (document["verdict"] == "unexplained") is alike


@pytest.mark.parametrize(("steps", "faint", "told"), [(1, 0, False), (2, 0, False), (3, 0, True), (2, 1, True), (1, 2, False)])
def test_a_gain_in_four_pieces_is_of_no_family(world, tmp_path, steps, faint, told):
    """Where most of them are sure: of the others chance may have made some."""
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean())))
    scene, *_ = align.build(case, case.observations[0])
    hum = start(FAMILIES["power_supply_hum"], [0.01, 0.0, 7.0])
    effects = [hum, *(start(FAMILIES["gain_step"], [0.1, (1 + k) / 8]) for k in range(steps + faint))]
    fit = SimpleNamespace(model=SimpleNamespace(effects=effects))
    gains = [60.0] * (1 + steps) + [9.0] * faint
    finding = SimpleNamespace(fit=fit, scene=scene, is_cause=lambda effect: True, gain_of=lambda index: gains[index])
    assert bool(doubts(finding)) is told


def test_four_paths_that_fade_each_on_its_own_are_no_pieces_of_a_gain(world, tmp_path):
    world.taps = [(0, 1.0), (9, 0.5), (21, 0.3), (33, 0.2)]
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean())))
    scene, *_ = align.build(case, case.observations[0])
    effects = [start(FAMILIES["tap_fading"], world.rng.normal(size=2 * 24), aux={"tap": k}) for k in range(4)]
    effects += [start(FAMILIES["iq_imbalance"], [0.1, 0.0]), start(FAMILIES["gain_step"], [0.1, 0.4])]
    fit = SimpleNamespace(model=SimpleNamespace(effects=effects))
    assert doubts(SimpleNamespace(fit=fit, scene=scene, is_cause=lambda effect: True, gain_of=lambda index: 500.0)) == []


@pytest.mark.parametrize("common", [0.0, 0.3, 0.6])
def test_two_paths_of_three_that_share_a_part_of_their_courses_do_not_fade(world, tmp_path, common):
    world.taps = [*world.taps, (21, 0.3)]
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean())))
    scene, *_ = align.build(case, case.observations[0])
    shared, *own = world.rng.normal(size=(3, 2 * 96))
    courses = [np.sqrt(common) * shared + np.sqrt(1 - common) * p for p in own]
    effects = [start(FAMILIES["tap_fading"], p, aux={"tap": k}) for k, p in enumerate(courses)]
    fit = SimpleNamespace(model=SimpleNamespace(effects=effects))
    finding = SimpleNamespace(fit=fit, scene=scene, is_cause=lambda effect: True, gain_of=lambda index: 500.0)
    assert bool(doubts(finding)) is (common == 0.6)


@pytest.mark.parametrize(
    ("apart_samples", "turns", "told"), [(0.01, 0.4, True), (0.4, 0.02, False), (0.4, 0.7, True), (2.0, 0.7, False)]
)
def test_two_echoes_of_one_place_are_two_by_their_delays_or_none(world, tmp_path, apart_samples, turns, told):
    """Of turns that are less than half a cycle apart no recording tells two echoes: it is one that comes, goes or fades."""
    family = FAMILIES["extra_path"]
    one, other = (start(family, [0.1, 0.0, 11.0 + k * apart_samples, k * turns], aux={"source": 0}) for k in range(2))
    assert family.unsteady(one, other) == family.unsteady(other, one) == told


@pytest.mark.parametrize(("pulses", "told"), [(2, True), (5, False)])
def test_interference_that_is_on_only_where_samples_are_lost_is_none(world, tmp_path, pulses, told):
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean())))
    scene, *_ = align.build(case, case.observations[0])
    lost = [FAMILIES["sample_loss"].happening(scene, start(FAMILIES["sample_loss"], [0.0, 4.0]), at) for at in (6000.0, 14_000.0)]
    period = 8000.0 if pulses == 2 else 4000.0
    gated = start(FAMILIES["pulsed_interference"], [3.0, period, 5990.0 % period, 100 / period])
    effects = [*lost, gated]
    fit = SimpleNamespace(model=SimpleNamespace(effects=effects))
    for nats in (500.0, 3.0):  # of what is as faint as chance nothing is said
        finding = SimpleNamespace(fit=fit, scene=scene, is_cause=lambda effect: True, gain_of=lambda index, nats=nats: nats)
        assert [rest.nats for rest in doubts(finding)] == ([500.0] if told and nats > 100 else [])


def test_a_gain_that_steps_while_interference_is_on_is_no_doubt(world, tmp_path):
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean())))
    scene, *_ = align.build(case, case.observations[0])
    step = start(FAMILIES["gain_step"], [0.1, 0.36])
    wide = start(FAMILIES["pulsed_interference"], [3.0, 10_000.0, 0.0, 0.45])
    fit = SimpleNamespace(model=SimpleNamespace(effects=[step, wide]))
    finding = SimpleNamespace(fit=fit, scene=scene, is_cause=lambda effect: True, gain_of=lambda index: 500.0)
    assert doubts(finding) == []


@pytest.mark.parametrize("alike", [True, False])
def test_slow_fading_with_a_faint_fast_part_is_alike_by_chance(world, tmp_path, alike):
    """Of 64 numbers two or three say anything of a course: of two such courses one in eight is half the other."""
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean())))
    scene, *_ = align.build(case, case.observations[0])
    law = np.exp(-np.arange(64) / 1.5) + 1e-3 if not alike else np.ones(64)
    told = 0
    for _ in range(60):
        own, other = (np.sqrt(law)[:, None] * world.rng.normal(size=(64, 2)) for _ in range(2))
        effects = [start(FAMILIES["tap_fading"], p.ravel(), aux={"tap": k}) for k, p in enumerate((own, own if alike else other))]
        fit = SimpleNamespace(model=SimpleNamespace(effects=effects))
        told += bool(doubts(SimpleNamespace(fit=fit, scene=scene, is_cause=lambda effect: True, gain_of=lambda index: 500.0)))
    assert told == (60 if alike else 0)
