# SPDX-License-Identifier: GPL-3.0-or-later
"""Laws of the parts of a place's diagnosis, against sums written out."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from gr_cast.diagnose.places import diffuse, fit, likelihood, policy, scan, search
from gr_cast.diagnose.places.fit import evaluated, fitted, with_effect
from gr_cast.diagnose.places.view import View
from gr_cast.twin.places.families.base import Effect
from gr_cast.twin.places.families.nodes import NodePosition, TrackTiming
from gr_cast.twin.places.families.objects import ExtraObject, Material, Roughness
from scipy.optimize import minimize_scalar

from tests.diagnose.places import test_place_search
from tests.diagnose.places.test_place_search import UNKNOWN, heard, ours, theirs


@pytest.mark.parametrize("scale", [1.0, None, "grows"])
def test_energies_along_a_grid_are_those_of_the_paths_summed_one_by_one(scale):
    rng = np.random.default_rng(1)
    normal = lambda *shape: rng.normal(size=shape) + 1j * rng.normal(size=shape)  # noqa: E731
    rows = [
        scan.Row(
            base=normal(9, 5),
            rates=rng.normal(size=(1, 9, 5)) * 300,
            rest=normal(5),
            y=normal(5),
            weight=rng.uniform(1, 4, 5),
            is_free=is_free,
        )  # fmt: skip
        for is_free in (True, False)
    ]
    grid = np.arange(-1, 1, 0.0013)
    scale = np.linspace(0.5, 2, len(grid)) if scale == "grows" else scale
    wanted = np.zeros((2, len(grid)))
    for row in rows:
        model = (np.exp(-1j * grid[:, None, None] * row.rates[0]) * row.base).sum(axis=1) + row.rest
        cross, power = (row.y.conj() * model * row.weight).sum(axis=1), (np.abs(model) ** 2 * row.weight).sum(axis=1)
        along = np.abs(cross) if row.is_free else cross.real
        left = -(np.maximum(along, 0) ** 2) / power if scale is None else scale**2 * power - 2 * scale * along
        left += (np.abs(row.y) ** 2 * row.weight).sum()
        noisier = np.maximum(left / len(row.y), 1)  # by whatever suits the row
        wanted += left / noisier + len(row.y) * np.log(noisier), left
    assert scan.energy_along(rows, grid, scale) == pytest.approx(wanted, abs=1e-5 * np.abs(wanted).max())


@pytest.mark.parametrize("energy", [0.0, 3.0, 11.9, 12.1, 40.0, 1e7])
def test_a_response_may_have_as_much_more_noise_as_suits_it(energy):
    count = 12
    best = minimize_scalar(
        lambda log: energy / np.exp(log) + count * log, bounds=(0, 30), method="bounded", options={"xatol": 1e-9}
    )
    assert likelihood.tempered(np.array(energy), np.array(count)) == pytest.approx(best.fun, abs=1e-4)


@pytest.mark.parametrize("level", [0.05, 1.0, 30.0])
@pytest.mark.parametrize("phase", ["snapshot", "link"])
def test_energy_is_of_the_mean_likelihood_over_unknown_phases(phase, level):
    rng = np.random.default_rng(3)
    normal = lambda *shape: rng.normal(size=shape) + 1j * rng.normal(size=shape)  # noqa: E731
    h = level * normal(2, 3, 8) / 8
    y = h * np.exp(1j) + normal(2, 3, 8)
    told = likelihood.Heard(
        links=(("a", "b"), ("a", "c")), y=y, weight=np.full(y.shape, 0.5), frequency_hz=np.arange(8.0),
        phase=phase, delay="none", gain="none",
    )  # fmt: skip
    turns = np.exp(1j * np.linspace(0, 2 * np.pi, 4096, endpoint=False))
    each = (0.5 * np.abs(y - turns[:, None, None, None] * h) ** 2).sum(axis=3 if phase == "snapshot" else (2, 3))
    wanted = -np.log(np.mean(np.exp(each.min(axis=0) - each), axis=0)) + each.min(axis=0)
    assert likelihood.profiled(told, h).energy == pytest.approx(wanted.sum(), rel=1e-4)


@pytest.mark.parametrize("faint", [1e-110, 1e-150, 1e-158, 1e-161, 0.0])
@pytest.mark.parametrize("phase", ["none", "snapshot", "link"])
def test_a_link_of_which_next_to_nothing_is_predicted_leaves_the_others_fits_as_they_are(phase, faint):
    rng = np.random.default_rng(3)
    normal = lambda *shape: rng.normal(size=shape) + 1j * rng.normal(size=shape)  # noqa: E731
    scale = np.array([1.0, 1.0, faint])[:, None, None]
    h, y = normal(3, 3, 8) * scale, normal(3, 3, 8) * np.array([1.0, 1.0, 1e-150])[:, None, None]

    def energy(many):
        told = likelihood.Heard(
            links=(("a", "b"), ("a", "c"), ("b", "c"))[:many], y=y[:many], weight=np.full(y[:many].shape, 0.5),
            frequency_hz=1e6 * np.arange(8.0), phase=phase, delay="node", gain="node",
        )  # fmt: skip
        return likelihood.profiled(told, h[:many]).energy

    with np.errstate(over="raise", invalid="raise"):
        assert energy(3) == pytest.approx(energy(2), rel=1e-6)


@pytest.mark.parametrize("cells", [[3], [3, 4, 9, 40], range(0, 400, 3)])
def test_modes_of_a_random_field_are_those_of_its_covariance(cells):
    count, cells = 32, np.array(cells)
    cells = cells[cells < count * diffuse._FINER]
    power = np.zeros(count * diffuse._FINER)
    power[cells] = np.random.default_rng(2).uniform(0.1, 1, len(cells))
    strength, modes = diffuse._modes(diffuse._rounded(power / power.max()), count)
    frequency = np.arange(count)
    wanted = sum(
        power[cell] * np.exp(-2j * np.pi * np.subtract.outer(frequency, frequency) * cell / power.size) for cell in cells
    )
    assert power.max() * (modes * strength) @ modes.conj().T == pytest.approx(wanted, abs=2e-3 * power.sum())
    assert modes.conj().T @ modes == pytest.approx(np.eye(len(strength)), abs=1e-4)


def test_who_is_late_on_a_straight_track_is_not_told_to_be_displaced_along_it():
    world = copy.deepcopy(theirs())
    world["nodes"]["walker"]["time_offset_s"] = 0.3
    found = search.run(heard(world, 30.0), ours(), UNKNOWN, 60.0)
    (effect,) = found.model.effects
    assert effect.key == ("track_timing", "walker")
    assert effect.values[0] == pytest.approx(0.3, abs=1e-3)
    track = np.array(world["nodes"]["walker"]["waypoints_m"], float)
    ahead = (track[1] - track[0]) / np.linalg.norm(track[1] - track[0])
    along, aside = (
        Effect(family=NodePosition(), owner="walker", values=0.2 * way) for way in (ahead, np.array([-ahead[1], ahead[0], 0]))
    )
    assert TrackTiming().covers(ours(), effect, along)
    assert not TrackTiming().covers(ours(), effect, aside)


def test_an_object_that_is_gone_covers_one_that_is_as_rough_but_no_other():
    gone = Effect(family=ExtraObject(), owner="board", values=np.zeros(0))
    rough = Effect(family=Roughness(), owner="board", values=np.zeros(1))
    assert gone.family.covers(ours(), gone, rough)
    assert gone.family.covers(ours(), gone, replace(rough, owner="metal"))
    assert not gone.family.covers(ours(), gone, replace(rough, owner="west"))
    assert not rough.family.covers(ours(), rough, gone)


def test_other_beginnings_of_a_slab_hold_whole_numbers_of_half_waves_more():
    world = ours()
    effect = Effect(family=Material(), owner="west", values=np.log([6.0, 0.01]))
    thickness_m = world.surface.thickness_m[world.mesh.index("west")]
    index = np.array([np.exp(one.values[0] / 2) for one in effect.family.restarts(world, effect)])
    more = (index - np.sqrt(6.0)) * thickness_m / (world.wavelength_m / 2)
    assert len(more) > 5
    assert more == pytest.approx(np.round(more), abs=1e-9)


@pytest.mark.parametrize("factor", [0.8874, 0.9291, 1.0708])
def test_whoever_goes_at_another_speed_is_found_between_the_speeds_that_are_tried(factor, monkeypatch):
    monkeypatch.setattr(test_place_search, "CARRIER_HZ", 28e9)  # a track of 200 wavelengths
    monkeypatch.setattr(test_place_search, "TIME_S", np.linspace(0.0, 1.7, 9))
    world = copy.deepcopy(theirs())
    world["nodes"]["walker"]["speed_m_per_s"] *= factor
    ears = heard(world, 30.0)
    model = evaluated(ears, ours(), ())
    starts = TrackTiming().starts(View(ears, model, UNKNOWN), "walker")
    best = min((fitted(ears, with_effect(ears, model, one)) for one in starts), key=lambda one: one.energy)
    assert best.effects[0].values == pytest.approx([0.0, factor], abs=1e-3)


def test_what_nuisances_span_is_taken_away_once_however_often_they_say_it():
    random = np.random.default_rng(3)
    others, rows = random.normal(size=(5, 40)), random.normal(size=(3, 40))
    others = np.vstack([others, others[0] - others[1], 1e-6 * others[2], np.zeros(40)])
    wanted = rows - rows @ np.linalg.pinv(others, rcond=1e-9) @ others
    assert fit._apart(others, rows) == pytest.approx(wanted, abs=1e-7)


@pytest.mark.parametrize("links", [1, 8])
def test_what_fills_few_of_a_fields_modes_is_no_field(links, monkeypatch):
    """Powers of a random field's modes over what they should be are exponential; a strong echo of one link of many is not."""
    random, noise = np.random.default_rng(3), 0.1
    strength = np.geomspace(50.0, 1e-3, 12)
    drawn = [random.exponential(size=(4, 12)) * (noise + strength) for _ in range(links)]
    loud = [power * (8.0 if index == 0 else 0.05) for index, power in enumerate(drawn)]
    for powers, is_field in ((drawn, True), (loud, links == 1)):  # one link alone is as loud as it is
        monkeypatch.setattr(diffuse, "_along_modes", lambda *_, powers=powers: ((0, noise, one, strength) for one in powers))
        assert (diffuse.unevenness([None], [None], None) < policy.UNEVEN_DEVIATIONS) == is_field
