# SPDX-License-Identifier: GPL-3.0-or-later
"""The ray tracer against closed forms. It runs in its own Python: see apps/install_raytracer.sh."""

import io
import itertools
import json
import os
import pickle
import subprocess
from pathlib import Path

import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.scenario.create import materials, mesh_files, spec, trace
from gr_cast.scenario.create.geometry import Solid
from gr_cast.scenario.create.media import Medium

C_M_PER_S, EPSILON_0 = 299_792_458.0, 8.8541878128e-12
THICK_M = {"concrete": 0.2, "medium_dry_ground": 10.0}
CARRIER_HZ = 2.4e9
WAVELENGTH_M = C_M_PER_S / CARRIER_HZ
PYTHON = Path(os.environ.get("CAST_RAYTRACER") or sc.data_folder() / "raytracer/bin/python")
SECOND_TRACER = Path(os.environ.get("CAST_DIFFERT") or sc.data_folder() / "differt/bin/python")
ITU = {"concrete": (5.24, 0.0, 0.0462, 0.7822), "medium_dry_ground": (15.0, -0.1, 0.035, 1.63)}  # P.2040-3, table 3


@pytest.fixture(scope="module", autouse=True)
def ray_tracer():
    if not PYTHON.exists():
        pytest.skip(f"NO RAY TRACER at {PYTHON}: bash apps/install_raytracer.sh")


def traced(solids, tx_m, rx_m, depth, velocity=(0.0, 0.0, 0.0), antenna="iso", tx_orientation=(0.0, 0.0, 0.0), **mechanisms):
    """Trace one pair in the tracer's Python; rx moves at `velocity`."""
    task = trace.Task(
        name="test", pairs=((0, 1),), antennas=(antenna, "iso"), orientation_rad=np.array([tx_orientation, (0, 0, 0)], float),
        position_m=np.array([tx_m, rx_m], float),
        velocity_before=np.array([(0, 0, 0), velocity], float), velocity_after=np.array([(0, 0, 0), velocity], float),
    )  # fmt: skip
    settings = trace.Settings(carrier_hz=CARRIER_HZ, max_depth=depth, rays=50_000, **mechanisms)
    code = (
        "import pickle, sys; sys.path[:0] = pickle.load(sys.stdin.buffer); from gr_cast.scenario.create import trace;"
        "table = trace.run(*pickle.load(sys.stdin.buffer)); sys.stdout.buffer.write(b'RESULT' + pickle.dumps(table))"
    )
    package = Path(trace.__file__).resolve().parents[3]
    work = pickle.dumps([str(package)]) + pickle.dumps((solids, settings, task))
    done = subprocess.run([str(PYTHON), "-W", "ignore", "-c", code], input=work, capture_output=True, timeout=500, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return pickle.loads(done.stdout.partition(b"RESULT")[2])


def sheet(name, material, *corners, **numbers):
    return Solid(
        name=name,
        vertices_m=np.array(corners, float),
        faces=[[0, 1, 2], [0, 2, 3]],
        medium=Medium(**dict(material=material, thickness_m=THICK_M.get(material, 0.1)) | numbers),
    )


def reflection(material, cosine, thickness_m):
    """TE and TM reflection of a slab (ITU-R P.2040-3, eqs. 31 and 37 to 39)."""
    a, b, c, d = ITU[material]
    ghz = CARRIER_HZ / 1e9
    eta = a * ghz**b - 1j * c * ghz**d / (2 * np.pi * CARRIER_HZ * EPSILON_0)
    root = np.sqrt(eta - (1 - cosine**2))
    te, tm = (cosine - root) / (cosine + root), (eta * cosine - root) / (eta * cosine + root)
    phase = np.exp(-2j * 2 * np.pi * thickness_m / WAVELENGTH_M * root)
    return [r * (1 - phase) / (1 - r**2 * phase) for r in (te, tm)]


def db(ratio):
    return 20 * np.log10(np.abs(ratio))


GROUND = sheet("ground", "medium_dry_ground", (-200, -200, 0), (200, -200, 0), (200, 200, 0), (-200, 200, 0))


def test_free_space_and_two_rays_over_ground_follow_their_formulas():
    tx, rx, velocity = np.array([0, 0, 10.0]), np.array([60.0, 25.0, 1.5]), np.array([5.0, -3.0, 0.5])
    table = traced([GROUND], tx, rx, 1, velocity)
    order = np.argsort(table.delay_s)
    assert len(order) == 2
    image = tx * [1, 1, -1]
    lengths_m = np.array([np.linalg.norm(rx - tx), np.linalg.norm(rx - image)])
    np.testing.assert_allclose(table.delay_s[order], lengths_m / C_M_PER_S, rtol=1e-9)
    doppler_hz = np.array(
        [-(rx - p) @ velocity / length / WAVELENGTH_M for p, length in zip((tx, image), lengths_m, strict=True)]
    )
    np.testing.assert_allclose(-CARRIER_HZ * table.rate_after[order], doppler_hz, atol=0.01)
    gamma = reflection("medium_dry_ground", (tx[2] + rx[2]) / lengths_m[1], 10.0)[1]
    expected = WAVELENGTH_M / (4 * np.pi * lengths_m) * [1, gamma]
    assert np.abs(db(table.gain[order] / expected)).max() < 0.01
    assert np.abs(np.angle(table.gain[order] / expected)).max() < 1e-3


def room_images(size_m, tx, rx, order):
    """Delays and gains of a shoebox of concrete by images, with the field's polarisation followed bounce by bounce."""
    paths = []
    for n in itertools.product(range(-order, order + 1), repeat=3):
        if sum(map(abs, n)) > order:
            continue
        image = np.array([k * s + (x if k % 2 == 0 else s - x) for k, s, x in zip(n, size_m, tx, strict=True)])
        way = rx - image
        length_m = np.linalg.norm(way)
        k = way / length_m
        # Walls crossed by the straight line from the image to rx, in order: one axis per bounce.
        crossings = []
        for axis in range(3):
            low, high = sorted((image[axis], rx[axis]))
            for wall in range(-order - 1, order + 2):
                if low < wall * size_m[axis] < high:
                    crossings.append(((wall * size_m[axis] - image[axis]) / way[axis], axis))
        k = k * [(-1) ** (abs(step) % 2) for step in n]  # the direction in which it leaves tx itself
        field = theta_hat(k).astype(complex)
        for _, axis in sorted(crossings):
            normal = np.eye(3)[axis]
            te, tm = reflection("concrete", abs(k[axis]), 0.2)
            across = np.cross(k, normal)
            across = across / np.linalg.norm(across)
            out = k - 2 * k[axis] * normal
            field = te * (field @ across) * across + tm * (field @ np.cross(across, k)) * np.cross(across, out)
            k = out
        paths.append((length_m / C_M_PER_S, abs(field @ theta_hat(k)) * WAVELENGTH_M / (4 * np.pi * length_m)))
    return np.array(sorted(paths)).T


def theta_hat(k):
    theta, phi = np.arccos(k[2]), np.arctan2(k[1], k[0])
    return np.array([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), -np.sin(theta)])


def test_a_shoebox_room_has_the_paths_delays_and_gains_of_its_images():
    x, y, z = size_m = (19.0, 12.0, 3.2)
    walls = [
        sheet("floor", "concrete", (0, 0, 0), (x, 0, 0), (x, y, 0), (0, y, 0)),
        sheet("ceiling", "concrete", (0, 0, z), (0, y, z), (x, y, z), (x, 0, z)),
        sheet("west", "concrete", (0, 0, 0), (0, y, 0), (0, y, z), (0, 0, z)),
        sheet("east", "concrete", (x, 0, 0), (x, 0, z), (x, y, z), (x, y, 0)),
        sheet("south", "concrete", (0, 0, 0), (0, 0, z), (x, 0, z), (x, 0, 0)),
        sheet("north", "concrete", (0, y, 0), (x, y, 0), (x, y, z), (0, y, z)),
    ]
    tx, rx = np.array([3.1, 4.2, 2.84]), np.array([11.3, 7.7, 1.0])
    table = traced(walls, tx, rx, 3)
    delay_s, gain = room_images(size_m, tx, rx, 3)
    order = np.argsort(table.delay_s)
    assert len(order) == len(delay_s) == 63
    np.testing.assert_allclose(table.delay_s[order], delay_s, rtol=1e-9)
    assert np.abs(db(np.abs(table.gain[order]) / gain)).max() < 0.01


# Every chain of up to `order` triangles is tried: the image of the transmitter, then whether the way is free. Its own
# tolerance is so tight that single precision hides two paths with bounces 16 mm apart in the edge of wall and ceiling.
EXHAUSTIVE = """
import io, json, sys
import numpy as np
from differt.geometry import Mesh, Scene
given = np.load(io.BytesIO(sys.stdin.buffer.read()))
mesh = Mesh(vertices=given["vertices_m"], triangles=given["faces"])
scene = Scene(transmitters=given["tx_m"], receivers=given["rx_m"], mesh=mesh)
lengths_m = []
for order in range(int(given["order"]) + 1):
    corners = np.asarray(scene.trace_paths(order, solver="exhaustive", hit_tol=1e-3).masked_vertices, float)
    lengths_m += np.linalg.norm(np.diff(corners, axis=1), axis=2).sum(axis=1).tolist()
print("LENGTHS", json.dumps(lengths_m))
"""


def test_a_second_tracer_finds_the_same_paths_in_the_arena():
    """DiffeRT (Eertmans et al.), an exhaustive tracer in single precision: no path more, none less, of the same lengths."""
    if not SECOND_TRACER.exists():
        pytest.skip(f"NO SECOND TRACER at {SECOND_TRACER}: bash apps/install_raytracer.sh --second")
    arena = spec.read(sc.examples_folder() / "arena.yaml")
    solids = materials.assign(mesh_files.read(arena.model_path), arena.materials, arena.carrier_hz)
    tx, rx = np.array([1.8, 1.8, 2.84]), np.array([7.2, 10.9, 1.0])  # c1 under the ceiling, s6 among the desks
    table = traced(solids, tx, rx, 3)
    first = np.cumsum([0] + [len(solid.vertices_m) for solid in solids])
    scene = io.BytesIO()
    np.savez(
        scene, vertices_m=np.concatenate([solid.vertices_m for solid in solids]).astype(np.float32),
        faces=np.concatenate([solid.faces + start for solid, start in zip(solids, first, strict=False)]).astype(np.int32),
        tx_m=tx.astype(np.float32), rx_m=rx.astype(np.float32), order=3,
    )  # fmt: skip
    done = subprocess.run(
        [str(SECOND_TRACER), "-c", EXHAUSTIVE], input=scene.getvalue(), capture_output=True, timeout=500, check=False
    )
    assert done.returncode == 0, done.stderr.decode()
    lengths_m = np.sort(json.loads(done.stdout.partition(b"LENGTHS")[2]))
    assert len(table.delay_s) == len(lengths_m) == 48
    np.testing.assert_allclose(np.sort(table.delay_s) * C_M_PER_S, lengths_m, rtol=2e-6)


def test_an_antenna_looks_where_its_orientation_turns_it():
    """3GPP TR 38.901, table 7.3-1: 8 dB ahead, 12 (φ/65°)² less aside, 12 (θ/65°)² less above, 22 dB below at most."""
    tx = np.zeros(3)
    for direction, orientation, loss_db in (
        ((1, 0, 0), (0, 0, 0), 0.0),
        ((0, 1, 0), (np.pi / 2, 0, 0), 0.0),
        ((0, 1, 0), (np.pi / 2 - 0.5, 0, 0), 12 * (np.degrees(0.5) / 65) ** 2),
        ((np.cos(0.4), 0, -np.sin(0.4)), (0, 0.4, 0), 0.0),  # a positive pitch looks down
        ((1, 0, 0), (0, 0.4, 0), 12 * (np.degrees(0.4) / 65) ** 2),
    ):
        table = traced(
            [GROUND], tx + [0, 0, 500], 30 * np.array(direction) + [0, 0, 500], 0, antenna="tr38901", tx_orientation=orientation
        )
        found_db = db(table.gain[0] / (WAVELENGTH_M / (4 * np.pi * 30)))
        # Turned up or down, its field is no longer vertical where it arrives aside; here it stays in the plane of sight.
        assert found_db == pytest.approx(8 - loss_db, abs=0.02)


PANEL = ((-40, 0, -40), (40, 0, -40), (40, 0, 40), (-40, 0, 40))


def test_a_leg_through_a_wall_has_the_transmission_of_its_slab_and_needs_no_depth():
    wall = sheet("wall", "concrete", *PANEL, thickness_m=0.1)
    tx, rx = np.array([0.0, -5, 0]), np.array([2.0, 7, 0])
    assert not len(traced([wall], tx, rx, 0).gain)
    table = traced([wall], tx, rx, 0, refraction=True)
    assert len(table.gain) == 1 and table.delay_s[0] == pytest.approx(np.linalg.norm(rx - tx) / C_M_PER_S, rel=1e-9)
    cosine = 12 / np.linalg.norm(rx - tx)
    a, b, c, d = ITU["concrete"]
    eta = a - 1j * c * 2.4**d / (2 * np.pi * CARRIER_HZ * EPSILON_0)
    root = np.sqrt(eta - (1 - cosine**2))
    te = (cosine - root) / (cosine + root)
    once = np.exp(-2j * np.pi * 0.1 / WAVELENGTH_M * root)
    through = (1 - te**2) * once / (1 - te**2 * once**2)  # P.2040-3, eq. 38; the wall stands up, its field lies across: TE
    assert table.gain[0] / (WAVELENGTH_M / (4 * np.pi * np.linalg.norm(rx - tx))) == pytest.approx(through, rel=1e-3)


def test_numbers_of_a_wall_of_its_own_make_its_reflection():
    tx, rx = np.array([-3.0, -4, 0]), np.array([3.0, -4, 0])
    wall = sheet("wall", None, *PANEL, own_permittivity=9.0, own_conductivity_s_per_m=0.0, thickness_m=0.02)
    table = traced([wall], tx, rx, 1)
    bounced = table.gain[np.argmax(table.delay_s)] / (WAVELENGTH_M / (4 * np.pi * 10))
    root = np.sqrt(9 - 0.36)
    r, phase = (0.8 - root) / (0.8 + root), np.exp(-4j * np.pi * 0.02 / WAVELENGTH_M * root)
    assert bounced == pytest.approx(r * (1 - phase) / (1 - r**2 * phase), rel=1e-3)


def test_roughness_takes_from_reflections_what_ament_says():
    tx, rx = np.array([-3.0, -4, 0]), np.array([3.0, -4, 0])
    smooth, rough = (traced([sheet("wall", "concrete", *PANEL, height_rms_m=h)], tx, rx, 1) for h in (0.0, 0.01))
    direct, bounced = np.argsort(smooth.delay_s)
    ratio = np.abs(rough.gain / smooth.gain)
    assert ratio[direct] == pytest.approx(1)
    assert ratio[bounced] == pytest.approx(np.exp(-8 * (np.pi * 0.01 * 0.8 / WAVELENGTH_M) ** 2), rel=1e-4)


def test_behind_an_edge_the_field_is_that_of_a_knife_edge():
    """ITU-R P.526-15, section 4.1: a half plane's loss by its parameter ν."""
    screen = sheet("screen", "metal", (-200, 0, -200), (200, 0, -200), (200, 0, 0), (-200, 0, 0))
    for depth_m in (0.7, 1.5):  # below the edge, with 20 m on either side
        tx, rx = np.array([0, -20.0, -depth_m]), np.array([0, 20.0, -depth_m])
        table = traced([screen], tx, rx, 0, velocity=(0, 1.0, 0), diffraction=True)
        nearest = np.argmin(table.delay_s)
        way_m = 2 * np.hypot(20, depth_m)
        assert table.delay_s[nearest] == pytest.approx(way_m / C_M_PER_S, rel=1e-6)
        assert table.rate_after[nearest] == pytest.approx(20 / (way_m / 2) / C_M_PER_S, rel=1e-3)
        nu = depth_m * np.sqrt(2 / WAVELENGTH_M * (1 / 20 + 1 / 20))
        knife_db = 6.9 + 20 * np.log10(np.sqrt((nu - 0.1) ** 2 + 1) + nu - 0.1)
        assert db(table.gain[nearest] / (WAVELENGTH_M / (4 * np.pi * 40))) == pytest.approx(-knife_db, abs=1.5)


def test_a_wall_that_scatters_takes_it_from_its_reflection_and_gives_it_to_patches():
    tx, rx = np.array([-3.0, -4, 0]), np.array([3.0, -4, 0])
    found = {}
    for share in (0.0, 0.2, 0.4):
        wall = sheet("wall", "metal", (-9, 0, -9), (9, 0, -9), (9, 0, 9), (-9, 0, 9), scattering_coefficient=share)
        table = traced([wall], tx, rx, 1, scattering=True)
        patch = table.surfaces[:, -1] >= 0
        bounced = np.isclose(table.delay_s, 10 / C_M_PER_S, rtol=1e-6) & ~patch
        found[share] = np.abs(table.gain[bounced]).max(), (np.abs(table.gain[patch]) ** 2).sum()
        assert len({tuple(row) for row in table.surfaces.tolist()}) == len(table.surfaces)
        if patch.any():
            assert (table.delay_s[patch] > 10 / C_M_PER_S * (1 - 1e-6)).all()  # no way by the wall is shorter
    assert found[0.0][1] == 0
    for share in (0.2, 0.4):
        assert found[share][0] / found[0.0][0] == pytest.approx(np.sqrt(1 - share**2), rel=1e-3)
    assert found[0.4][1] / found[0.2][1] == pytest.approx(4, rel=0.1)  # of as many rays
    # Degli-Esposti 2007, Lambertian: each patch gives what falls on it back by the cosine over π.
    x, z = np.meshgrid(np.linspace(-8.9, 8.9, 90), np.linspace(-8.9, 8.9, 90))
    patch_m = np.stack([x, 0 * x, z], axis=-1)
    to, on = np.linalg.norm(patch_m - tx, axis=2), np.linalg.norm(rx - patch_m, axis=2)
    density = (WAVELENGTH_M / (4 * np.pi)) ** 2 * 0.4**2 * (4 / to) * (4 / on) / np.pi / (to * on) ** 2
    assert 10 * np.log10(found[0.4][1] / (density.sum() * 0.2**2)) == pytest.approx(0, abs=3)


def test_without_the_mechanism_a_scattering_wall_reflects_as_any():
    tx, rx = np.array([-3.0, -4, 0]), np.array([3.0, -4, 0])
    plain, other = (traced([sheet("wall", "metal", *PANEL, scattering_coefficient=s)], tx, rx, 1) for s in (0.0, 0.5))
    np.testing.assert_array_equal(plain.gain, other.gain)
