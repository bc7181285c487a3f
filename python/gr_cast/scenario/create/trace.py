# SPDX-License-Identifier: GPL-3.0-or-later
"""Sampling: propagation paths between nodes by Sionna RT, on the CPU or a GPU.

The tracer computes in single precision. It finds which surfaces a path meets and how strong it is; where the path is
specular, delay and its rate are computed anew in double precision from the mirror images of the transmitter.
"""

import importlib.util
import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...core.errors import CastError
from ...core.files import passing_folder
from ...core.programs import installer
from ...core.units import SPEED_OF_LIGHT_M_PER_S
from . import legs, scene_file
from .geometry import Solid, assigned, planes

_LLVM = "*/libLLVM.so.19.1"  # under /usr/lib, in the folder of the machine's architecture
PROCESSES = 1  # the tracer has threads of its own
_TRANSMISSIONS = 6  # walls that a path may pass beside its reflections


def not_installed() -> str:
    return f"the ray tracer is not installed here: {installer()}"


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
    """Planes of all faces of all objects, in order: `start` of each object, `plane` number of each face, normal, point, corners
    (F, 3, 3), and rms height of its roughness."""

    start: np.ndarray
    plane: np.ndarray
    normal: np.ndarray
    point_m: np.ndarray
    corners_m: np.ndarray
    height_rms_m: np.ndarray


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
    rough_m = [solid.medium.height_rms_m if solid.medium else 0.0 for solid in solids]
    return Surfaces(
        start=start,
        plane=plane.reshape(-1),
        normal=normal,
        point_m=point_m,
        corners_m=np.concatenate([solid.vertices_m[solid.faces] for solid in solids]),
        height_rms_m=np.array(rough_m)[owner],
    )


def is_installed() -> bool:
    return importlib.util.find_spec("sionna") is not None


def left_out(settings: Settings) -> str:
    """Mechanisms that are asked for and not traced: none."""
    return ""


def _tracer():
    """The tracer's module, told where its compiler is."""
    for library in Path("/usr/lib").glob(_LLVM):
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(library))
    try:
        import sionna.rt
    except ImportError:
        raise CastError(not_installed()) from None
    return sionna.rt


_scenes: dict = {}  # one scene per process: building it costs seconds
_one_at_a_time = threading.Lock()  # a worker of a cluster may have threads; they share the scene


def _scene(rt, solids: Sequence[Solid], settings: Settings):
    if not settings.scattering:  # the tracer takes what is scattered from reflections, though it leaves the scattered out
        solids = [assigned(solid, replace(solid.medium, scattering_coefficient=0.0)) for solid in solids]
    key = hash(tuple((solid.name, solid.medium, solid.vertices_m.tobytes(), solid.faces.tobytes()) for solid in solids))
    key = (key, settings.carrier_hz)
    if key not in _scenes:
        _scenes.clear()
        with passing_folder() as folder:
            scene = rt.load_scene(str(scene_file.write(folder, solids, settings.carrier_hz)), merge_shapes=False)
        scene.frequency = settings.carrier_hz
        _scenes[key] = (scene, rt.PathSolver(deterministic=True))
    return _scenes[key]


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
    depth = settings.max_depth + _TRANSMISSIONS * settings.refraction + settings.diffraction + settings.scattering
    paths = solver(
        scene,
        max_depth=depth,
        samples_per_src=settings.rays,
        refraction=settings.refraction,
        diffraction=settings.diffraction,
        edge_diffraction=settings.diffraction,
        diffuse_reflection=settings.scattering,
        synthetic_array=True,
    )
    real, imaginary = (part.numpy()[:, 0, :, 0, :] for part in paths.a)
    valid = paths.valid.numpy().astype(bool) & (np.hypot(real, imaginary) > 0)
    wanted = np.zeros(valid.shape[:2], bool)
    for a, b in pairs:
        wanted[sides[1].index(b), sides[0].index(a)] = True
    chosen = np.nonzero(valid & wanted[:, :, None] & _allowed(paths.interactions.numpy(), settings))
    gain = (real + 1j * imaginary)[chosen].astype(np.complex128)
    tx, rx = np.array(sides[0], np.int32)[chosen[1]], np.array(sides[1], np.int32)[chosen[0]]
    return _told(task, settings, planes_of, tx, rx, gain, *_met(scene, paths, planes_of, chosen, max(depth, 1)))


def _allowed(kinds: np.ndarray, settings: Settings) -> np.ndarray:
    """Which paths count, of interactions (depth, …): transmissions are free, and a path has one edge or patch at most."""
    reflections, edges, patches = ((kinds == kind).sum(axis=0) for kind in (legs.SPECULAR, legs.DIFFRACTION, legs.DIFFUSE))
    return (reflections <= settings.max_depth) & (edges + patches <= 1)


def _met(scene, paths, planes_of: Surfaces, chosen: tuple, depth: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Kinds of interaction (n, depth), faces (−1: none), and places in m (n, depth, 3) of the chosen paths."""
    count = len(chosen[0])
    kinds, faces, met_m = np.zeros((count, depth), np.int64), np.full((count, depth), -1), np.zeros((count, depth, 3))
    row, column, path = chosen
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
        met_m[:, : found.shape[1]] = paths.vertices.numpy()[:, row, column, path].transpose(1, 0, 2)
    return kinds, faces, met_m


def _told(task: Task, settings: Settings, planes_of: Surfaces, tx, rx, gain, kinds, faces, met_m) -> tuple:
    """Columns of a table: what mirror images say of the delays, and for paths with an edge or a patch their corners."""
    points_m = legs.points(task.position_m[tx], met_m, kinds, task.position_m[rx])
    delay_s, rates = image_delays(planes_of, kinds == legs.SPECULAR, faces, task, tx, rx)
    cornered = np.isin(kinds, (legs.DIFFRACTION, legs.DIFFUSE)).any(axis=1)
    ends = (task.velocity_before, task.velocity_after)
    corner_s, corner_rates = legs.delays(
        points_m, (kinds != 0).sum(axis=1), [speed[tx] for speed in ends], [speed[rx] for speed in ends]
    )
    delay_s = np.where(cornered, corner_s, delay_s)
    rates = [np.where(cornered, corner, image) for corner, image in zip(corner_rates, rates, strict=True)]
    rough = legs.rough_loss(
        points_m, planes_of.normal[faces], planes_of.height_rms_m[faces], kinds, SPEED_OF_LIGHT_M_PER_S / settings.carrier_hz
    )
    names = np.where(faces >= 0, 4 * planes_of.plane[faces] + (kinds == legs.REFRACTION) + 3 * (kinds == legs.DIFFUSE), -1)
    edge = kinds == legs.DIFFRACTION
    names[edge] = -2 - 3 * faces[edge] - legs.nearest_edge(met_m[edge], planes_of.corners_m[faces[edge]])
    if settings.scattering:
        number = legs.patch_numbers(np.column_stack([tx, rx, names]), kinds, met_m)
        names = np.column_stack([names, number])
        gain = gain * legs.patch_phase(number)
    return tx, rx, names.astype(np.int32), delay_s, *rates, gain * rough


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
