# SPDX-License-Identifier: GPL-3.0-or-later
"""Where causes are drawn: what an effect tells of itself says how, not its name."""

from dataclasses import dataclass, field

import numpy as np

_LEVEL = 0.7  # of a normal's height: above, a plane lies


@dataclass(frozen=True, kw_only=True)
class Mark:
    """One cause in the place. `at_m` anchors its number; only what it has is drawn."""

    number: int
    title: str
    at_m: np.ndarray | None = None
    plane_m: np.ndarray | None = None  # corners (4, 3)
    band_m: np.ndarray | None = None  # two deviations of the plane, along its normal (3,)
    arrow_m: np.ndarray | None = None
    arrow_std_m: np.ndarray | None = None
    track_m: np.ndarray | None = None  # (2, 3), from the beginning to the end of what was sounded
    track_std_m: np.ndarray | None = None
    turn_rad: tuple | None = None  # yaw in the twin, yaw in the world
    objects: tuple = ()
    nodes: tuple = ()
    links: tuple = ()
    perhaps: tuple = field(default=())  # owners that it could as well be

    @property
    def has_place(self) -> bool:
        return self.at_m is not None


def marks_of(scene) -> list[Mark]:
    return [_mark(scene, number, entry) for number, entry in enumerate(scene.diagnosis.document["effects"], 1)]


def _mark(scene, number: int, entry: dict) -> Mark:
    told = {key: one for key, one in entry["parameters"].items() if isinstance(one, dict)}
    owner, drawn = entry["owner"], _of_owner(scene, entry["owner"])
    if "height_m" in told or {"point_m", "normal"} <= told.keys():
        drawn |= _plane(scene, entry, told)
    elif "velocity_m_per_s" in told:
        start, speed = (np.array(told[key]["value"]) for key in ("position_m", "velocity_m_per_s"))
        track = np.array([start, start + speed * scene.duration_s])
        drawn |= {"at_m": start, "track_m": track, "track_std_m": _std(told["position_m"])}
    elif "offset_m" in told:
        drawn |= {"arrow_m": np.array(told["offset_m"]["value"]), "arrow_std_m": _std(told["offset_m"])}
    if "yaw_rad" in told:
        yaw = scene.base.radios[owner["name"]].node.orientation_rad[0]
        drawn |= {"turn_rad": (yaw, yaw + told["yaw_rad"]["value"])}
    perhaps = tuple(one if isinstance(one, str) else one["name"] for one in owner.get("alternatives", ()))
    return Mark(number=number, title=entry["sentence"], perhaps=perhaps, **drawn)


def _std(parameter: dict) -> np.ndarray:
    return np.array(parameter.get("std", np.zeros(3)), float)


def _of_owner(scene, owner: dict) -> dict:
    name, mesh = owner["name"], scene.base.mesh
    if owner["level"] == "node" and name in scene.base.radios:
        return {"nodes": (name,)} | ({"at_m": scene.tracks_m[name][0]} if name in scene.tracks_m else {})
    if owner["level"] == "link":
        ends = [line.ends_m[0] for line in scene.lines if line.name == name]
        return {"links": (name,)} | ({"at_m": ends[len(ends) // 2].mean(axis=0)} if ends else {})
    made = scene.base.media
    names = tuple(one for one in mesh.names if one == name or (owner["level"] == "material" and made[one].material == name))
    if not names:
        return {}
    corners = mesh.solids[mesh.index(names[0])].vertices_m
    return {"at_m": np.clip(corners.mean(axis=0), scene.low_m, scene.high_m), "objects": names}


def _plane(scene, entry: dict, told: dict) -> dict:
    low, high = scene.low_m, scene.high_m
    if "height_m" in told:
        normal, std = np.array([0.0, 0, 1]), told["height_m"].get("std", 0.0)
        point = np.array([*(low + high)[:2] / 2, told["height_m"]["value"]])
        box = np.array([[*low[:2], point[2]], [*high[:2], point[2]]])
    else:
        point, normal = (np.array(told[key]["value"]) for key in ("point_m", "normal"))
        std = float(np.linalg.norm(_std(told["point_m"])))
        box = np.array(entry["where"].get("extent_m") or entry["where"].get("position_m") or [point - 0.5, point + 0.5])
    u = np.array([1.0, 0, 0]) if abs(normal[2]) > _LEVEL else np.array([-normal[1], normal[0], 0]) / np.hypot(*normal[:2])
    v = np.cross(normal, u)
    (u0, u1), (v0, v1) = (_reach(point, axis, box) for axis in (u, v))
    corners = np.array([point + a * u + b * v for a, b in ((u0, v0), (u1, v0), (u1, v1), (u0, v1))])
    return {"at_m": point, "plane_m": corners, "band_m": 2 * std * normal}


def _reach(point: np.ndarray, axis: np.ndarray, box: np.ndarray) -> tuple[float, float]:
    """How far a line through a point goes within a box, along the axis that it follows most."""
    most = int(np.argmax(np.abs(axis)))
    return tuple(sorted((box[:, most] - point[most]) / axis[most]))
