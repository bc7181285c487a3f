# SPDX-License-Identifier: GPL-3.0-or-later
"""The bench's own tracer against closed forms, against Sionna RT where it is, and against soundings made by others."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.special import fresnel

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench" / "places"))

import recompute
import slabs
import spaces
import world as worlds
from gr_cast import scenario as sc

C_M_PER_S, FC = 299792458.0, 3e9
WAVE = C_M_PER_S / FC
PYTHON = Path(os.environ.get("CAST_RAYTRACER") or sc.data_folder() / "raytracer/bin/python")


def _node(position, antenna="iso", turn=(0, 0, 0)):
    return {"waypoints_m": [list(position)], "speed_m_per_s": 0.0, "antenna": antenna, "orientation_rad": list(turn)}


def _world(sheets=(), **changes):
    """World of metal sheets: (corner, u, v)."""
    w = worlds.new_world() | {"carrier_hz": FC} | changes
    for k, (corner, u, v) in enumerate(sheets):
        w["objects"][f"s{k}"] = {"tris": spaces.sheet(*(np.array(x, float) for x in (corner, u, v))), "surface": None}
        w["materials"][f"s{k}"] = "metal"
    return w


def _heard(w, a, b, f=(0.0,), antenna="iso", turn=(0, 0, 0)):
    w["nodes"] = {"a": _node(a, antenna, turn), "b": _node(b)}
    return worlds.response(w, [("a", "b")], np.zeros(1), np.array(f))[0, 0]


def test_free_space_is_friis_with_the_phase_of_the_delay():
    f = np.array([-1e8, 0, 1e8])
    h = _heard(_world(), (0, 0, 2), (7, 0, 2), f)
    assert np.allclose(h, WAVE / (4 * np.pi * 7) * np.exp(-2j * np.pi * (FC + f) * 7 / C_M_PER_S), rtol=1e-9)


@pytest.mark.parametrize(("antenna", "db"), [("iso", 0.0), ("dipole", 1.7609), ("hw_dipole", 2.1564), ("tr38901", 8.0)])
def test_antennas_have_the_gain_of_the_book_and_a_turned_one_looks_elsewhere(antenna, db):
    ahead = abs(_heard(_world(), (0, 0, 2), (7, 0, 2), antenna=antenna)[0])
    assert 20 * np.log10(ahead * 4 * np.pi * 7 / WAVE) == pytest.approx(db, abs=2e-3)
    turned = abs(_heard(_world(), (0, 0, 2), (0, 7, 2), antenna=antenna, turn=(np.pi / 2, 0, 0))[0])
    assert turned == pytest.approx(ahead, rel=1e-9)
    if antenna == "tr38901":
        off = abs(_heard(_world(), (0, 0, 2), (7, 0, 2), antenna=antenna, turn=(np.radians(32.5), 0, 0))[0])
        assert 20 * np.log10(off / ahead) == pytest.approx(-3, abs=1e-9)
        down = abs(_heard(_world(), (0, 0, 5), (5, 0, 0), antenna=antenna, turn=(0, np.pi / 4, 0))[0])
        straight = abs(_heard(_world(), (0, 0, 5), (5, 0, 0))[0])
        assert 20 * np.log10(down / straight) == pytest.approx(8, abs=1e-9)


@pytest.mark.parametrize("upright", [False, True])
def test_a_thick_ground_or_wall_is_fresnel(upright):
    """Two rays: level ground reflects the magnetic component, an upright wall the electric one."""
    permittivity, conductivity, apart, high = 7.0, 0.05, 30.0, 3.0
    if upright:
        w = _world([((-99, 0, -99), (198, 0, 0), (0, 0, 198))])
        w["media"]["s0"] = {"permittivity": permittivity, "conductivity": conductivity, "thickness_m": 50.0}
        h = _heard(w, (0, high, 0), (apart, high, 0))[0]
    else:
        w = _world(ground={"height_m": 0.0, "permittivity": permittivity, "conductivity": conductivity})
        h = _heard(w, (0, 0, high), (apart, 0, high))[0]
    eta = permittivity - 1j * conductivity / (8.8541878128e-12 * 2 * np.pi * FC)
    far = np.hypot(apart, 2 * high)
    cosine = 2 * high / far
    root = np.sqrt(eta - 1 + cosine**2)
    r = (cosine - root) / (cosine + root) if upright else (eta * cosine - root) / (eta * cosine + root)
    # what a vertical field keeps of itself on the way down and up again: the electric one all, the magnetic one all in its plane
    two = np.exp(-2j * np.pi * apart / WAVE) / apart + r * np.exp(-2j * np.pi * far / WAVE) / far
    assert h == pytest.approx(WAVE / (4 * np.pi) * two, rel=1e-6)


def test_a_slab_without_loss_keeps_all_energy_and_half_waves_pass():
    cosine = np.linspace(0.05, 1, 50)
    r_te, r_tm, t_te, t_tm = slabs.slab(6.3, 0.0, 0.1, FC, cosine)
    assert np.allclose(abs(r_te) ** 2 + abs(t_te) ** 2, 1) and np.allclose(abs(r_tm) ** 2 + abs(t_tm) ** 2, 1)
    assert abs(slabs.slab(4.0, 0.0, WAVE / 4, FC, 1.0)[0]) < 1e-12


def test_in_a_metal_box_every_image_within_the_order_is_heard_once():
    size, a, b = np.array([4.0, 5, 3]), np.array([1.0, 2, 1.2]), np.array([2.9, 3.6, 1.7])
    x, y, z = np.diag(size)
    o = np.zeros(3)
    w = _world([(o, x, y), (z, x, y), (o, x, z), (y, x, z), (o, y, z), (x, y, z)], max_depth=3)
    w["nodes"] = {"a": _node(a), "b": _node(b)}
    delay = np.sort(worlds.components(w, [("a", "b")], np.zeros(1))[3])
    axes = [[(n, abs(n), n * s + (q if n % 2 == 0 else s - q)) for n in range(-3, 4)] for s, q in zip(size, a, strict=True)]
    images = [np.array([i[2], j[2], k[2]]) for i in axes[0] for j in axes[1] for k in axes[2] if i[1] + j[1] + k[1] <= 3]
    assert np.allclose(delay, np.sort([np.linalg.norm(p - b) / C_M_PER_S for p in images]), rtol=1e-12)


def test_an_edge_diffracts_as_sommerfelds_half_plane():
    """Electric field along the edge of a metal sheet, plane wave: the exact sum of two Fresnel integrals, all around."""
    w = _world([((-4000, 0, -4000), (4000, 0, 0), (0, 0, 8000))], diffraction=True)
    far, near, phi_i = 2e5, 4.0, np.radians(70)
    k = 2 * np.pi / WAVE

    def at(radius, phi):  # angles from the sheet
        return radius * np.array([-np.cos(phi), np.sin(phi), 0])

    def half(psi):
        s, c = fresnel(2 * np.sqrt(k * near / np.pi) * abs(np.cos(psi / 2)))
        tail = ((0.5 - c) - 1j * (0.5 - s)) * (1 + 1j) / 2
        return np.exp(1j * k * near * np.cos(psi)) * (1 - tail if np.cos(psi / 2) > 0 else tail)

    for phi in np.radians([10, 60, 100, 109, 111, 140, 200, 249, 251, 280, 340]):
        h = abs(_heard(w, at(far, phi_i), at(near, phi))[0]) * 4 * np.pi * far / WAVE
        assert h == pytest.approx(abs(half(phi - phi_i) - half(phi + phi_i)), abs=0.01)


def test_soundings_made_by_others_are_predicted_to_the_noise_by_their_true_worlds(cast_data):
    """Practice cases with their truths: χ² per real number is 1 after what they do not claim to know is fitted."""
    truths = sorted((cast_data / "places-truth").glob("*.json"))
    if not truths:
        pytest.skip(f"NO PRACTICE PLACES at {cast_data}")
    worst = []
    for path in truths:
        t = json.loads(path.read_text())
        if not t.get("world") or any(e["family"] == "missing_diffraction" for e in t["effects"]):
            continue  # diffraction is judged by family: its amplitude is each tracer's own
        case, w = cast_data / "places" / t["case"], recompute.world_from(t["world"])
        place = yaml.safe_load((case / "place.yaml").read_text())
        for s in place["soundings"]:
            with np.load(case / s["file"]) as z:
                links = list(zip(z["tx"].tolist(), z["rx"].tolist(), strict=True))
                y = z["response"].astype(complex)
                h = worlds.response(w, links, z["time_s"], z["frequency_hz"])
                left, _ = worlds.excess(h, y, z["noise_power"], links, z["frequency_hz"], place["unknown"])
            count = np.isfinite(y).sum()
            worst.append(abs(left / count - 1) * np.sqrt(count))
    assert worst and max(worst) < 5


SIONNA = """
import sys, json
import numpy as np, sionna.rt as rt
job = json.load(sys.stdin)
scene = rt.load_scene(job["scene"], merge_shapes=False)
scene.frequency = job["carrier_hz"]
out = []
for (a, p, o), (b, q, r) in job["pairs"]:
    for x in [*scene.transmitters, *scene.receivers]:
        scene.remove(x)
    array = lambda k: rt.PlanarArray(num_rows=1, num_cols=1, pattern=k, polarization="V")
    scene.tx_array, scene.rx_array = array(a), array(b)
    scene.add(rt.Transmitter("t", p, orientation=o)), scene.add(rt.Receiver("r", q, orientation=r))
    paths = rt.PathSolver()(scene, max_depth=job["depth"], refraction=False, diffuse_reflection=False, samples_per_src=200_000)
    gain, delay = (x.ravel() for x in paths.cir(normalize_delays=False, out_type="numpy"))
    out.append([[float(t), float(g.real), float(g.imag)] for g, t in zip(gain, delay) if abs(g) > 0])
print("RESULT" + json.dumps(out))
"""


@pytest.mark.timeout(240)
def test_every_specular_path_of_sionna_is_ours(tmp_path):
    if not PYTHON.exists():
        pytest.skip(f"NO RAY TRACER at {PYTHON}: bash apps/install_raytracer.sh")
    rng = np.random.default_rng(1)
    w, free, kind = spaces.draw(rng, "corridor")
    w["nodes"], w["max_depth"] = spaces.radios(rng, w, free, 4, 0, 5, kind), 2
    names = list(w["nodes"])
    xml = ['<scene version="2.1.0">']
    for m in sorted(set(w["materials"].values())):
        xml.append(f'<bsdf type="itu-radio-material" id="m-{m}"><string name="type" value="{m}"/>')
        xml.append('<float name="thickness" value="0.1"/></bsdf>')
    for name, thing in w["objects"].items():
        tris = thing["tris"]
        head = f"ply\nformat ascii 1.0\nelement vertex {3 * len(tris)}\nproperty float x\nproperty float y\nproperty float z\n"
        head += f"element face {len(tris)}\nproperty list uchar int vertex_indices\nend_header\n"
        rows = ["{:.9g} {:.9g} {:.9g}".format(*p) for p in tris.reshape(-1, 3)]
        rows += [f"3 {3 * k} {3 * k + 1} {3 * k + 2}" for k in range(len(tris))]
        (tmp_path / f"{name}.ply").write_text(head + "\n".join(rows) + "\n")
        xml.append(f'<shape type="ply" id="mesh-{name}"><string name="filename" value="{name}.ply"/>')
        xml.append(f'<boolean name="face_normals" value="true"/><ref id="m-{w["materials"][name]}" name="bsdf"/></shape>')
    (tmp_path / "s.xml").write_text("\n".join([*xml, "</scene>"]))
    pairs = [(names[0], n) for n in names[1:]]
    ends = [
        [(w["nodes"][n]["antenna"], w["nodes"][n]["waypoints_m"][0], w["nodes"][n]["orientation_rad"]) for n in p] for p in pairs
    ]
    job = {"scene": str(tmp_path / "s.xml"), "carrier_hz": w["carrier_hz"], "depth": 2, "pairs": ends}
    command = [str(PYTHON), "-W", "ignore", "-c", SIONNA]
    done = subprocess.run(command, input=json.dumps(job), capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stderr
    theirs = json.loads(done.stdout.partition("RESULT")[2])
    for pair, rays in zip(pairs, theirs, strict=True):
        _, _, gain, delay, _ = worlds.components(w, [pair], np.zeros(1))
        assert len(rays) > 10
        gain = gain * np.exp(-2j * np.pi * w["carrier_hz"] * delay)
        for t, re, im in rays:
            near = np.flatnonzero(abs(delay - t) < 1e-11)
            assert min(abs(gain[near] - (re + 1j * im))) < 1e-3 * abs(gain).max()
