# SPDX-License-Identifier: GPL-3.0-or-later
"""The effects of a SPEC: those of a diagnosis, checked, and played where a scenario can hold them."""

import numpy as np
import pytest
from gr_cast.core.documents import Reader
from gr_cast.core.errors import CastError
from gr_cast.core.units import SPEED_OF_LIGHT_M_PER_S
from gr_cast.scenario.create import effects, families, nodes
from gr_cast.scenario.create.geometry import Solid
from gr_cast.scenario.create.paths import LinkPaths, at

CARRIER_HZ = 2.4e9
NODES = ["a", "b", "c"]


def entry(family, level, name, **parameters):
    return {"family": family, "owner": {"level": level, "name": name}, "parameters": parameters}


def read(*entries):
    get = Reader("spec.yaml")
    found = families.read(get, list(entries), NODES)
    get.faults.raise_if_any()
    return found


def two_paths():
    delay_s = np.array([[10.0, 40.0]]) / SPEED_OF_LIGHT_M_PER_S
    return LinkPaths(
        time_s=np.zeros(1), delay_s=delay_s, rate_before=0 * delay_s, rate_after=0 * delay_s, gain=np.array([[1.0, 0.5j]])
    )


def response(link, frequency_hz):
    delay_s, gain = at(link, np.zeros(1), CARRIER_HZ)
    return (gain[0] * np.exp(-2j * np.pi * np.outer(frequency_hz, delay_s[0]))).sum(axis=1)


def test_entries_of_a_diagnosis_are_read_with_their_values_alone():
    told = entry("node_gain", "node", "a", error_db={"value": -3.0, "std": 0.1}) | {
        "confidence": 0.9,
        "sentence": "x",
        "where": {},
    }
    person = entry("moving_scatterer", "place", "place", position_m={"value": [1, 2, 0]}, velocity_m_per_s=[0.5, 0, 0])
    assert read(told, person) == (
        {"family": "node_gain", "owner": {"level": "node", "name": "a"}, "parameters": {"error_db": -3.0}},
        person | {"parameters": {"position_m": (1.0, 2.0, 0.0), "velocity_m_per_s": (0.5, 0.0, 0.0)}},
    )


@pytest.mark.parametrize(
    "wrong, says",
    [
        (entry("ghost", "place", "place"), "effects[0].family: got 'ghost', needs one of missing_object"),
        (entry("node_gain", "place", "place"), "effects[0].owner.level: got 'place', needs one of node, link"),
        (entry("node_gain", "node", "z"), "effects[0].owner.name: got 'z', needs one of a, b, c"),
        (entry("node_gain", "link", "a>z"), "effects[0].owner.name: got 'a>z', needs one of a>b, a>c"),
        (entry("node_gain", "node", "a", loss_db=1), "effects[0].parameters: unknown key 'loss_db', knows error_db"),
        (entry("node_delay", "node", "a", error_s=1), "effects[0].parameters.error_s: got 1, needs a finite number of s"),
        (entry("node_position", "node", "a", offset_m=[1, 2]), "effects[0].parameters.offset_m: got 2 numbers, needs 3"),
        (entry("antenna_pattern", "node", "a", pattern="horn"), "effects[0].parameters.pattern: got 'horn', needs one of iso"),
        ({"family": "carrier", "owner": {"level": "place", "name": "place"}}, "effects[0]: parameters is missing"),
    ],
)
def test_what_no_effect_says_is_refused_with_its_place(wrong, says):
    with pytest.raises(CastError) as error:
        read(wrong)
    assert len(error.value.faults) == 1 and says in error.value.faults[0]


def test_what_a_body_takes_of_some_directions_is_no_loss_of_all():
    found = read(entry("excess_loss", "node", "a", loss_db=9.0, azimuth_rad=3.1, width_rad=0.8))
    assert effects.step_of(found[0]) is None
    assert (effects.on_link(found, "a", "b", two_paths(), CARRIER_HZ).gain == two_paths().gain).all()


def test_gains_belong_to_all_links_of_their_node_and_losses_count_along_the_way():
    found = read(
        entry("node_gain", "node", "a", error_db=6.0), entry("excess_loss", "link", "a>b", loss_db=2.0),
        entry("excess_loss", "place", "place", db_per_m=0.1),
    )  # fmt: skip
    ab, bc = (np.abs(effects.on_link(found, *pair, two_paths(), CARRIER_HZ).gain[0]) for pair in ("ab", "bc"))
    np.testing.assert_allclose(20 * np.log10(ab / [1, 0.5]), [6 - 2 - 1, 6 - 2 - 4], atol=1e-9)
    np.testing.assert_allclose(20 * np.log10(bc / [1, 0.5]), [-1, -4], atol=1e-9)


def test_an_exponent_is_the_power_of_distance_that_power_falls_with():
    along, apart = (read(entry("excess_loss", "place", "place", exponent=3.5, distance=of)) for of in ("path", "link"))
    near, far = np.abs(effects.on_link(along, "a", "b", two_paths(), CARRIER_HZ).gain[0] / two_paths().gain[0])
    assert (near / far) ** 2 == pytest.approx(4**1.5)  # beside the square law of free space, from 10 m to 40 m
    both = np.abs(effects.on_link(apart, "a", "b", two_paths(), CARRIER_HZ).gain[0] / two_paths().gain[0])
    assert both**2 == pytest.approx([10**-1.5] * 2)  # the ends are 10 m apart


def test_a_delay_turns_the_response_across_the_band_and_not_the_carrier():
    late_s, frequency_hz = 7e-9, np.linspace(-1e8, 1e8, 21)
    found = read(entry("node_delay", "node", "b", error_s=late_s))
    turned = response(effects.on_link(found, "a", "b", two_paths(), CARRIER_HZ), frequency_hz)
    np.testing.assert_allclose(
        turned, response(two_paths(), frequency_hz) * np.exp(-2j * np.pi * frequency_hz * late_s), atol=1e-6
    )


def test_a_walker_with_another_timing_is_elsewhere_on_its_way():
    walker = nodes.Node(name="a", waypoints_m=[[0, 0, 1], [10, 0, 1]], speed_m_per_s=1.0)
    at_s = np.array([0.0, 2.0, 4.0, 20.0])
    ahead = effects.timed(walker, read(entry("track_timing", "node", "a", speed_factor=1.5, time_offset_s=1.0)))
    np.testing.assert_allclose(nodes.position_m(ahead, at_s)[:, 0], [1.5, 4.5, 7.5, 10])
    late = effects.timed(walker, read(entry("track_timing", "node", "a", time_offset_s=-3.0)))
    np.testing.assert_allclose(nodes.position_m(late, at_s)[:, 0], [0, 0, 1, 10])
    np.testing.assert_allclose(nodes.velocity_m_per_s(late, np.array([1.0, 3.5]), "right")[:, 0], [0, 1])
    assert 3.0 in nodes.sampling_times_s([late], 5.0, 0.7)  # where it sets off


def test_a_ground_lies_level_below_all_of_the_place():
    hut = Solid(name="hut", vertices_m=[[0, 0, 1], [4, 0, 1], [4, 4, 3]], faces=[[0, 1, 2]])
    _, ground = effects.with_ground(read(entry("ground", "place", "place", height_m=-0.5, permittivity=7.0)), [hut])
    assert (ground.vertices_m[:, 2] == -0.5).all() and np.ptp(ground.vertices_m[:, 0]) > 1000
    assert ground.medium.permittivity(CARRIER_HZ) == 7.0


def test_what_is_played_and_what_is_left_out_is_said():
    found = read(
        entry("carrier", "place", "place", carrier_hz=1.0e9), entry("moving_scatterer", "place", "place"),
        entry("node_gain", "node", "a", error_db=1.0), entry("small_scale", "link", "a>b", k_factor_db=3.0),
    )  # fmt: skip
    assert effects.summary(found) == {
        "effects played": "carrier (place), node_gain (a)", "effects left out": "moving_scatterer (place), small_scale (a>b)"
    }  # fmt: skip
