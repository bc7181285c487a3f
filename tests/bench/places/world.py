# SPDX-License-Identifier: GPL-3.0-or-later
"""A place as it is or as its twin has it, a plain dictionary, and the responses that links have in it.

The scorer of place diagnoses calls `read_spec`, `new_world`, `response`, `excess` and `material_of`.
"""

import re
from collections import OrderedDict
from pathlib import Path

import diffuse
import numpy as np
import wedges
import yaml
from mirror import patches, specular
from patterns import field
from slabs import C_M_PER_S, medium
from strength import amplitudes, unit
from unknowns import excess

__all__ = ["excess", "material_of", "new_world", "power_db", "read_spec", "response"]

KEPT = 2000  # traces kept, so that a change of materials or gains costs no new one
_traces: OrderedDict = OrderedDict()
SURFACE = {"thickness_m": 0.1, "height_rms_m": 0.0, "scattering_coefficient": 0.0}


def new_world():
    return {
        "objects": {},  # name: {"tris": (N, 3, 3), "surface": None}
        "materials": {},  # object: name of the material
        "media": {},  # object: numbers that differ from the material's
        "nodes": {},
        "carrier_hz": 1e9,
        "bandwidth_hz": 1e8,
        "max_depth": 1,
        "refraction": False,
        "diffraction": False,
        "scatter_seed": 0,
        "patch_m": 0.5,
        "person": None,
        "ground": None,  # {"height_m", "permittivity", "conductivity"}
        "node_gain_db": {},
        "node_delay_s": {},
        "link_loss_db": {},
        "exponent": 2.0,  # of the distance law: 10 (n − 2) log10(distance / 1 m) dB beyond the paths' own
        "extra": None,  # physics outside the list
    }


def read_spec(path):
    """World of a SPEC of `cast_scenario.py create`."""
    path = Path(path)
    spec, w = yaml.safe_load(path.read_text()), new_world()
    w["carrier_hz"] = float(spec["environment"]["carrier_hz"])
    w["bandwidth_hz"] = float(spec["environment"]["bandwidth_hz"])
    sampling = spec.get("sampling") or {}
    w["max_depth"] = int(sampling.get("max_depth", 1))
    w["refraction"], w["diffraction"] = bool(sampling.get("refraction")), bool(sampling.get("diffraction"))
    mesh = spec["model"]["mesh"]
    for name in mesh if isinstance(mesh, list) else [mesh]:
        for thing, tris in read_obj(path.parent / name).items():
            w["objects"][thing] = {"tris": tris, "surface": None}
    for pattern, value in (spec.get("materials") or {}).items():
        for thing in w["objects"]:
            if thing != pattern and not re.fullmatch(re.escape(pattern).replace(r"\*", ".*").replace(r"\?", "."), thing):
                continue
            if isinstance(value, dict):
                own = {k: float(v) for k, v in value.items() if k != "material" and v is not None}
                w["materials"][thing] = value.get("material", "concrete")
                w["media"].pop(thing, None)
                if own:
                    w["media"][thing] = own
            else:
                w["materials"][thing] = value
                w["media"].pop(thing, None)
    for name, node in spec["nodes"].items():
        w["nodes"][name] = {
            "waypoints_m": [list(map(float, p)) for p in node.get("waypoints_m") or [node["position_m"]]],
            "speed_m_per_s": float(node.get("speed_m_per_s", 0.0)),
            "antenna": node.get("antenna", "iso"),
            "orientation_rad": [float(x) for x in node.get("orientation_rad", (0, 0, 0))],
        }
    if not sampling.get("scattering"):
        for own in w["media"].values():
            own.pop("scattering_coefficient", None)
    return w


def read_obj(path):
    """{name: triangles (N, 3, 3)} of a Wavefront file."""
    corners, things, name = [], {}, "mesh"
    for line in Path(path).read_text().splitlines():
        word, *rest = line.split("#")[0].split() or [""]
        if word == "v":
            corners.append([float(x) for x in rest[:3]])
        elif word in ("o", "g") and rest:
            name = rest[0]
        elif word == "f":
            ring = [int(x.split("/")[0]) for x in rest]
            ring = [i - 1 if i > 0 else len(corners) + i for i in ring]
            things.setdefault(name, []).extend(
                [[corners[ring[0]], corners[a], corners[b]] for a, b in zip(ring[1:], ring[2:], strict=False)]
            )
    return {k: np.array(v) for k, v in things.items()}


def material_of(w, thing):
    """All numbers of an object's surface."""
    permittivity, conductivity = medium(w["materials"].get(thing, "concrete"), w["carrier_hz"])
    return {"permittivity": permittivity, "conductivity": conductivity, **SURFACE, **w["media"].get(thing, {})}


def position_m(node, time_s):
    """(T, 3): along the way-points at constant speed, then at the last; the world's own offset and clock included."""
    points, time_s = np.array(node["waypoints_m"], float), np.asarray(time_s, float)
    moved = np.array(node.get("offset_m", (0, 0, 0)))
    if len(points) < 2 or not node["speed_m_per_s"]:
        return np.repeat(points[:1] + moved, len(time_s), 0)
    clock = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]) / node["speed_m_per_s"]
    at = node.get("speed_factor", 1.0) * (time_s + node.get("time_offset_s", 0.0))
    return np.stack([np.interp(at, clock, points[:, i]) for i in range(3)], 1) + moved


def is_moving(node):
    return len(node["waypoints_m"]) > 1 and node["speed_m_per_s"] > 0


def _solids(w):
    """({name: triangles}, {name: numbers}) of all that stands still, the ground included."""
    things = {name: o["tris"] for name, o in w["objects"].items()}
    numbers = [material_of(w, name) for name in things]
    if w["ground"]:
        g, far = w["ground"], 3000.0
        z = g["height_m"]
        a, b, c, d = [-far, -far, z], [far, -far, z], [far, far, z], [-far, far, z]
        things = {**things, "ground:": np.array([[a, b, c], [a, c, d]])}
        half_space = {**SURFACE, "thickness_m": 100.0, "permittivity": g["permittivity"], "conductivity": g["conductivity"]}
        numbers.append({"height_rms_m": 0.0, **half_space})
    return things, numbers


def media_of(faces, numbers):
    """Numbers of each patch, as arrays."""
    return {k: np.array([numbers[o][k] for o in faces.owner]) for k in ("permittivity", "conductivity", *SURFACE)}


def _kept(key, make):
    if key not in _traces:
        _traces[key] = make()
        while len(_traces) > KEPT:
            _traces.popitem(last=False)
    _traces.move_to_end(key)
    return _traces[key]


def components(w, links, time_s):
    """Rays of all links and instants: (link, instant, amplitude, delay in s), arrays of one length, still links at instant 0."""
    time_s = np.asarray(time_s, float)
    things, numbers = _solids(w)
    key = tuple((name, np.asarray(t).tobytes()) for name, t in things.items())
    faces = _kept(("faces", key), lambda: patches(things))
    media = media_of(faces, numbers)
    at = {n: position_m(w["nodes"][n], time_s) for n in {x for link in links for x in link}}
    moves = [is_moving(w["nodes"][a]) or is_moving(w["nodes"][b]) for a, b in links]
    changing = w["person"] is not None or (w["extra"] or {}).get("moves", False)
    rows = [(k, t) for k in range(len(links)) for t in (range(len(time_s)) if moves[k] or changing else range(1))]
    link_of, time_of = (np.array(x, int) for x in zip(*rows, strict=True))
    start = np.array([at[links[k][0]][t] for k, t in rows])
    end = np.array([at[links[k][1]][t] for k, t in rows])

    def make():
        return specular(faces, start, end, w["max_depth"], w["refraction"])

    found = _kept(("paths", key, start.tobytes(), end.tobytes(), w["max_depth"], w["refraction"]), make)

    names = np.array(links)[link_of]

    def side(which):
        def of(pair, direction):
            out, mine = np.empty_like(direction), names[pair, which]
            for name in set(mine.tolist()):
                node, here = w["nodes"][name], mine == name
                out[here] = field(node["antenna"], node.get("orientation_rad", (0, 0, 0)), direction[here])
            return out

        return of

    send, receive = side(0), side(1)
    ends = np.cumsum([len(p.pair) for p in found])[:-1]
    pairs = np.concatenate([p.pair for p in found])
    sent = np.split(send(pairs, unit(np.concatenate([p.points[:, 1] - p.points[:, 0] for p in found]))), ends)
    received = np.split(receive(pairs, unit(np.concatenate([p.points[:, -2] - p.points[:, -1] for p in found]))), ends)
    parts = [(np.zeros(0, int), np.zeros(0, complex), np.zeros(0))]
    for paths, out, back in zip(found, sent, received, strict=True):
        if len(paths.pair):
            a, length = amplitudes(paths, faces, media, w["carrier_hz"], out, back, w["refraction"])
            parts.append((paths.pair, a * diffuse.shadow(w, paths, time_s[time_of[paths.pair]]), length))
    if w["diffraction"]:
        parts += wedges.diffracted(
            faces,
            _kept(("edges", key), lambda: wedges.edges(faces)),
            media,
            w["carrier_hz"],
            start,
            end,
            send,
            receive,
            w["refraction"],
        )
    if any(media["scattering_coefficient"] > 0):
        parts += diffuse.scattered(w, faces, media, start, end, send, receive, lambda name, make: _kept((key, name), make))
    if w["person"]:
        parts += diffuse.echo(w, faces, start, end, time_s[time_of], send, receive)
    pair, a, length = (np.concatenate(x) for x in zip(*parts, strict=True))
    return link_of[pair], time_of[pair], a, length / C_M_PER_S, np.array(moves) | changing


def response(w, links, time_s, frequency_hz):
    """H, (L, T, K): offsets of frequency from the world's carrier."""
    links, f, time_s = [tuple(x) for x in links], np.asarray(frequency_hz, float), np.asarray(time_s, float)
    link, instant, a, delay, moves = components(w, links, time_s)
    h = np.zeros((len(links) * len(time_s), len(f)), complex)
    cell = link * len(time_s) + instant
    order = np.argsort(cell, kind="stable")
    cell, a, delay = cell[order], a[order], delay[order]
    first = a * np.exp(-2j * np.pi * (w["carrier_hz"] + f[0]) * delay)
    step = np.exp(-2j * np.pi * (f[1] - f[0]) * delay) if len(f) > 1 else np.ones_like(a)
    edges = np.flatnonzero(np.diff(cell, prepend=-1)) if len(cell) else np.zeros(0, int)
    for k in range(len(f)):
        if len(cell):
            h[cell[edges], k] = np.add.reduceat(first, edges)
        first = first * step
    h = h.reshape(len(links), len(time_s), len(f))
    h[~moves] = h[~moves][:, :1]
    for k, (tx, rx) in enumerate(links):
        db = sum(w["node_gain_db"].get(n, 0.0) for n in (tx, rx)) - w["link_loss_db"].get((tx, rx), 0.0)
        late = sum(w["node_delay_s"].get(n, 0.0) for n in (tx, rx))
        far = np.linalg.norm(position_m(w["nodes"][tx], time_s) - position_m(w["nodes"][rx], time_s), axis=1)
        law = far ** (-(w["exponent"] - 2) / 2)
        h[k] *= 10 ** (db / 20) * law[:, None] * np.exp(-2j * np.pi * f * late)
    return h


def power_db(w, links, time_s):
    """Power of links in the band, (L, T) in dB: the mean over 64 equal steps of it."""
    f = ((np.arange(64) + 0.5) / 64 - 0.5) * w["bandwidth_hz"]
    return 10 * np.log10(np.maximum((np.abs(response(w, links, time_s, f)) ** 2).mean(2), 1e-30))
