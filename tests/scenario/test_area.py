# SPDX-License-Identifier: GPL-3.0-or-later
"""Path loss over an area is Friis' where nothing stands, two waves' before a mirror, and nothing is heard behind it."""

import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.core.units import SPEED_OF_LIGHT_M_PER_S
from gr_cast.scenario.create import area, materials, model
from gr_cast.scenario.create.spec import read

WALL_M = 12.0  # y of a metal wall, far longer and higher than the area
CARRIER_HZ = 1e9


@pytest.fixture
def place(tmp_path):
    corners = [(x, WALL_M, z) for x in (-500, 500) for z in (-500, 500)]
    lines = ["o wall", *(f"v {x} {y} {z}" for x, y, z in corners), "f 1 2 4", "f 1 4 3"]
    (tmp_path / "wall.obj").write_text("\n".join(lines) + "\n")
    (tmp_path / "spec.yaml").write_text(f"""cast_create: 1
id: mirror
name: A mirror
environment: {{place: a field, carrier_hz: {CARRIER_HZ}, bandwidth_hz: 1.0e6}}
model: {{mesh: wall.obj}}
materials: {{wall: metal}}
nodes:
  a: {{position_m: [0, 0, 5]}}
  b: {{position_m: [40, 3, 5]}}
sampling: {{duration_s: 1, step_s: 0.5, max_depth: 1, check_instants: 1}}
""")
    spec = read(tmp_path / "spec.yaml")
    return spec, materials.assign(model.read(spec)[0], spec.materials, spec.carrier_hz)


def computed(place, region_m, max_depth):
    wanted = area.Wanted(sender="a", region_m=region_m, height_m=7.0, step_m=4.0, max_depth=max_depth)
    found = area.losses(*place, wanted, bandwidth_hz=1.0)
    x, y = np.meshgrid(found.x_m, found.y_m)
    way_m = [np.sqrt(x**2 + (y - y0) ** 2 + 2.0**2) for y0 in (0, 2 * WALL_M)]  # the sender and its image, 2 m below
    return found.loss_db, way_m


def wave(way_m):
    length_m = SPEED_OF_LIGHT_M_PER_S / CARRIER_HZ
    return length_m / (4 * np.pi * way_m) * np.exp(-2j * np.pi * way_m / length_m)


def test_where_nothing_reflects_it_is_the_loss_of_free_space(place):
    loss_db, (direct_m, _) = computed(place, (5, -20, 45, 10), 0)
    np.testing.assert_allclose(loss_db, -20 * np.log10(np.abs(wave(direct_m))), atol=0.01)


def test_before_a_mirror_two_waves_add_with_their_phases(place):
    """An upright field turns its sign at an upright sheet of metal; the field's tilt over 2 m of height costs a little."""
    loss_db, (direct_m, image_m) = computed(place, (25, -20, 65, 10), 1)
    wanted_db = -20 * np.log10(np.abs(wave(direct_m) - wave(image_m)))
    assert np.ptp(wanted_db) > 10
    np.testing.assert_allclose(loss_db, wanted_db, atol=0.5)


def test_behind_metal_nothing_is_heard(place):
    loss_db, _ = computed(place, (5, WALL_M + 1, 45, WALL_M + 20), 1)
    assert np.isnan(loss_db).all()


def test_all_that_is_wrong_with_what_is_wanted_is_told_at_once(place):
    wanted = area.Wanted(sender="c", time_s=-1, region_m=(5, 0, 4, 9), height_m=np.nan, max_depth=-1)
    with pytest.raises(CastError) as caught:
        wanted.grid(place[0])
    assert len(caught.value.faults) == 5
    with pytest.raises(CastError, match="--step: got 0.001 m"):
        area.Wanted(sender="a", step_m=1e-3).grid(place[0])
