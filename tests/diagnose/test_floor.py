# SPDX-License-Identifier: GPL-3.0-or-later
"""A floor is one level of noise: the same in every time, band and level of what is received."""

import numpy as np
import pytest
from conftest_world import RATE_HZ, World, noise
from gr_cast.diagnose import align, diagnose, flatness, heldout, read_case
from gr_cast.diagnose import noise as laws
from gr_cast.diagnose.search import refit
from gr_cast.twin.effects import FAMILIES, Role
from gr_cast.twin.effects.base import start
from scipy import stats


@pytest.mark.parametrize("size", [3, 20, 400])
def test_cells_of_one_level_are_even_as_often_as_chance_says(size):
    rng = np.random.default_rng(size)
    p = [flatness.uneven("", rng.gamma(size, size=300), np.full(300, float(size))).p_value for _ in range(400)]
    assert stats.kstest(p, "uniform").pvalue > 0.01


def test_many_cells_that_are_each_a_little_louder_are_uneven_together():
    rng = np.random.default_rng(3)
    louder = np.where(np.arange(1536) % 4 == 0, 1.3, 1.0)
    energy, count = louder * rng.gamma(20, size=1536), np.full(1536, 20.0)
    assert stats.gamma.sf(energy, count).min() * 1536 > 1e-4  # no cell alone
    assert flatness.uneven("", energy, count).p_value < 1e-5


def test_a_colour_that_stays_is_not_what_cells_hold_together_and_one_that_moves_is():
    rng, count = np.random.default_rng(4), np.full((48, 32), 20.0)
    colour = 1 + 0.5 * np.cos(2 * np.pi * np.arange(32) / 32)
    still = colour * rng.gamma(20, size=(48, 32))
    moving = np.array([np.roll(row, 4 * k) for k, row in enumerate(still)])
    assert flatness.together(still, count).p_value > 1e-3
    assert flatness.together(moving, count).p_value < 1e-9


def _document(world, folder, y, **how):
    return diagnose(read_case(world.write(folder, y, **how)), budget_s=3000).document


def test_noise_that_hops_through_the_band_is_no_floor(world, tmp_path):
    rng, n = world.rng, len(world.n)
    hops = 0.5 * (rng.random(n // 200) - 0.5).repeat(200)  # of the sample rate
    band = np.convolve(noise(rng, n + 30), np.hanning(31) / np.sqrt(np.sum(np.hanning(31) ** 2)), "valid")
    y = world.noisy(world.clean()) + 0.35 * world.noise_rms * band * np.exp(2j * np.pi * np.cumsum(hops))
    document = _document(world, tmp_path / "case", y)
    assert document["verdict"] == "unexplained"
    assert "noise_floor" not in [e["family"] for e in document["effects"]]


def test_noise_of_one_level_is_a_floor(world, tmp_path):
    world.taps = [(0, 1.0), (9, 0.8 * np.exp(0.7j))]  # a signal whose power changes
    y = world.noisy(world.clean()) + noise(world.rng, len(world.n), 0.35 * world.noise_rms)
    document = _document(world, tmp_path / "case", y)
    assert document["verdict"] == "identified"
    assert [e["family"] for e in document["effects"]] == ["noise_floor"]


def test_the_change_of_a_floor_is_that_of_all_noise_by_sample_the_rounding_of_the_file_in_it(world, tmp_path):
    rounding, own, step = (1 / 128) ** 2 / 6, world.noise_rms**2, 1 / 128
    y = world.noisy(world.clean()) + noise(world.rng, len(world.n), world.noise_rms * 0.7**0.5)
    assert abs(np.mean(np.abs(step * (np.round(y.real / step) + 1j * np.round(y.imag / step)) - y) ** 2) / rounding - 1) < 0.05
    world.noise_rms = (own + rounding) ** 0.5  # as a recording of the receiver alone has it
    (effect,) = _document(world, tmp_path / "case", y, datatype="ci8")["effects"]
    change = effect["parameters"]["change_db"]
    assert effect["family"] == "noise_floor"
    assert abs(change["value"] - 10 * np.log10((1.7 * own + rounding) / (own + rounding))) < 2.5 * change["std"] < 0.2


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_that_follows_the_signal_is_told_with_what_the_fits_own_errors_add_to_its_floor(tmp_path, seed):
    """A hundred times the floor, of a signal that vanishes in one of 32 chips, beside 30 echoes that are not there."""
    world = World(seed)
    world.taps = [(4 * k * k, 0.5**k) for k in range(5)] + [(100, 0.5**5), (144, 0.5**5)]
    clean = world.clean()
    power = np.mean(np.abs(clean) ** 2)
    follows, floor = np.abs(clean) ** 2 / power, 0.3 * power
    y = clean + noise(world.rng, len(clean)) * np.sqrt(floor * (1 + 100 * follows))
    case = read_case(world.write(tmp_path / "case", y))
    _, data, model = align.build(case, case.observations[0])
    for delay in range(150, 180):
        model = model.adding(start(FAMILIES["extra_path"], [0, 0, delay, 0], free=[1, 1, 0, 0], aux={"source": 0}))
    plain = refit(data, model.adding(start(FAMILIES["signal_dependent_noise"], [0.0], free=[False])))
    told = laws.with_blur(plain)
    before, after = (f.model.effects[f.model.index_of(Role.FOLLOWING)] for f in (plain, told))
    assert before.p[0] < np.log(100) - 5 * before.aux["_std"][0]
    assert abs(after.p[0] - np.log(100)) < 2 * after.aux["_std"][0] < 1.5
    assert abs(np.log(told.sigma2 / floor)) < 2 * after.aux["_std"][0]


def test_the_steps_of_a_file_stay_as_they_are_where_the_gain_falls(world, tmp_path):
    """A twin that knows of 12 dB less for the last 1500 samples: behind it the steps of 8 bits are louder than the noise."""
    at, twin = 18_500, world.twin()
    told = {"time_s": {"value": at / RATE_HZ, "std": 0.0}, "step_db": {"value": -12.0, "std": 0.0}}
    twin["effects"] = [{"family": "gain_step", "owner": {"level": "rx", "name": "rx1"}, "parameters": told}]
    world.twin = lambda: twin
    y = world.noisy(world.clean()) * np.where(world.n < at, 1.0, 10 ** (-12 / 20))
    case = read_case(world.write(tmp_path / "case", y, datatype="ci8"))
    _, data, model = align.build(case, case.observations[0])
    assert max(nats for nats, _ in laws.starts(refit(data, model))) < 0


@pytest.mark.parametrize("change_db", [0.1, 0.3, 1.0])
def test_unseen_samples_of_a_floor_contradict_it_as_seldom_as_chance_says(change_db):
    """What they gain by the floor that they have falls short of what is spared in less than one of a hundred draws."""
    rng, floor = np.random.default_rng(3), FAMILIES["noise_floor"]
    effect, ratio, short = start(floor, [change_db]), 10 ** (change_db / 10), 0
    for _ in range(300):
        energy = ratio * rng.exponential(size=3000)
        short += heldout.of_variance(energy, np.full(3000, ratio)) < -floor.spared_nats(effect, 3000.0)
    assert short < 3
