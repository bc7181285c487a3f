# SPDX-License-Identifier: GPL-3.0-or-later
"""Radios of a place: where they are at any time, and what they send and receive with."""

from dataclasses import dataclass

import numpy as np

from ...core.errors import CastError, Faults
from .geometry import Solid, inside, is_closed

ANTENNAS = ("iso", "dipole", "hw_dipole", "tr38901")
MIN_DISTANCE_M = 0.01
COHERENCE_DISTANCE_M = 15.0  # beyond which large-scale parameters change (3GPP TR 38.901, indoor and micro cells)


@dataclass(frozen=True, kw_only=True)
class Node:
    """One radio: way-points (W, 3) in m walked at `speed_m_per_s` from `start_s` on (0 and one point for a static one), and its
    equipment.

    An antenna looks along +x, turned by `orientation_rad`: yaw about z, then pitch about y, then roll about x."""

    name: str
    waypoints_m: np.ndarray
    speed_m_per_s: float = 0.0
    antenna: str = "iso"
    power_dbm: float = 0.0
    noise_figure_db: float = 0.0
    orientation_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    start_s: float = 0.0

    def __post_init__(self):
        points = np.array(self.waypoints_m, np.float64, ndmin=2)
        object.__setattr__(self, "waypoints_m", points)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise CastError(f"node {self.name}: position: needs finite x, y, z in m")
        if len(points) > 1 and not (np.linalg.norm(np.diff(points, axis=0), axis=1) > 0).all():
            raise CastError(f"node {self.name}: waypoints_m: two way-points in a row are the same")
        if (len(points) > 1) != (self.speed_m_per_s > 0) or not np.isfinite(self.speed_m_per_s):
            raise CastError(
                f"node {self.name}: speed_m_per_s: got {self.speed_m_per_s}, a moving node needs way-points and speed"
            )
        if self.antenna not in ANTENNAS:
            raise CastError(f"node {self.name}: antenna: got {self.antenna!r}, needs one of {', '.join(ANTENNAS)}")

    @property
    def is_moving(self) -> bool:
        return len(self.waypoints_m) > 1


def corner_times_s(node: Node) -> np.ndarray:
    """When a node reaches each of its way-points, (W,)."""
    if not node.is_moving:
        return np.zeros(1)
    legs_m = np.linalg.norm(np.diff(node.waypoints_m, axis=0), axis=1)
    return node.start_s + np.concatenate([[0.0], np.cumsum(legs_m)]) / node.speed_m_per_s


def position_m(node: Node, time_s: np.ndarray) -> np.ndarray:
    """Where a node is, (T, 3): on its way at constant speed, then at the last way-point."""
    clock = corner_times_s(node)
    return np.stack([np.interp(time_s, clock, node.waypoints_m[:, axis]) for axis in range(3)], axis=1)


def velocity_m_per_s(node: Node, time_s: np.ndarray, side: str) -> np.ndarray:
    """Velocity just after ("right") or just before ("left") each instant, (T, 3)."""
    time_s = np.atleast_1d(time_s)
    if not node.is_moving:
        return np.zeros((len(time_s), 3))
    clock = corner_times_s(node)
    # At a corner both sides differ; rounding must not decide which one is meant.
    hair_s = 1e-9 if side == "right" else -1e-9
    leg = np.searchsorted(clock, time_s + hair_s, side="right") - 1
    steps = np.diff(node.waypoints_m, axis=0)
    velocity = node.speed_m_per_s * steps / np.linalg.norm(steps, axis=1, keepdims=True)
    moving = (leg >= 0) & (leg < len(steps))
    return np.where(moving[:, None], velocity[np.clip(leg, 0, len(steps) - 1)], 0.0)


def sampling_times_s(nodes: list[Node], duration_s: float, step_s: float) -> np.ndarray:
    """Instants to trace: every step, the end, and whenever a node turns a corner. One instant where nothing moves."""
    if not any(node.is_moving for node in nodes):
        return np.zeros(1)
    regular = np.arange(0.0, duration_s + 1e-9, step_s)
    corners = [corner_times_s(node) for node in nodes if node.is_moving]
    times = np.round(np.concatenate([regular, [duration_s], *corners]), 9)
    return np.unique(times[(times >= 0) & (times <= duration_s + 1e-9)])


def check(nodes: list[Node], solids: list[Solid], time_s: np.ndarray, step_s: float) -> list[str]:
    """Names of the closed objects that hold every node all the time: rooms, drawn as one object.

    Raises CastError with every node inside another closed object, pair that meets, and step beyond the coherence distance.
    """
    faults, rooms = Faults("nodes"), []
    tracks = {node.name: position_m(node, time_s) for node in nodes}
    ways = {node.name: tracks[node.name] if node.is_moving else tracks[node.name][:1] for node in nodes}
    for solid in filter(is_closed, solids):
        inside = {name: _instants_inside(solid, way) for name, way in ways.items()}
        if all(len(inside[name]) == len(way) for name, way in ways.items()):
            rooms.append(solid.name)
            continue
        for name, instants in inside.items():
            if len(instants):
                where_m = np.round(ways[name][instants[0]], 3).tolist()
                faults.add(name, f"is inside {solid.name} at {time_s[instants[0]]:g} s, {where_m} m")
    for node in nodes:
        if node.speed_m_per_s * step_s > COHERENCE_DISTANCE_M:
            step_m = node.speed_m_per_s * step_s
            faults.add(node.name, f"moves {step_m:g} m between samples, limit {COHERENCE_DISTANCE_M:g} m of spatial coherence")
    for index, a in enumerate(nodes):
        for b in nodes[index + 1 :]:
            distance_m = np.linalg.norm(tracks[a.name] - tracks[b.name], axis=1)
            if distance_m.min() < MIN_DISTANCE_M:
                nearest = np.argmin(distance_m)
                faults.add(
                    f"{a.name} and {b.name}",
                    f"are {distance_m.min():.3g} m apart at {time_s[nearest]:g} s, "
                    f"{np.round(tracks[a.name][nearest], 3).tolist()} m, limit {MIN_DISTANCE_M:g} m",
                )
    faults.raise_if_any()
    return rooms


def _instants_inside(solid: Solid, way_m: np.ndarray) -> list[int]:
    low, high = solid.vertices_m.min(axis=0), solid.vertices_m.max(axis=0)
    near = np.flatnonzero(((way_m >= low) & (way_m <= high)).all(axis=1))
    return near[inside(solid, way_m[near])].tolist()
