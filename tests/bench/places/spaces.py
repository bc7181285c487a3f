# SPDX-License-Identifier: GPL-3.0-or-later
"""Rooms, corridors, streets and yards of boxes and sheets, and the radios in them."""

import numpy as np
from mirror import crossings, patches
from slabs import TABLE, medium
from world import new_world

WORDS = ("slab", "unit", "part", "block", "panel", "body", "item", "piece")
INDOORS = ("concrete", "brick", "plasterboard", "wood", "glass", "ceiling_board", "chipboard", "plywood", "marble", "metal")
OUTDOORS = ("concrete", "brick", "glass", "metal", "marble", "wood", "metal", "concrete")
GROUNDS = ("very_dry_ground", "medium_dry_ground", "wet_ground", "concrete")
KINDS = ("room", "corridor", "street", "yard")
CARRIERS_HZ = (1e9, 2.4e9, 3.5e9, 5.5e9, 7e9, 10e9, 15e9, 28e9)
ANTENNAS = ("iso", "iso", "dipole", "hw_dipole", "tr38901")


def sheet(corner, u, v):
    a, b, c, d = corner, corner + u, corner + u + v, corner + v
    return np.round(np.array([[a, b, c], [a, c, d]]), 6)


def box(x, y, length, width, low, high, yaw):
    """Twelve triangles of an upright box about (x, y)."""
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    plan = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [length / 2, width / 2] @ turn.T + [x, y]
    p = np.round(np.vstack([np.c_[plan, np.full(4, low)], np.c_[plan, np.full(4, high)]]), 6)
    rings = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    return np.array([t for a, b, c, d in rings for t in (p[[a, b, c]], p[[a, c, d]])])


def _upright(rng, x, y, width, low, high, yaw):
    along = np.array([np.cos(yaw), np.sin(yaw), 0.0]) * width
    return sheet(np.array([x, y, low]) - along / 2, along, np.array([0, 0, high - low]))


def _inside(rng, kind):
    """Shell of six sheets, furniture, partitions: [(triangles, is_shell)], and the free box."""
    size = rng.uniform((5, 4, 2.4), (12, 9, 4)) if kind == "room" else rng.uniform((14, 2, 2.3), (28, 3.6, 3.2))
    lx, ly, lz = size
    x, y, z = np.eye(3) * size
    o = np.zeros(3)
    things = [sheet(o, x, y), sheet(z, x, y), sheet(o, x, z), sheet(y, x, z), sheet(o, y, z), sheet(x, y, z)]
    if rng.random() < 0.25:
        things.pop(int(rng.integers(1, 6)))
    for _ in range(int(rng.integers(1, 7))):
        a, b, h = rng.uniform(0.3, min(1.8, ly / 3)), rng.uniform(0.3, min(1.0, ly / 4)), rng.uniform(0.5, min(2.1, lz - 0.2))
        yaw = rng.choice([0.0, rng.uniform(0, np.pi)])
        low = -0.05 if rng.random() < 0.8 else rng.uniform(0.3, 0.6)
        things.append(box(rng.uniform(1, lx - 1), rng.uniform(0.7, ly - 0.7), a, b, low, max(h, low + 0.2), yaw))
    for _ in range(int(rng.integers(0, 3))):
        yaw = rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)])
        width = rng.uniform(0.8, min(3.0, ly / 2))
        things.append(
            _upright(rng, rng.uniform(1.5, lx - 1.5), rng.uniform(0.8, ly - 0.8), width, 0.05, rng.uniform(0.6, 0.95) * lz, yaw)
        )
    return things, np.array([[0.35, 0.35, 0.8], [lx - 0.35, ly - 0.35, lz - 0.3]])


def _outside(rng, kind, floor):
    lx, ly = rng.uniform(35, 60), rng.uniform(20, 30)
    things = [sheet(np.array([-10.0, -10, 0]), np.array([lx + 20, 0, 0]), np.array([0, ly + 20, 0]))] if floor else []
    if kind == "street":
        for y0, y1 in ((-7.0, rng.uniform(2, 4)), (ly - rng.uniform(2, 4), ly + 7.0)):
            x = rng.uniform(-5, 2)
            while x < lx - 5 and len(things) < 12:
                width = rng.uniform(8, 18)
                things.append(box(x + width / 2, (y0 + y1) / 2, width, y1 - y0, -0.5, rng.uniform(6, 18), 0.0))
                x += width + rng.uniform(1.5, 8)
        low_y, high_y = 5.0, ly - 5.0
    else:
        low_y, high_y = 2.0, ly - 2.0
        for _ in range(int(rng.integers(2, 5))):
            a, b = rng.uniform(4, 12, 2)
            things.append(
                box(rng.uniform(0, lx), rng.choice([-3.0, ly + 3.0]), a, b, -0.5, rng.uniform(4, 12), rng.uniform(-0.3, 0.3))
            )
    for _ in range(int(rng.integers(2, 6))):
        yaw = rng.uniform(0, np.pi)
        a, b, h = rng.uniform(2, 5), rng.uniform(1.5, 2.2), rng.uniform(1.3, 3.2)
        things.append(box(rng.uniform(3, lx - 3), rng.uniform(low_y, high_y), a, b, -0.05, h, yaw))
    for _ in range(int(rng.integers(1, 4))):
        yaw = rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)])
        things.append(
            _upright(rng, rng.uniform(3, lx - 3), rng.uniform(low_y, high_y), rng.uniform(3, 10), 0.05, rng.uniform(2, 6), yaw)
        )
    return things, np.array([[2.0, low_y - 0.5, 1.0], [lx - 2.0, high_y + 0.5, 5.5]])


def _names(rng, count):
    numbers = rng.permutation(90)[:count]
    return [f"{WORDS[rng.integers(len(WORDS))]}_{k:02d}" for k in numbers]


def draw(rng, kind=None, floor=True):
    """(world with objects and band, but no nodes; free box (2, 3); kind)."""
    kind = kind or str(rng.choice(KINDS))
    w = new_world()
    w["carrier_hz"] = float(rng.choice(CARRIERS_HZ))
    w["bandwidth_hz"] = float(np.round(np.exp(rng.uniform(np.log(27e6), np.log(400e6))) / 1e6) * 1e6)
    things, free = _inside(rng, kind) if kind in ("room", "corridor") else _outside(rng, kind, floor)
    level = [len(np.unique(t[..., 2])) == 1 for t in things]
    names = _names(rng, len(things))
    own = rng.random() < 0.2  # materials with numbers of their own
    for index in rng.permutation(len(things)):
        name = names[index]
        pool = INDOORS if kind in ("room", "corridor") else GROUNDS if level[index] else OUTDOORS
        pool = [m for m in pool if TABLE[m][4] <= w["carrier_hz"] / 1e9 <= TABLE[m][5]]
        w["objects"][name] = {"tris": things[index], "surface": None}
        w["materials"][name] = str(rng.choice(pool))
        if own and rng.random() < 0.3 and w["materials"][name] != "metal":
            permittivity, conductivity = medium(w["materials"][name], w["carrier_hz"])
            numbers = np.array([max(permittivity * rng.uniform(0.8, 1.3), 1), conductivity * rng.uniform(0.5, 2)])
            w["media"][name] = dict(zip(("permittivity", "conductivity"), numbers.round(6).tolist(), strict=True))
    w["max_depth"] = int(rng.choice([0, 1, 1, 2, 2], p=[0.05, 0.25, 0.25, 0.2, 0.25]))
    return w, free, kind


def faces_of(w):
    return patches({n: o["tris"] for n, o in w["objects"].items()})


def is_free(faces, centre, point, gap_m):
    """Whether a point is away from every patch and in no closed box: seen from outside, boxes are crossed evenly."""
    around = point + gap_m * np.vstack([np.eye(3), -np.eye(3)])
    if np.isfinite(crossings(faces, np.repeat(point[None], 6, 0), around)).any():
        return False
    away = point + np.array([[997.0, 31.7, 411.3]])
    hit = np.isfinite(crossings(faces, point[None], away))[0] & faces.closed
    return not any(np.sum(hit[faces.owner == o]) % 2 for o in set(faces.owner[hit].tolist()))


def point(rng, faces, free, gap_m=0.25):
    for _ in range(200):
        p = np.round(rng.uniform(*free), 3)
        if is_free(faces, None, p, gap_m):
            return p
    raise ValueError("no free point")


def walk(rng, faces, free, duration_s, fast):
    """(way-points, speed): a way through free space at one height that is longer than the campaign."""
    speed = round(float(rng.uniform(0.6, 4.0 if fast else 1.4)), 3)
    way = [point(rng, faces, free)]
    length = 0.0
    for _ in range(400):
        to = point(rng, faces, free)
        to[2] = way[0][2]
        side = np.array([[0, 0, 0], [0.15, 0, 0], [-0.15, 0, 0], [0, 0.15, 0], [0, -0.15, 0]])
        if np.linalg.norm(to - way[-1]) < 1 or np.isfinite(crossings(faces, way[-1] + side, to + side)).any():
            continue
        length += np.linalg.norm(to - way[-1])
        way.append(to)
        if length > 1.15 * speed * duration_s:
            return [p.tolist() for p in way], speed
    raise ValueError("no free way")


def radios(rng, w, free, count, moving, duration_s, kind):
    """{name: node}: the first `moving` ones walk; directive antennas look into the place."""
    faces, middle = faces_of(w), free.mean(0)
    letters = rng.choice(list("abdkmnpqstvz"), count)
    names = [f"{a}{k}" for a, k in zip(letters, rng.permutation(90)[:count], strict=True)]
    nodes = {}
    for index, name in enumerate(names):
        if index < moving:
            way, speed = walk(rng, faces, free, duration_s, kind in ("street", "yard"))
        else:
            way, speed = [point(rng, faces, free).tolist()], 0.0
        antenna, turn = str(rng.choice(ANTENNAS)), [0.0, 0.0, 0.0]
        if antenna == "tr38901":
            toward = middle - np.array(way[0])
            turn = [round(float(np.arctan2(toward[1], toward[0]) + rng.normal(0, 0.3)), 4), 0.0, 0.0]
            if rng.random() < 0.3:
                turn[1:] = np.round(rng.normal(0, 0.1, 2), 4).tolist()
        elif antenna != "iso" and rng.random() < 0.15:
            turn = np.round(rng.normal(0, 0.15, 3), 4).tolist()
        nodes[name] = {"waypoints_m": way, "speed_m_per_s": speed, "antenna": antenna, "orientation_rad": turn}
    return nodes
