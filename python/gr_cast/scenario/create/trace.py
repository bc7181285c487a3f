# SPDX-License-Identifier: GPL-3.0-or-later
"""Sampling: propagation paths between nodes by Sionna RT, on the CPU or a GPU.

The tracer computes in single precision. It finds which surfaces a path meets and how strong it is; where the path is
specular, delay and its rate are computed anew in double precision from the mirror images of the transmitter.
"""

import os
import tempfile
import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.errors import CastError
from ...core.files import write_text, written_aside
from ...core.units import SPEED_OF_LIGHT_M_PER_S
from .geometry import Solid, planes
from .media import Medium

_LLVM = "*/libLLVM.so.19.1"  # under /usr/lib, in the folder of the machine's architecture
INSTALL = "the ray tracer is not installed here: bash apps/install_raytracer.sh"
_SPECULAR, _REFRACTION = 1, 4  # of the tracer's interaction types; 0 is none


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How to trace: carrier, most interactions of a path, rays to find candidates with, and which mechanisms there are
    beside reflection: whether walls let through, edges diffract, and rough walls scatter."""

    carrier_hz: float
    max_depth: int
    rays: int
    refraction: bool = False
    diffraction: bool = False
    scattering: bool = False


@dataclass(frozen=True, kw_only=True)
class Task:
    """Node pairs to trace at one instant: positions (N, 3) and velocities (N, 3) just before and after it, in m and m/s, and
    where each antenna looks, (N, 3): yaw, pitch, roll."""

    name: str
    pairs: tuple[tuple[int, int], ...]
    antennas: tuple[str, ...]
    orientation_rad: np.ndarray
    position_m: np.ndarray
    velocity_before: np.ndarray
    velocity_after: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Traced:
    """Paths of many pairs in one table: node indices `tx` and `rx` (n,), `surfaces` (n, depth) that name a path (-1: none),
    `delay_s`, its rate just before and after in s/s, and `gain`, without the phase of the delay."""

    tx: np.ndarray
    rx: np.ndarray
    surfaces: np.ndarray
    delay_s: np.ndarray
    rate_before: np.ndarray
    rate_after: np.ndarray
    gain: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Surfaces:
    """Planes of all faces of all objects, in order: `start` of each object, `plane` number of each face, normal, point."""

    start: np.ndarray
    plane: np.ndarray
    normal: np.ndarray
    point_m: np.ndarray


def surfaces(solids: Sequence[Solid]) -> Surfaces:
    """Number the planes of all objects; faces of one object in one plane share its number."""
    start = np.cumsum([0] + [len(solid.faces) for solid in solids])
    parts = [planes(solid) for solid in solids]
    normal, point_m = (np.concatenate([part[index] for part in parts]) for index in range(2))
    first = np.argmax(np.abs(normal) > 1e-9, axis=1)  # one sign for both sides of a plane
    upright = normal * np.sign(normal[np.arange(len(normal)), first])[:, None]
    owner = np.repeat(np.arange(len(solids)), np.diff(start))
    # The tenth of a millimetre tells parallel planes apart; coordinates are whole multiples of far less.
    offset_m = np.einsum("ij,ij->i", upright, point_m)
    _, plane = np.unique(np.column_stack([owner, np.round(upright, 6), np.round(offset_m, 4)]), axis=0, return_inverse=True)
    return Surfaces(start=start, plane=plane.reshape(-1), normal=normal, point_m=point_m)


def is_installed() -> bool:
    try:
        _tracer()
    except CastError:
        return False
    return True


def _tracer():
    """The tracer's module, told where its compiler is."""
    for library in Path("/usr/lib").glob(_LLVM):
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(library))
    try:
        import sionna.rt
    except ImportError:
        raise CastError(INSTALL) from None
    return sionna.rt


_scenes: dict = {}  # one scene per process: building it costs seconds
_one_at_a_time = threading.Lock()  # a worker of a cluster may have threads; they share the scene


def _scene(rt, solids: Sequence[Solid], settings: Settings):
    key = hash(tuple((solid.name, solid.medium, solid.vertices_m.tobytes(), solid.faces.tobytes()) for solid in solids))
    key = (key, settings.carrier_hz)
    if key not in _scenes:
        _scenes.clear()
        with tempfile.TemporaryDirectory() as folder:
            scene = rt.load_scene(str(write_scene(Path(folder), solids, settings.carrier_hz)), merge_shapes=False)
        scene.frequency = settings.carrier_hz
        _scenes[key] = (scene, rt.PathSolver(deterministic=True))
    return _scenes[key]


def write_scene(folder: Path, solids: Sequence[Solid], carrier_hz: float) -> Path:
    """The objects as a Mitsuba scene with radio materials, `scene.xml` and a PLY file each."""
    lines = ['<scene version="2.1.0">']
    names = _names({solid.medium: None for solid in solids})
    lines += [_bsdf(medium, name, carrier_hz) for medium, name in names.items()]
    for index, solid in enumerate(solids):
        _write_ply(folder / f"{index}.ply", solid)
        lines.append(
            f'<shape type="ply" id="mesh-{index}"><string name="filename" value="{index}.ply"/>'
            f'<boolean name="face_normals" value="true"/><ref id="mat-{names[solid.medium]}" name="bsdf"/></shape>'
        )
    path = folder / "scene.xml"
    write_text(path, "\n".join([*lines, "</scene>"]))
    return path


def _names(media: Iterable[Medium]) -> dict[Medium, str]:
    """A name for each medium: its material's, with a number from the second one on."""
    names: dict[Medium, str] = {}
    for medium in media:
        name = medium.material or "own"
        taken = sum(other.split(".")[0] == name for other in names.values())
        names[medium] = f"{name}.{taken + 1}" if taken else name
    return names


def _bsdf(medium: Medium, name: str, carrier_hz: float) -> str:
    numbers = {"thickness": medium.thickness_m, "scattering_coefficient": medium.scattering_coefficient}
    if (medium.own_permittivity, medium.own_conductivity_s_per_m) == (None, None):
        kind, what = "itu-radio-material", f'<string name="type" value="{medium.material}"/>'
    else:
        kind, what = "radio-material", ""
        numbers["relative_permittivity"], numbers["conductivity"] = (
            medium.permittivity(carrier_hz),
            medium.conductivity(carrier_hz),
        )
    numbers = "".join(f'<float name="{key}" value="{value}"/>' for key, value in numbers.items())
    return f'<bsdf type="{kind}" id="mat-{name}">{what}{numbers}</bsdf>'


def _write_ply(path: Path, solid: Solid) -> None:
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(solid.vertices_m)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(solid.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(solid.faces), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    faces["n"], faces["v"] = 3, solid.faces
    with written_aside(path) as aside:
        aside.write_bytes(head.encode() + solid.vertices_m.astype("<f8").tobytes() + faces.tobytes())


def run(solids: Sequence[Solid], settings: Settings, task: Task) -> Traced:
    """Trace one task's pairs. The same task gives the same table, wherever it runs."""
    rt = _tracer()
    planes_of = surfaces(solids)
    parts = []
    patterns = {(task.antennas[a], task.antennas[b]) for a, b in task.pairs}
    with _one_at_a_time:
        scene, solver = _scene(rt, solids, settings)
        for tx_pattern, rx_pattern in sorted(patterns):
            pairs = [(a, b) for a, b in task.pairs if (task.antennas[a], task.antennas[b]) == (tx_pattern, rx_pattern)]
            parts.append(_solve(rt, scene, solver, settings, task, planes_of, pairs, (tx_pattern, rx_pattern)))
    joined = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    table = dict(zip(("tx", "rx", "surfaces", "delay_s", "rate_before", "rate_after", "gain"), joined, strict=True))
    # Which order the tracer finds paths in is no part of the result.
    order = np.lexsort((*table["surfaces"].T[::-1], table["rx"], table["tx"]))
    return Traced(**{name: values[order] for name, values in table.items()})


def _solve(rt, scene, solver, settings, task, planes_of, pairs, patterns):
    for name in [*scene.transmitters, *scene.receivers]:
        scene.remove(name)
    sides = [sorted({pair[side] for pair in pairs}) for side in (0, 1)]
    for kind, members, pattern, letter in (
        (rt.Transmitter, sides[0], patterns[0], "t"),
        (rt.Receiver, sides[1], patterns[1], "r"),
    ):
        array = rt.PlanarArray(num_rows=1, num_cols=1, pattern=pattern, polarization="V")
        setattr(scene, "tx_array" if letter == "t" else "rx_array", array)
        for node in members:
            place = dict(position=task.position_m[node].tolist(), orientation=task.orientation_rad[node].tolist())
            scene.add(kind(name=f"{letter}{node}", **place))
    paths = solver(
        scene,
        max_depth=settings.max_depth,
        samples_per_src=settings.rays,
        refraction=settings.refraction,
        synthetic_array=True,
    )
    real, imaginary = (part.numpy()[:, 0, :, 0, :] for part in paths.a)
    valid = paths.valid.numpy().astype(bool) & (np.hypot(real, imaginary) > 0)
    wanted = np.zeros(valid.shape[:2], bool)
    for a, b in pairs:
        wanted[sides[1].index(b), sides[0].index(a)] = True
    row, column, path = np.nonzero(valid & wanted[:, :, None])
    gain = (real + 1j * imaginary)[row, column, path].astype(np.complex128)
    tx, rx = np.array(sides[0], np.int32)[column], np.array(sides[1], np.int32)[row]
    depth = max(settings.max_depth, 1)
    kinds, faces = np.zeros((len(path), depth), np.int64), np.full((len(path), depth), -1)
    found = paths.interactions.numpy()[:, row, column, path].T.astype(np.int64)
    if found.size:
        kinds[:, : found.shape[1]] = found
        object_of = np.zeros(2 + max(o.object_id for o in scene.objects.values()), np.int64)
        for name, item in scene.objects.items():
            object_of[item.object_id] = int(name.removeprefix("mesh-"))
        owner = paths.objects.numpy()[:, row, column, path].T.astype(np.int64)
        primitive = paths.primitives.numpy()[:, row, column, path].T.astype(np.int64)
        met = found != 0
        faces[:, : found.shape[1]][met] = planes_of.start[object_of[owner[met]]] + primitive[met]
    if not np.isin(kinds, (0, _SPECULAR, _REFRACTION)).all():
        raise CastError("trace: a path with another interaction than reflection and refraction")
    delay_s, rates = image_delays(planes_of, kinds == _SPECULAR, faces, task, tx, rx)
    names = np.where(faces >= 0, 2 * planes_of.plane[faces] + (kinds == _REFRACTION), -1)
    return tx, rx, names.astype(np.int32), delay_s, *rates, gain


def image_delays(planes_of: Surfaces, reflects: np.ndarray, faces: np.ndarray, task: Task, tx: np.ndarray, rx: np.ndarray):
    """Delays (n,) and their rates just before and after, from the images of the transmitters in double precision.

    A reflection mirrors the transmitter; a thin wall that is passed leaves the ray straight. The length's rate is the
    speed at which image and receiver part, and the Doppler is -f_c times the delay's rate.
    """
    image_m = task.position_m[tx].copy()
    speeds = [task.velocity_before[tx].copy(), task.velocity_after[tx].copy()]
    for bounce in range(reflects.shape[1]):
        here = reflects[:, bounce]
        normal, point_m = planes_of.normal[faces[here, bounce]], planes_of.point_m[faces[here, bounce]]
        image_m[here] -= 2 * np.einsum("ij,ij->i", image_m[here] - point_m, normal)[:, None] * normal
        for speed in speeds:
            speed[here] -= 2 * np.einsum("ij,ij->i", speed[here], normal)[:, None] * normal
    way_m = task.position_m[rx] - image_m
    length_m = np.linalg.norm(way_m, axis=1)
    along = way_m / length_m[:, None]
    own = (task.velocity_before[rx], task.velocity_after[rx])
    rates = [np.einsum("ij,ij->i", o - s, along) / SPEED_OF_LIGHT_M_PER_S for o, s in zip(own, speeds, strict=True)]
    return length_m / SPEED_OF_LIGHT_M_PER_S, rates
