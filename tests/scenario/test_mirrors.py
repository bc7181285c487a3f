# SPDX-License-Identifier: GPL-3.0-or-later
"""Sampling without a ray tracer: mirror images against closed forms, and against Sionna RT where it is installed."""

import pickle
import subprocess
from pathlib import Path

import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.scenario.create import materials, mirrors, model, pipeline, spec, trace
from gr_cast.scenario.create.geometry import Solid
from gr_cast.scenario.create.media import Medium

C_M_PER_S, CARRIER_HZ = 299_792_458.0, 2.4e9
WAVELENGTH_M = C_M_PER_S / CARRIER_HZ
PYTHON = sc.data_folder() / "raytracer/bin/python"


def traced(solids, tx_m, rx_m, depth, velocity=(0, 0, 0), **settings):
    task = trace.Task(
        name="x", pairs=((0, 1),), antennas=("iso", "iso"), orientation_rad=np.zeros((2, 3)),
        position_m=np.array([tx_m, rx_m], float),
        velocity_before=np.array([(0, 0, 0), velocity], float), velocity_after=np.array([(0, 0, 0), velocity], float),
    )  # fmt: skip
    return mirrors.run(solids, trace.Settings(carrier_hz=CARRIER_HZ, max_depth=depth, rays=1000, **settings), task)


def sheet(name, *corners, **numbers):
    return Solid(name=name, vertices_m=np.array(corners, float), faces=[[0, 1, 2], [0, 2, 3]], medium=Medium(**numbers))


GROUND = ((-200, -200, 0), (200, -200, 0), (200, 200, 0), (-200, 200, 0))


def test_two_rays_over_a_lossless_slab_follow_their_formulas():
    tx, rx, velocity = np.array([0, 0, 10.0]), np.array([60.0, 25.0, 1.5]), np.array([5.0, -3.0, 0.5])
    table = traced([sheet("ground", *GROUND, own_permittivity=4.0, thickness_m=0.3)], tx, rx, 1, velocity)
    order = np.argsort(table.delay_s)
    image = tx * [1, 1, -1]
    lengths_m = np.array([np.linalg.norm(rx - p) for p in (tx, image)])
    np.testing.assert_allclose(table.delay_s[order], lengths_m / C_M_PER_S, rtol=1e-12)
    rates = [(rx - p) @ velocity / length / C_M_PER_S for p, length in zip((tx, image), lengths_m, strict=True)]
    np.testing.assert_allclose(table.rate_after[order], rates, rtol=1e-9)
    cosine = 11.5 / lengths_m[1]
    root = np.sqrt(4 - (1 - cosine**2))
    tm, phase = (4 * cosine - root) / (4 * cosine + root), np.exp(-4j * np.pi * 0.3 / WAVELENGTH_M * root)
    expected = WAVELENGTH_M / (4 * np.pi * lengths_m) * [1, tm * (1 - phase) / (1 - tm**2 * phase)]
    np.testing.assert_allclose(table.gain[order], expected, rtol=1e-6)


def test_a_wall_blocks_and_with_refraction_lets_through():
    wall = sheet("wall", (-9, 0, -9), (9, 0, -9), (9, 0, 9), (-9, 0, 9), own_permittivity=1.0)
    ends = (0, -5, 0), (2, 7, 0)
    assert not len(traced([wall], *ends, 0).gain)
    (gain,) = traced([wall], *ends, 0, refraction=True).gain
    way_m = np.hypot(2, 12)
    leg_m = 0.1 * 12 / way_m  # a slab of air takes the phase of its thickness along the normal, and nothing else
    assert gain == pytest.approx(WAVELENGTH_M / (4 * np.pi * way_m) * np.exp(-2j * np.pi * leg_m / WAVELENGTH_M), rel=1e-9)


def test_mirror_images_are_the_paths_that_sionna_finds_in_the_arena():
    if not PYTHON.exists():
        pytest.skip(f"NO RAY TRACER at {PYTHON}: bash apps/install_raytracer.sh")
    arena = spec.read(sc.examples_folder() / "arena.yaml")
    solids = materials.assign(model.read(arena)[0], arena.materials, arena.carrier_hz)
    task = pipeline._task(arena, "x", [(a, b) for a in (0, 40) for b in range(30, 40)], 1.0)
    settings = trace.Settings(carrier_hz=arena.carrier_hz, max_depth=2, rays=100_000)
    code = (
        "import pickle, sys; sys.path[:0] = pickle.load(sys.stdin.buffer); from gr_cast.scenario.create import trace;"
        "table = trace.run(*pickle.load(sys.stdin.buffer)); sys.stdout.buffer.write(b'RESULT' + pickle.dumps(table))"
    )
    work = pickle.dumps([str(Path(trace.__file__).resolve().parents[3])]) + pickle.dumps((solids, settings, task))
    done = subprocess.run([str(PYTHON), "-W", "ignore", "-c", code], input=work, capture_output=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr.decode()
    theirs, ours = pickle.loads(done.stdout.partition(b"RESULT")[2]), mirrors.run(solids, settings, task)
    ways = {}
    for tx, rx, delay_s, gain in zip(ours.tx, ours.rx, ours.delay_s, ours.gain, strict=True):
        ways.setdefault((tx, rx), []).append((delay_s, gain))
    errors, missed = [], 0
    for tx, rx, delay_s, gain in zip(theirs.tx, theirs.rx, theirs.delay_s, theirs.gain, strict=True):
        same = [own for own_s, own in ways.get((tx, rx), []) if abs(own_s - delay_s) < 1e-13]
        missed += not same
        errors += [min(abs(own - gain) for own in same) / abs(gain)] if same else []
    assert len(errors) > 300 and missed <= 2 and np.percentile(errors, 98) < 1e-3
    assert len(ours.gain) - len(theirs.gain) < 0.05 * len(ours.gain)  # corners that its rays miss


def test_without_a_ray_tracer_a_place_becomes_a_scenario_all_the_same(tmp_path, monkeypatch):
    monkeypatch.setenv("CAST_CATALOGUE", str(tmp_path / "catalogue"))
    monkeypatch.setattr(trace, "is_installed", lambda: False)
    (tmp_path / "room.obj").write_text("o floor\nv 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 0\nf 1 2 3 4\n")
    text = """
cast_create: 1
id: hall
environment: {carrier_hz: 2.4e+9, bandwidth_hz: 20.0e+6}
model: {mesh: room.obj}
materials: {"*": metal}
nodes: {a: {position_m: [1, 1, 2]}, b: {waypoints_m: [[8, 8, 1], [8, 2, 1]], speed_m_per_s: 2}}
sampling: {duration_s: 2, step_s: 0.1, max_depth: 1, diffraction: true}
"""
    (tmp_path / "hall.yaml").write_text(text)
    told = []
    run = pipeline.Run(folder=tmp_path / "work", tell=told.append)
    record = pipeline.create(spec.read(tmp_path / "hall.yaml"), run)
    assert record["sampling"]["summary"]["by"] == "mirror images (no ray tracer is installed)"
    assert record["sampling"]["summary"]["left out"].startswith("diffraction: the ray tracer is not installed here")
    assert any("by mirror images" in line for line in told)
    assert record["parsing"]["summary"]["interpolation 90 % dB"] < -60
    made, content = sc.load("hall"), record["install"]["summary"]["sha256"]
    direct_m, image_m = np.linalg.norm([7, 7, -1]), np.linalg.norm([7, 7, 3])
    delay_s, gain = np.array([direct_m, image_m]) / C_M_PER_S, WAVELENGTH_M / (4 * np.pi * np.array([direct_m, image_m]))
    both = abs((gain * [1, 1] * np.exp(-2j * np.pi * CARRIER_HZ * delay_s)).sum())  # metal turns no vertical field over
    assert 10 ** (sc.band_power_db(made, ("a", "b"), 1e4)[0] / 20) == pytest.approx(both, rel=0.02)
    # The same again takes all up; with a ray tracer, sampling is done anew.
    again = pipeline.create(spec.read(tmp_path / "hall.yaml"), run)
    assert "sampling: done before, taken up" in told and again["install"]["summary"]["sha256"] == content
    monkeypatch.setattr(trace, "is_installed", lambda: True)
    monkeypatch.setattr(trace, "run", mirrors.run)
    record = pipeline.create(spec.read(tmp_path / "hall.yaml"), run)
    assert record["sampling"]["summary"]["by"] == "Sionna RT" and record["install"]["summary"]["sha256"] == content
