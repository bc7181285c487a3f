# SPDX-License-Identifier: GPL-3.0-or-later
"""A place case for tests: a room of a floor and a wall, three nodes, two campaigns."""

import numpy as np

MESH = """o floor
v 0 0 0
v 10 0 0
v 10 8 0
v 0 8 0
f 1 2 3
f 1 3 4
o wall
v 0 8 0
v 10 8 0
v 10 8 3
v 0 8 3
f 5 6 7
f 5 7 8
"""
SPEC = """cast_create: 1
id: room
environment: {carrier_hz: 5.0e+9, bandwidth_hz: 200.0e+6}
model: {mesh: mesh.obj}
materials: {floor: concrete, wall: {material: glass, thickness_m: 0.02}}
nodes:
  a: {position_m: [1, 1, 1]}
  b: {position_m: [9, 2, 2], antenna: tr38901, orientation_rad: [3.1, 0, 0]}
  c: {waypoints_m: [[2, 5, 1], [8, 5, 1]], speed_m_per_s: 1.0}
sampling: {duration_s: 4, step_s: 0.1, max_depth: 1}
"""
PLACE = """cast_place: 1
twin: spec.yaml
soundings:
  - {file: monday.npz, kind: response}
  - {file: flight.npz, kind: power, use: vault}
unknown: {phase: link, delay: node}
limits: {max_range_m: 500}
"""


def response(seed=1):
    rng = np.random.default_rng(seed)
    entries = (rng.standard_normal((2, 3, 8)) + 1j * rng.standard_normal((2, 3, 8))).astype(np.complex64)
    entries[0, 1, 2] = np.nan
    return dict(
        tx=np.array(["a", "b"]), rx=np.array(["b", "c"]), time_s=np.arange(3.0), frequency_hz=np.linspace(-1e8, 1e8, 8),
        response=entries, noise_power=np.array([1e-10, 2e-10]),
    )  # fmt: skip


def power():
    power_db = np.array([[-60.0, -61.0, np.nan, -62.0]])
    return dict(
        tx=np.array(["a"]), rx=np.array(["c"]), time_s=np.arange(4.0), power_db=power_db, std_db=np.array([1.0]),
        limits_db=np.array([-30.0, -110.0]), position_c=np.array([[2.0 + k, 5, 1] for k in range(4)]),
    )  # fmt: skip


def write(folder, *, place=PLACE, spec=SPEC, mesh=MESH, monday=None, flight=None):
    folder.mkdir(exist_ok=True)
    (folder / "place.yaml").write_text(place)
    (folder / "spec.yaml").write_text(spec)
    (folder / "mesh.obj").write_text(mesh)
    np.savez(folder / "monday.npz", **(response() if monday is None else monday))
    np.savez_compressed(folder / "flight.npz", **(power() if flight is None else flight))
    return folder
