# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials of a SPEC: ITU-R P.2040-3 by name, and numbers of their own."""

import json
import os
import subprocess
from pathlib import Path

import pytest
import yaml
from gr_cast import scenario as sc
from gr_cast.core.documents import Reader
from gr_cast.core.errors import CastError
from gr_cast.scenario.create import materials, spec
from gr_cast.scenario.create.media import ITU, Medium

PYTHON = Path(os.environ.get("CAST_RAYTRACER") or sc.data_folder() / "raytracer/bin/python")


def rules(entries):
    get = Reader("spec.yaml")
    found = materials.read_rules(get, entries)
    get.faults.raise_if_any()
    return found


def test_the_table_is_that_of_another_implementation_of_the_recommendation():
    if not PYTHON.exists():
        pytest.skip(f"NO RAY TRACER at {PYTHON}: bash apps/install_raytracer.sh")
    code = (
        "import json, re; from importlib.util import find_spec; from pathlib import Path;"
        "text = (Path(find_spec('sionna').submodule_search_locations[0]) / 'rt/radio_materials/itu.py').read_text();"
        "table = text[text.index('ITU_MATERIALS_PROPERTIES = {'):text.index('def itu_material')];"
        "names = {}; exec(table, names);"
        "print(json.dumps({name: [*next(iter(bands.values())), *next(iter(bands))]"
        " for name, bands in names['ITU_MATERIALS_PROPERTIES'].items()}))"
    )
    done = subprocess.run([str(PYTHON), "-c", code], capture_output=True, text=True, timeout=100, check=True)
    theirs = json.loads(done.stdout)
    assert {name: list(map(float, row)) for name, row in ITU.items()} == {name: list(map(float, theirs[name])) for name in ITU}


def test_permittivity_and_conductivity_follow_the_powers_of_frequency_that_the_recommendation_gives():
    wet = Medium(material="wet_ground")  # its table: 30 f^-0.4 and 0.15 f^1.3
    assert (wet.permittivity(1e9), wet.conductivity(1e9)) == (30.0, 0.15)
    assert wet.permittivity(4e9) == pytest.approx(30 / 4**0.4) and wet.conductivity(4e9) == pytest.approx(0.15 * 4**1.3)
    lossy = wet.complex_permittivity(2e9)
    assert lossy.imag == pytest.approx(-wet.conductivity(2e9) * 17.98 / 2, rel=1e-3)  # P.2040-3, eq. 13: 17.98 σ / f_GHz


def test_a_name_or_numbers_make_a_medium_and_a_tenth_of_a_metre_is_its_thickness():
    found = rules(
        {
            "a": "brick",
            "b": {"material": "glass", "thickness_m": 0.006},
            "c": {"permittivity": 4.5, "conductivity": 0.02, "height_rms_m": 0.01},
            "d": {"material": "wood", "permittivity": 2.5, "scattering_coefficient": 0.3},
        }
    )
    assert found["a"] == Medium(material="brick") and found["a"].thickness_m == 0.1
    assert found["b"].thickness_m == 0.006
    assert (found["c"].permittivity(9e9), found["c"].conductivity(9e9), found["c"].height_rms_m) == (4.5, 0.02, 0.01)
    assert found["d"].permittivity(2e9) == 2.5 and found["d"].conductivity(2e9) == pytest.approx(0.0047 * 2**1.0718)
    assert rules({name: materials.entry(medium) for name, medium in found.items()}) == found


@pytest.mark.parametrize(
    "entry, says",
    [
        ("cheese", "materials.x: got 'cheese', needs one of concrete"),
        ({"thickness_m": 0.1}, "materials.x: needs a material, or a permittivity of its own"),
        ({"material": "wood", "thickness_m": 0}, "materials.x.thickness_m: got 0, needs a finite number of m in 1e-05 to 100"),
        ({"material": "wood", "permittivity": 0.5}, "materials.x.permittivity: got 0.5, needs a finite number in 1 to 1000"),
        ({"material": "wood", "colour": 3}, "materials.x: unknown key 'colour'"),
        ({"material": "wood", "scattering_coefficient": 2}, "materials.x.scattering_coefficient: got 2"),
        ({"permittivity": 3, "conductivity": float("nan")}, "materials.x.conductivity: got nan"),
        (3.5, "materials.x: got 3.5, needs text"),
    ],
)
def test_what_no_surface_is_made_of_is_refused_with_its_place(entry, says):
    with pytest.raises(CastError) as error:
        rules({"x": entry})
    assert len(error.value.faults) == 1 and says in error.value.faults[0]


SPEC = """
cast_create: 1
environment: {carrier_hz: 5.0e9, bandwidth_hz: 1.0e9}
model: {mesh: room.obj}
materials: {"*": concrete}
nodes:
  a: {position_m: [0, 0, 1], antenna: tr38901, orientation_rad: [0.5, -0.1, 0]}
  b: {position_m: [3, 0, 1]}
sampling: {refraction: true, diffraction: true, scattering: true}
"""


def test_a_spec_says_where_antennas_look_which_mechanisms_there_are_and_bands_of_a_gigahertz(tmp_path):
    (tmp_path / "room.obj").write_text("v 0 0 0\n")
    (tmp_path / "s.yaml").write_text(SPEC)
    made = spec.read(tmp_path / "s.yaml")
    assert [node.orientation_rad for node in made.nodes] == [(0.5, -0.1, 0.0), (0.0, 0.0, 0.0)]
    assert made.refraction and made.diffraction and made.scattering and made.bandwidth_hz == 1e9


def test_a_band_beyond_a_gigahertz_and_an_orientation_of_two_angles_are_refused_together(tmp_path):
    (tmp_path / "room.obj").write_text("v 0 0 0\n")
    document = yaml.safe_load(SPEC) | {"environment": {"carrier_hz": 5.0e9, "bandwidth_hz": 2e9}}
    document["nodes"]["a"]["orientation_rad"] = [0.5, 0.1]
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(CastError) as error:
        spec.read(tmp_path / "s.yaml")
    assert [fault.split("s.yaml: ")[1].split(":")[0] for fault in error.value.faults] == [
        "environment.bandwidth_hz", "nodes.a.orientation_rad"
    ]  # fmt: skip
