# SPDX-License-Identifier: GPL-3.0-or-later
"""Received power alone: laws of fading and of a meter's scale, against SciPy's distributions and numerical derivatives."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast.diagnose.places.ears import bursts
from gr_cast.diagnose.places.fit import evaluated, fitted
from gr_cast.diagnose.places.power import Expected, PowerEar
from gr_cast.diagnose.places.search import run
from gr_cast.diagnose.places.view import View
from gr_cast.scenario.create.fields import surface_of
from gr_cast.scenario.create.geometry import Solid
from gr_cast.scenario.create.media import Medium
from gr_cast.scenario.create.nodes import Node
from gr_cast.twin.places.carrying import Body, headings, loss_db
from gr_cast.twin.places.families.base import Effect
from gr_cast.twin.places.families.mechanisms import Ground
from gr_cast.twin.places.families.power import SmallScale, scales
from gr_cast.twin.places.meters import Fading, Meter
from gr_cast.twin.places.predict import Predictor
from gr_cast.twin.places.world import Mesh, Radio, World
from scipy.stats import multivariate_normal, norm

CARRIER_HZ = 2e9
LINKS, T, STD_DB = [("a", "b"), ("c", "b")], 24, 0.7


def _ear(power_db, gain="none", limits_db=None):
    weight = np.where(np.isfinite(power_db), 0.5 / STD_DB**2, 0.0)[:, :, None]
    return PowerEar(SimpleNamespace(links=LINKS), np.nan_to_num(power_db)[:, :, None], weight, limits_db, gain)


def _expected(mean_db, fading=None, meter=None, bias_db=0.0):
    at_m = np.linspace(0, 2, T)[:, None] * np.ones(6)
    return Expected(mean_db=mean_db + bias_db, meters=(meter, meter), fading=((fading, at_m) if fading else None, None))


def _readings(seed=1):
    random = np.random.default_rng(seed)
    mean_db = -70 + 6 * np.sin(np.linspace(0, 7, T)) + np.array([[0.0], [3.0]])
    return mean_db, mean_db + random.normal(0, STD_DB, (2, T)) + np.array([[1.5], [0]]) * random.normal(size=(2, T))


@pytest.mark.parametrize("k_db", [-20.0, -3.0, 4.0, 12.0])
def test_fading_has_the_moments_of_rician_power(k_db):
    random, k = np.random.default_rng(3), 10 ** (k_db / 10)
    ray = random.normal(size=(400_000, 2)) @ [1, 1j] / np.sqrt(2)
    power_db = 20 * np.log10(np.abs(np.sqrt(k) + ray) / np.sqrt(k + 1))
    mean_db, variance = Fading(k_factor_db=k_db, coherence_m=1.0).moments_db()
    assert mean_db == pytest.approx(power_db.mean(), abs=0.05)
    assert variance == pytest.approx(power_db.var(), rel=0.02)


def test_energy_of_fading_is_the_likelihood_of_a_correlated_normal():
    fading = Fading(k_factor_db=3.0, coherence_m=0.3)
    mean_db, power_db = _readings()
    power_db[0, 5] = np.nan
    fit = _ear(power_db).profiled(_expected(mean_db, fading))
    plain = _ear(power_db).profiled(_expected(mean_db))
    known = np.isfinite(power_db[0])
    at_m = np.linspace(0, 2, T)[known] * np.sqrt(6)
    covariance = fading.covariance_db2(np.abs(at_m[:, None] - at_m)) + STD_DB**2 * np.eye(T - 1)
    told = multivariate_normal(mean_db[0, known], covariance).logpdf(power_db[0, known])
    told -= norm(mean_db[0, known], STD_DB).logpdf(power_db[0, known]).sum()
    assert plain.energy - fit.energy == pytest.approx(told, rel=1e-9)


@pytest.mark.parametrize("gain", ["none", "common"])
def test_a_fit_turns_where_the_energy_falls(gain):
    def expected(values):
        fading = Fading(k_factor_db=values[0], coherence_m=np.exp(values[1]))
        return _expected(mean_db + values[2] * tilt, fading, bias_db=np.array([[fading.moments_db()[0]], [0.0]]))

    mean_db, power_db = _readings()
    tilt, at, step = np.linspace(0, 1, T) * np.array([[1.0], [-2.0]]), np.array([2.0, -1.0, 0.3]), 1e-5
    ear = _ear(power_db, gain)
    fit = ear.profiled(expected(at))
    rows = ear.rows(fit)
    for number in range(3):
        more, less = (at + sign * step * np.eye(3)[number] for sign in (1, -1))
        slope = (ear.profiled(expected(more)).energy - ear.profiled(expected(less)).energy) / (2 * step)
        column = ear.columns(fit, expected(at), expected(more), step)
        assert -2 * column @ rows == pytest.approx(slope, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("meter", [Meter(top_db=-69.0), Meter(floor_db=-72.0), Meter(step_db=4.0), Meter(noise_db=-70.0)])
def test_a_scale_that_ends_is_censored_and_hides_no_gain(meter):
    mean_db, power_db = _readings()
    read = 10 * np.log10(10 ** ((power_db + 2.0) / 10) + 10 ** (meter.noise_db / 10))
    read = np.clip(read, meter.floor_db, meter.top_db)
    read = np.round(read / meter.step_db) * meter.step_db if meter.step_db else read
    ear = _ear(read, "common")
    with_meter, without = ear.profiled(_expected(mean_db, meter=meter)), ear.profiled(_expected(mean_db))
    assert without.energy > with_meter.energy + 10
    step = 1e-5
    wide = _ear(read)
    for shift in (1.5, 2.5):
        fits = [wide.profiled(_expected(mean_db + shift + d, meter=meter)) for d in (0.0, step, -step)]
        slope = (fits[1].energy - fits[2].energy) / (2 * step)
        here, moved = (_expected(mean_db + shift + d, meter=meter) for d in (0.0, 1e-4))
        column = wide.columns(fits[0], here, moved, 1e-4)
        assert -2 * column @ wide.rows(fits[0]) == pytest.approx(slope, rel=1e-3, abs=1e-3)


def test_limits_of_the_file_are_no_finding_and_those_of_the_readings_are():
    random = np.random.default_rng(2)
    power_db = random.normal(-70, 6, 80)
    unlimited = (-np.inf, np.inf)
    assert scales(power_db, 0.5, unlimited) == []
    assert scales(np.minimum(power_db, -68.3), 0.5, unlimited) == [("top_db", pytest.approx(-68.3))]
    assert scales(np.maximum(power_db, -72.1), 0.5, unlimited) == [("floor_db", pytest.approx(-72.1))]
    assert scales(np.minimum(power_db, -68.3), 0.5, (-100, -68.3)) == []
    assert scales(np.round(power_db / 3.7) * 3.7, 0.5, unlimited) == [("step_db", pytest.approx(3.7))]
    assert scales(np.round(power_db, 1), 0.5, unlimited) == []


def _yard(**changes):
    """Two isotropic nodes over one far sheet that sees neither."""
    solid = Solid(name="far", vertices_m=np.array([[0, 0, -900.0], [1, 0, -900], [1, 1, -900]]), faces=[[0, 1, 2]])
    media, nodes = {"far": Medium(material="concrete")}, {"a": [0.0, 0, 5], "b": [30.0, 0, 5]}
    mesh = Mesh.of((solid,), np.array(list(nodes.values())))
    radios = {name: Radio(node=Node(name=name, waypoints_m=np.array([at]))) for name, at in nodes.items()}
    surface = surface_of([media[name] for name in mesh.names], CARRIER_HZ)
    return World(mesh=mesh, media=media, surface=surface, radios=radios, carrier_hz=CARRIER_HZ, max_depth=0, **changes)


def _power_db(world, tracked=None):
    predictor = Predictor(["a"], ["b"], np.array([0.0, 1.0]), np.zeros(1), tracked)
    return 20 * np.log10(np.abs(predictor.response(world)[0, :, 0]))


def _friis_db(length_m):
    return 20 * np.log10(299792458.0 / CARRIER_HZ / (4 * np.pi * np.asarray(length_m)))


def test_a_tracked_node_is_where_it_was_tracked():
    at_m = np.array([[40.0, 0, 5], [0, 80.0, 5]])
    assert _power_db(_yard()) == pytest.approx(_friis_db([30.0, 30.0]), abs=1e-6)
    assert _power_db(_yard(), {"b": at_m}) == pytest.approx(_friis_db([40.0, 80.0]), abs=1e-6)


def test_attenuation_takes_its_decibels_of_every_metre():
    assert _power_db(_yard(loss_db_per_m=0.2)) == pytest.approx(_friis_db([30.0, 30.0]) - 6.0, abs=1e-6)


def test_a_law_of_distance_is_of_the_ends_or_of_each_path():
    """Over a mirror: of the ends it weakens all alike, whatever reflects; along paths the longer one more."""
    sheet = Solid(
        name="mirror", vertices_m=[[-90, -90, 0], [90, -90, 0], [90, 90, 0], [-90, 90, 0]], faces=[[0, 1, 2], [0, 2, 3]]
    )
    medium, plain = Medium(material="metal"), _yard()
    mesh = Mesh.of((sheet,), np.array([[0.0, 0, 5]]))
    plain = replace(
        plain, mesh=mesh, media={"mirror": medium}, surface=surface_of([medium], CARRIER_HZ), max_depth=1
    )  # fmt: skip
    at_m = np.array([[20.0, 0, 5], [40.0, 0, 5]])
    ratio_db = _power_db(replace(plain, exponent=3.0), {"b": at_m}) - _power_db(plain, {"b": at_m})
    assert ratio_db == pytest.approx(-10 * np.log10([20.0, 40.0]), abs=1e-9)
    along = replace(plain, exponent=3.0, exponent_of="path")
    predictor = Predictor(["a"], ["b"], np.zeros(2), np.zeros(1), {"b": at_m})
    gains = [predictor.path_table(one, 0).gain for one in (along, plain)]
    lengths_m = predictor.path_table(plain, 0).way.length_m
    assert len(lengths_m) == 4 and np.abs(gains[0] / gains[1]) ** 2 == pytest.approx(1 / lengths_m)


NOTHING_UNKNOWN = {"gain": "none", "delay": "none", "phase": "none"}


def _over_ground(x_m, z_m, height_m: float, permittivity: float, std_db: float, seed: int) -> PowerEar:
    """What is heard at (x, 0, z) of a node at 5 m by the two-ray law, with Fresnel's coefficient of a half-space: isotropic,
    vertical, so that the fields of both ends are along theta, which a level ground turns into transverse magnetic."""
    up_m = 5.0 + z_m - 2 * height_m
    straight_m, far_m = np.hypot(x_m, z_m - 5.0), np.hypot(x_m, up_m)
    eta, sine = permittivity - 1j * 0.01 * 17.975 / (CARRIER_HZ / 1e9), up_m / far_m
    root = np.sqrt(eta - (1 - sine**2))
    reflection = (eta * sine - root) / (eta * sine + root)
    k, count = 2 * np.pi * CARRIER_HZ / 299792458.0, len(x_m)
    field = np.exp(-1j * k * straight_m) / straight_m + reflection * np.exp(-1j * k * far_m) / far_m
    power_db = 20 * np.log10(np.abs(field) * 299792458.0 / CARRIER_HZ / (4 * np.pi))
    power_db = (power_db + np.random.default_rng(seed).normal(0, std_db, count))[None]
    predictor = Predictor(["a"], ["b"], np.arange(float(count)), np.zeros(1), {"b": np.stack([x_m, 0 * x_m, z_m], 1)})
    return PowerEar(predictor, power_db[:, :, None], np.full((1, count, 1), 0.5 / std_db**2), None, "none")


def test_ground_is_found_by_the_fringes_of_power_alone():
    x_m, height_m = np.linspace(8, 60, 60), 3.45
    ear = _over_ground(x_m, 5.0 + 0 * x_m, height_m, 9.0, 0.5, seed=1)
    found = run([ear], replace(_yard(), max_depth=1), NOTHING_UNKNOWN, 60.0)
    assert [effect.key for effect in found.model.effects] == [("ground", "place")]
    assert found.model.effects[0].values[0] == pytest.approx(height_m, abs=0.02)
    assert abs(found.deviations) < 4


def test_ground_is_found_where_echoes_of_another_permittivity_would_be_turned_round():
    """At a grazing angle of 16°, over the Brewster angle of 21 and under that of 8."""
    x_m, height_m = np.linspace(9, 42, 80), 3.45
    ear = _over_ground(x_m, np.tan(np.deg2rad(16.0)) * x_m - 5.0 + 2 * height_m, height_m, 21.0, 0.1, seed=5)
    world = replace(_yard(), max_depth=1)
    model = evaluated([ear], world, ())
    starts = Ground().starts(View([ear], model, NOTHING_UNKNOWN), "place")
    best = min(starts, key=lambda one: evaluated([ear], world, [one]).energy)
    assert best.values[0] == pytest.approx(height_m, abs=0.02)
    assert fitted([ear], evaluated([ear], world, [best])).deviations(80) < 4 < model.deviations(80)


def test_ground_far_under_steep_paths_is_found():
    """Its fringes turn within a centimetre of height."""
    x_m, height_m = np.linspace(6, 40, 80), -1.273
    ear = _over_ground(x_m, 5.0 + 0.04 * x_m, height_m, 6.0, 0.5, seed=5)
    found = run([ear], replace(_yard(), max_depth=1), NOTHING_UNKNOWN, 60.0)
    assert [effect.key for effect in found.model.effects] == [("ground", "place")]
    assert found.model.effects[0].values[0] == pytest.approx(height_m, abs=0.02)


def test_a_long_campaign_is_heard_in_bursts_from_end_to_end():
    assert (bursts(100, 400) == np.arange(100)).all()
    heard = bursts(50_000, 1500)
    assert len(heard) <= 1500 and heard[0] == 0 and heard[-1] == 49_999
    assert (np.diff(heard) == 1).mean() > 0.95


def _round(cause):
    """Three nodes and one that goes round among them; `cause` spoils the readings (3, 40)."""
    random, turn = np.random.default_rng(11), np.linspace(0, 2, 40)
    at_m = np.stack([12 * np.cos(turn), 9 * np.sin(turn), 5 + 0 * turn], 1)
    fixed = {"a": [0.0, 0, 5], "c": [25.0, 3, 6], "d": [-8.0, 20, 4]}
    radios = {name: Radio(node=Node(name=name, waypoints_m=np.array([at]))) for name, at in (fixed | {"b": at_m[0]}).items()}
    power_db = np.stack([_friis_db(np.linalg.norm(at_m - fixed[name], axis=1)) for name in fixed])
    power_db = cause(power_db + random.normal(0, 0.6, power_db.shape), random, at_m)
    predictor = Predictor(list(fixed), ["b"] * 3, np.arange(40.0), np.zeros(1), {"b": at_m})
    ear = PowerEar(predictor, power_db[:, :, None], np.full((3, 40, 1), 0.5 / 0.6**2), None, "common")
    found = run([ear], replace(_yard(), radios=radios), {"gain": "common", "delay": "none", "phase": "none"}, 60.0)
    assert abs(found.deviations) < 4
    return {effect.key: effect for effect in found.model.effects}


def _faded(power_db, random, at_m):
    gap_m = np.linalg.norm(at_m[:, None] - at_m, axis=2)
    ray = np.linalg.cholesky(np.exp(-((gap_m / 0.6) ** 2)) + 1e-9 * np.eye(40)) @ (random.normal(size=(40, 2)) @ [1, 1j])
    power_db[1] += 20 * np.log10(np.abs(np.sqrt(2) + ray / np.sqrt(2)) / np.sqrt(3))
    return power_db


def test_a_meter_that_hears_its_own_noise_is_found_and_named():
    found = _round(
        lambda power_db, random, at_m: 10 * np.log10(10 ** (power_db / 10) + 10**-6.2) + random.normal(0, 0.3, (3, 40))
    )
    assert list(found) == [("meter_limits", "b")]
    assert found["meter_limits", "b"].values == pytest.approx([-62.0], abs=0.5)


def test_a_fading_link_is_found_and_named():
    found = _round(_faded)
    assert list(found) == [("small_scale", "c>b")]
    assert found["small_scale", "c>b"].values[0] == pytest.approx(3.0, abs=4.0)


def test_fading_between_readings_far_apart_says_no_more_than_that_they_are():
    effect = Effect(family=SmallScale(), owner="a>b", values=np.array([3.0, np.log(0.005)]))
    told = SmallScale().told(SimpleNamespace(apart_m=lambda owner: 0.8), effect, np.zeros((2, 2)))["coherence_m"]
    assert 0.005 < told["value"] <= 0.4 and told["std"] >= 0.5 * told["value"]


def test_a_body_that_carries_a_node_and_takes_what_comes_from_behind_is_found_and_named():
    def shaded(power_db, random, at_m):
        turn = np.linspace(0, 2, 40)
        ahead = np.stack([-12 * np.sin(turn), 9 * np.cos(turn)], 1)
        ahead /= np.linalg.norm(ahead, axis=1)[:, None]
        for row, fixed_m in enumerate(([0.0, 0, 5], [25.0, 3, 6], [-8.0, 20, 4])):
            towards = fixed_m - at_m
            towards /= np.linalg.norm(towards, axis=1)[:, None]
            cosine = -(ahead * towards[:, :2]).sum(axis=1)  # 1: right behind
            power_db[row] -= 14.0 * np.exp(-(1 - cosine) / (1 - np.cos(0.9)))
        return power_db

    found = _round(shaded)
    assert list(found) == [("excess_loss", "b")]
    loss_db, azimuth_rad, width_rad = found["excess_loss", "b"].values
    assert loss_db == pytest.approx(14.0, abs=2.0) and abs(azimuth_rad) == pytest.approx(np.pi, abs=0.15)
    assert width_rad == pytest.approx(0.9, abs=0.15)


def test_what_carries_a_node_looks_where_it_went_last():
    at_m = np.array([[0.0, 0, 1], [0, 1, 1], [0, 2, 1], [0, 2, 1], [0, 2, 1], [-1, 2, 1], [-2, 2, 1]])
    heading = headings(at_m)
    assert heading[:4] == pytest.approx(np.tile([0.0, 1.0, 0.0], (4, 1))) and heading[6] == pytest.approx([-1.0, 0, 0])
    body = Body(loss_db=9.0, azimuth_rad=np.pi / 2, width_rad=1.0)
    left, right = loss_db(body, heading[[0, 6]], np.array([[-1.0, 0, 0], [0, -1, 0]])), [[1.0, 0, 0], [0, 1, 0]]
    assert left == pytest.approx([9.0, 9.0])
    assert loss_db(body, heading[[0, 6]], np.array(right)) == pytest.approx([9.0 * np.exp(-2 / (1 - np.cos(1.0)))] * 2)
    assert not headings(np.zeros((5, 3))).any()


def test_power_alone_tells_no_place_of_anything():
    _, view = _fixed_dipoles()
    shown = {family.name for family in view.families}
    assert shown == {
        "node_gain", "antenna_pattern", "antenna_orientation", "ground", "excess_loss", "small_scale", "meter_limits",
    }  # fmt: skip


def _fixed_dipoles():
    """A link that stands, 3 dB weaker than foretold, by a node whose dipole may also lean away from it."""
    predictor = Predictor(["a"], ["b"], np.arange(30.0), np.zeros(1))
    world = _yard()
    for name in ("a", "b"):
        world = world.with_radio(name, node=replace(world.radios[name].node, antenna="dipole"))
    foretold_db = 20 * np.log10(np.abs(predictor.response(world)[:, :, 0]))
    power_db = foretold_db - 3.0 + np.random.default_rng(4).normal(0, 0.5, (1, 30))
    ear = PowerEar(predictor, power_db[:, :, None], np.full((1, 30, 1), 2.0), None, "none")
    unknown = {"gain": "none", "delay": "none", "phase": "none"}
    return run([ear], world, unknown, 60.0), View([ear], evaluated([ear], world, ()), unknown)


def test_an_antenna_seen_from_one_side_alone_is_not_said_to_look_elsewhere():
    found, view = _fixed_dipoles()
    assert [effect.family.name for effect in found.model.effects] in (["excess_loss"], ["node_gain"])
    rivals = {rival.family.name for pairs in found.rivals.values() for rival, nats in pairs if nats < 6}
    assert rivals <= {"excess_loss", "node_gain"} and not view.looks_around("b")


def test_a_meter_that_saturates_is_found_and_named():
    found = _round(lambda power_db, random, at_m: np.minimum(power_db, np.quantile(power_db, 0.7)))
    assert list(found) == [("meter_limits", "b")]


def test_readings_with_the_errors_of_the_meter_accuse_nothing():
    assert _round(lambda power_db, random, at_m: power_db) == {}


def test_a_lossy_link_is_found_and_named():
    def lossy(power_db, random, at_m):
        return power_db - np.array([[0.0], [0.0], [4.0]])

    found = _round(lossy)
    assert [family for family, _ in found] in (["excess_loss"], ["node_gain"])  # one link per node: both say the same
    assert {owner for _, owner in found} <= {"d>b", "d"}
