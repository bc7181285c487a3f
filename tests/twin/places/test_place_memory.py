# SPDX-License-Identifier: GPL-3.0-or-later
"""What a predictor remembers is what it would compute anew, whatever it was asked before."""

from collections import OrderedDict
from dataclasses import replace

import numpy as np
import pytest
from gr_cast.diagnose.places import diffuse
from gr_cast.scenario.create.fields import surface_of
from gr_cast.scenario.create.geometry import Solid
from gr_cast.scenario.create.media import Medium
from gr_cast.scenario.create.nodes import Node
from gr_cast.twin.places.predict import Predictor
from gr_cast.twin.places.remembered import remembered
from gr_cast.twin.places.world import Mesh, Person, Radio, World, frozen


def predictor():
    return Predictor(["a"], ["b"], np.array([0.0, 0.5]), np.linspace(-1e8, 1e8, 8))


def yard(**changes) -> World:
    """Two nodes, a board that sends an image of one to the other, and one that neither a path nor a shadow touches."""
    corners = {
        "near": [(0, 3, 0), (9, 3, 0), (9, 3, 4), (0, 3, 4)],
        "aside": [(3, -2.0, 0.5), (4, -2.6, 0.5), (4, -2.6, 1.6), (3, -2.0, 1.6)],
    }
    solids = tuple(Solid(name=n, vertices_m=np.array(p, float), faces=[[0, 1, 2], [0, 2, 3]]) for n, p in corners.items())
    media = {name: Medium(material="concrete") for name in corners}
    mesh = Mesh.of(solids, np.zeros((0, 3)))
    radios = {
        name: Radio(node=Node(name=name, waypoints_m=[at], antenna="tr38901", orientation_rad=(yaw, 0.0, 0.0)))
        for name, at, yaw in (("a", (0.5, 0.0, 1.2), 0.2), ("b", (8.0, 0.4, 1.5), 2.6))
    }
    surface = surface_of([media[name] for name in mesh.names], 3e9)
    return replace(World(mesh=mesh, media=media, surface=surface, radios=radios, carrier_hz=3e9, max_depth=1), **changes)


PERSON = Person(
    position_m=(4.3, -2.9, 0.0), velocity_m_per_s=(0.2, 0.0, 0.0), cross_section_m2=1.0, radius_m=0.3, height_m=1.8
)  # fmt: skip


@pytest.mark.parametrize("switch", [{"diffraction": True}, {"person": PERSON}])
def test_objects_that_only_edges_or_echoes_see_are_no_memory_of_others(switch):
    world = yard(**switch)
    index = world.mesh.index("aside")
    without, used = world.with_surface(index, present=False), predictor()
    before = used.response(world)
    assert (used.response(without) == predictor().response(without)).all()
    assert np.abs(before - used.response(without)).max() > 1e-6 * np.abs(before).max()


def test_scattered_powers_follow_carrier_antennas_and_surfaces():
    world, used = yard(), predictor()
    world = world.with_surface(slice(None), scattering=0.5)
    turned = replace(world.radios["a"].node, orientation_rad=(1.2, 0.0, 0.0))
    others = [
        replace(world, carrier_hz=4e9),
        world.with_radio("a", node=turned),
        world.with_surface(0, thickness_m=0.02),
        world.with_surface(1, clear=True),
    ]
    diffuse.profiles(world, used, 0, 8, 2.5e7)
    for other in others:
        again, afresh = (diffuse.profiles(other, one, 0, 8, 2.5e7)[0] for one in (used, predictor()))
        assert (again == afresh).all()


def test_what_is_made_may_be_remembered_in_the_same_place_and_push_out_what_was_asked_for_with_it():
    memory = OrderedDict()
    assert remembered(memory, ["a"], lambda missing: [1], kept=3) == [1]

    def make(missing):
        for number in range(5):
            remembered(memory, [number], lambda _: [0], kept=3)
        return [2]

    assert remembered(memory, ["a", "b"], make, kept=3) == [1, 2]
    assert list(memory)[-2:] == ["a", "b"] and len(memory) == 3


def test_one_object_more_where_it_stood_is_the_same_mesh_whatever_it_is_made_of():
    world, used = yard(), predictor()
    corners = [(2.0, -3.0, 0.0), (7.0, -3.2, 0.0), (7.0, -3.2, 3.0), (2.0, -3.0, 3.0)]
    boards = [Solid(name="more", vertices_m=np.add(corners, (0, m, 0)), faces=[[0, 1, 2], [0, 2, 3]]) for m in (0.0, 0.0, 0.3)]
    made = [world.with_object(board, permittivity=p, conductivity=0.1) for board, p in zip(boards, (3.0, 6.0, 6.0), strict=True)]
    assert made[0].mesh is made[1].mesh is not made[2].mesh
    told = [used.response(one) for one in made]
    for one, response in zip(made, told, strict=True):
        assert (response == predictor().response(one)).all()
    assert np.abs(told[0] - told[1]).max() > 1e-3 * np.abs(told[0]).max() < np.abs(told[1] - told[2]).max() * 1e3


def test_responses_are_those_of_tables_cables_and_losses():
    world = replace(yard(), link_loss_db={("a", "b"): 3.0}).with_radio("a", gain_db=2.0, delay_s=1e-9)
    used = predictor()
    table = used.path_table(world, 0)
    length_m, f_hz = table.way.length_m[:, None], used.frequency_hz
    told = (table.gain[:, None] * np.exp(-2j * np.pi * (world.carrier_hz + f_hz) * length_m / 299792458)).sum(axis=0)
    told = told * 10 ** (-1 / 20) * np.exp(-2j * np.pi * f_hz * 1e-9)
    np.testing.assert_allclose(used.response(world)[0], np.broadcast_to(told, (2, 8)), atol=1e-12)


@pytest.mark.parametrize("switch", [{}, {"diffraction": True}, {"person": PERSON}])
@pytest.mark.parametrize("seed", range(3))
def test_links_that_a_change_does_not_touch_are_as_they_were_and_all_others_anew(seed, switch):
    """Objects that move and are added, frozen paths, in any order: as a predictor has it that was asked nothing before."""
    random, world = np.random.default_rng(seed), replace(yard(**switch), max_depth=2)
    third = replace(world.radios["b"].node, name="c", waypoints_m=np.array([[3.0, -4.0, 1.0]]))
    world = replace(world, radios={**world.radios, "c": Radio(node=third)})
    make = lambda: Predictor(["a", "a", "b"], ["b", "c", "c"], np.array([0.0, 0.5]), np.linspace(-1e8, 1e8, 8))  # noqa: E731
    used, known, kept = make(), [world], 0
    for _ in range(30):
        last = known[random.integers(len(known))]
        if len(last.mesh.names) < 4 and random.random() < 0.4:
            corners = np.array([(0, 0, 0), (1.5, 0.4, 0), (1.5, 0.4, 2), (0, 0, 2.0)]) + random.uniform([0, -5, 0], [8, 2, 1])
            board = Solid(name=f"more_{len(last.mesh.names)}", vertices_m=corners, faces=[[0, 1, 2], [0, 2, 3]])
            other = last.with_object(board, permittivity=random.uniform(2, 8), conductivity=0.1)
        else:
            name = last.mesh.names[random.integers(2)]
            other = replace(last, mesh=last.mesh.moved(name, random.uniform(-0.3, 0.3, 3)))
            if random.random() < 0.4:
                other = frozen(other, last)
        told, before = used.response(other), used.response(last)
        assert (told == make().response(other)).all()
        kept += int((told == before).all(axis=(1, 2)).sum())
        known.append(replace(other, frozen=None))
    assert kept < 90 and (kept or switch)  # edges hear of all that moves
