# SPDX-License-Identifier: GPL-3.0-or-later
"""Scattered fields of links of which the twin predicts nothing, whose phases and delays are unknown; which objects scatter."""

from dataclasses import replace

import numpy as np
import pytest
from gr_cast.diagnose.places import diffuse, rounds, run, settling
from gr_cast.diagnose.places.ears import ResponseEar, holding
from gr_cast.diagnose.places.fit import evaluated
from gr_cast.diagnose.places.likelihood import Fitted, Heard
from gr_cast.diagnose.places.view import View
from gr_cast.twin.places.families.base import Effect
from gr_cast.twin.places.predict import Predictor

from tests.diagnose.places.test_place_bodies import BY_NAME, KNOWN, heard, ours, theirs

LINK, FREQUENCY_HZ, TIME_S = ("n0", "n2"), np.linspace(-4e7, 4e7, 40), np.linspace(0.0, 4.0, 17)


def alone(rows: np.ndarray, level: float, **unknown):
    """One still link's rows (T, K), its noise of variance 1 and the power of its field `level` times the noise's."""
    told = Heard(
        links=(LINK,), y=rows[None], weight=np.ones((1, *rows.shape)), frequency_hz=FREQUENCY_HZ, **(KNOWN | unknown)
    )  # fmt: skip
    ear = ResponseEar(Predictor(*zip(LINK, strict=True), TIME_S, FREQUENCY_HZ), told)
    world = ours()
    world = world.with_surface(np.arange(len(world.mesh.names)), scattering=0.6)
    power, _ = diffuse.profiles(world, ear.predictor, 0, len(FREQUENCY_HZ), told.spacing_hz)
    factor = np.full(told.y.shape, np.sqrt(level / power.sum()), complex)
    fit = Fitted(model=np.zeros(told.y.shape, complex), residual=told.y, energy=0.0, factor=factor)
    return ear, fit, world, power[0]


def field(random, level: float) -> np.ndarray:
    """(K,) of the profile that the world scatters over that link."""
    profile = alone(np.zeros((len(TIME_S), len(FREQUENCY_HZ)), complex), 1.0)[3]
    cells = np.flatnonzero(profile)
    strength = np.sqrt(level * profile[cells] / profile.sum() / 2) * (random.normal(size=(2, len(cells))).T @ [1, 1j])
    return np.exp(-2j * np.pi * np.outer(np.arange(len(FREQUENCY_HZ)), cells) / len(profile)) @ strength


def noise(random) -> np.ndarray:
    return random.normal(size=(len(TIME_S), len(FREQUENCY_HZ), 2)) @ [1, 1j] / np.sqrt(2)


@pytest.mark.parametrize("level", [1.0, 10.0, 100.0])
def test_a_field_is_as_likely_in_unknown_phases_and_delays_but_for_what_these_cost(level):
    random = np.random.default_rng(4)
    rows = np.broadcast_to(field(random, level), (len(TIME_S), len(FREQUENCY_HZ)))
    late = np.exp(-2j * np.pi * 57 / (8 * len(FREQUENCY_HZ)) * np.arange(len(FREQUENCY_HZ)))  # by whole eighths of a bin
    turned = np.exp(2j * np.pi * random.uniform(size=(len(TIME_S), 1))) * rows * late
    more = noise(random)
    nats, saved, _ = diffuse.gain(*alone(rows + more, level)[:3])
    same, saved_too, _ = diffuse.gain(*alone(turned + more, level, phase="snapshot", delay="link")[:3])
    lost, *_ = diffuse.gain(*alone(turned + more, level, phase="snapshot")[:3])
    cross = (np.abs(rows) ** 2).sum(axis=1)
    assert saved_too == pytest.approx(saved, rel=0.1, abs=30)
    assert same == pytest.approx(nats - 0.5 * np.log(4 * np.pi * cross).sum(), rel=0.02, abs=40)
    assert level < 10 or lost < same - 50  # at another delay


@pytest.mark.parametrize("level", [1.0, 10.0])
def test_what_a_field_explains_is_not_left_on_its_links(level):
    random = np.random.default_rng(4)
    rows = np.broadcast_to(field(random, level), (len(TIME_S), len(FREQUENCY_HZ))) + noise(random)
    ear, fit, world, _ = alone(rows, level)
    left, count = diffuse.left(ear, fit, world), rows.size
    assert ear.left(fit)[0] > (1 + level / 2) * count
    assert left == pytest.approx(ear.left(fit) - diffuse.gain(ear, fit, world)[1], abs=1.0)
    assert left[0] == pytest.approx(count, abs=4 * np.sqrt(count))
    assert diffuse.left(ear, fit, ours()) == pytest.approx(ear.left(fit))


@pytest.mark.parametrize("level", [0.1, 1.0, 10.0])
def test_noise_gains_nothing_from_phases_that_are_unknown(level):
    random = np.random.default_rng(6)
    gained = [diffuse.gain(*alone(noise(random), level, phase="snapshot", delay="link")[:3])[0] for _ in range(20)]
    assert max(gained) < 4.0


def test_links_to_which_hardly_anything_is_scattered_pay_for_no_phases():
    random = np.random.default_rng(7)
    gained = [diffuse.gain(*alone(noise(random), 1e-9, phase="snapshot", delay="link")[:3])[0] for _ in range(5)]
    assert gained == pytest.approx([0.0] * 5, abs=0.1)


def test_one_snapshot_of_a_field_costs_no_phase():
    random = np.random.default_rng(4)
    rows = field(random, 10.0)[None] + noise(random)[:1]
    nats = [diffuse.gain(*alone(rows, 10.0, phase=phase)[:3])[0] for phase in ("none", "snapshot")]
    assert nats[1] == pytest.approx(nats[0], rel=1e-9)


def test_objects_that_no_path_meets_may_scatter():
    ears = heard(theirs(max_depth=0), 30.0)
    view = View(ears, evaluated(ears, replace(ours(), max_depth=0), ()), KNOWN)
    assert view.seen_objects == []
    assert sorted(view.scatterers) == ["ground", "wall"]


def scattered(share: float, **how):
    """The yard where everything scatters so much, and what is heard of it."""
    random, ears = np.random.default_rng(6), heard(theirs(), 30.0, **how)
    rough = ours().with_surface(np.arange(len(ours().mesh.names)), scattering=share)
    clean = evaluated(ears, rough, ())
    y = clean.fits[0].model.copy()
    y += (random.normal(size=(*y.shape, 2)) @ [1, 1j]) / np.sqrt(2 * ears[0].heard.weight)
    for index, _, fields, is_still in diffuse._fields(ears[0], clean.fits[0], rough):
        for which, strength, modes in fields:
            many = y.shape[1] if is_still else 1  # instants that hear the same
            drawn = random.normal(size=(1 if is_still else len(which), len(strength), 2)) @ [1, 1j]
            y[index, slice(None) if is_still else which] += (drawn * np.sqrt(strength / 2 / many)) @ modes.T
    return rough, [replace(ears[0], heard=replace(ears[0].heard, y=y))]


@pytest.mark.parametrize("share", [0.2, 0.45])
def test_of_a_share_that_is_scattered_the_likeliest_is_chosen_whatever_it_was_taken_for_first(share):
    rough, ears = scattered(share)
    field = Effect(family=BY_NAME["missing_scattering"], owner="place", values=np.zeros(0), choice=0.75)
    found = settling.with_best_choice(ears, evaluated(ears, ours(), [field]), 0).effects[0]
    assert found.choice == pytest.approx(share, abs=0.1)
    candidate = Effect(family=BY_NAME["material"], owner="wall", values=np.array([1.0, -3.0]))
    held = holding(ears, rough)
    own, others = (evaluated(some, rough, [candidate]).energy for some in (ears, held))
    assert evaluated(held, rough, []).energy == pytest.approx(evaluated(ears, rough, []).energy)
    assert own != pytest.approx(others, abs=1.0)  # what the wall scatters is another then, and is not held to be
    here = evaluated(ears, ours(), [replace(field, choice=found.choice)])
    for name, is_held in (("material", True), ("missing_scattering", False)):
        known = here if is_held else evaluated(ears, ours(), [])
        view = View(ears, known, KNOWN)
        (one, *_) = rounds.screened(view, ears, known, BY_NAME[name], "wall")
        as_held, as_own = (evaluated(some, ours(), one.effects).energy for some in (holding(ears, known.world), ears))
        assert one.energy == pytest.approx(as_held if is_held else as_own, rel=1e-9)
        assert is_held == (abs(as_held - as_own) > 1e-3)


@pytest.mark.parametrize("phase", ["none", "snapshot"])
def test_gains_that_wander_are_no_random_field(phase):
    """As likely as Gaussian factors of their spread are, whose −ln p is known; and likelier than what anything scatters."""
    random, (ear,) = np.random.default_rng(4), heard(theirs(), 30.0, phase=phase)
    clean, spread = ear.predicted(ours()), 0.1
    size = clean.shape[:2]
    drawn = random.normal(size=size) if phase == "snapshot" else random.normal(size=(*size, 2)) @ [1, 1j] / np.sqrt(2)
    noise = (random.normal(size=(*clean.shape, 2)) @ [1, 1j]) / np.sqrt(2 * ear.heard.weight)
    told = replace(ear, heard=replace(ear.heard, y=clean * (1 + spread * drawn)[..., None] + noise))
    base = evaluated([told], ours(), [])
    loud = (np.abs(clean) ** 2 * ear.heard.weight).sum(axis=2)
    over = spread**2 * loud
    assert diffuse.wander_nats(told, base.fits[0]) == pytest.approx((over - np.log1p(over)).sum(), rel=0.3)
    field = Effect(family=BY_NAME["missing_scattering"], owner="place", values=np.zeros(0), choice=0.3)
    wide, narrow = (scattered(0.3, phase=phase, band_hz=band_hz)[1][0] for band_hz in (8e7, 4e6))
    for one, wanders in ((told, True), (ear, False), (wide, False), (narrow, False)):
        model = settling.with_best_choice([one], evaluated([one], ours(), [field]), 0)
        assert run._wanders([one], model) == wanders
    assert not run._wanders([told], base)
