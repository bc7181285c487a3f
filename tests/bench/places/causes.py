# SPDX-License-Identifier: GPL-3.0-or-later
"""The causes of the contract: each draws a twin and the change that makes the world of it, with the truth's numbers."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import spaces
from mirror import patches
from slabs import EPSILON_0, TABLE, medium
from world import is_moving

ANTENNAS = ("iso", "dipole", "hw_dipole", "tr38901")


@dataclass(frozen=True, kw_only=True)
class Cause:
    family: str
    level: str
    name: str
    apply: Callable  # world without the cause -> world with it
    parameters: dict = field(default_factory=dict)
    values: dict = field(default_factory=dict)
    same_as: tuple = ()
    owners: tuple = ()  # all that may be named


class Unfit(Exception):
    """This place cannot hold this cause."""


def one_of(w, **changes):
    return {**w, **changes}


def with_node(w, name, **changes):
    return {**w, "nodes": {**w["nodes"], name: {**w["nodes"][name], **changes}}}


def with_media(w, thing, **changes):
    return {**w, "media": {**w["media"], thing: {**w["media"].get(thing, {}), **changes}}}


def without_object(w, name):
    return {**w, **{k: {n: x for n, x in w[k].items() if n != name} for k in ("objects", "materials", "media")}}


def with_object(w, name, thing, material):
    return {**w, "objects": {**w["objects"], name: thing}, "materials": {**w["materials"], name: material}}


def shifted(w, name, offset):
    thing = w["objects"][name]
    return {**w, "objects": {**w["objects"], name: {**thing, "tris": thing["tris"] + np.asarray(offset)}}}


def _signed(rng, low, high):
    return float(rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(low), np.log(high))))


def _number(value, judged=True, **more):
    return {"value": value, "z": judged, **more}


def _pick(rng, options):
    options = list(options)
    if not options:
        raise Unfit
    return options[int(rng.integers(len(options)))]


def _linked(w, campaign, used, count=1):
    """Nodes with at least so many links."""
    ends = [n for link in campaign.links for n in link]
    return [n for n in w["nodes"] if ends.count(n) >= count and n not in used]


def _is_level(w, name):
    return len(np.unique(np.round(w["objects"][name]["tris"][..., 2], 6))) == 1


def _owners(w, name):
    mine = w["materials"][name]
    alone = sum(m == mine for m in w["materials"].values()) == 1
    return (name, mine) if alone else (name,)


# ---------------------------------------------------------------- objects
def missing_object(rng, w, campaign, lit, used):
    name = _pick(rng, [o for o in lit if o not in used and not (campaign.kind in ("street", "yard") and _is_level(w, o))])
    thing, material = w["objects"][name], w["materials"][name]
    used.add(name)
    cause = Cause(
        family="missing_object",
        level="place",
        name="place",
        apply=lambda x: with_object(x, name, thing, material),
        values={},
        owners=("place",),
        same_as=("ground",) if _is_level(w, name) and thing["tris"][0, 0, 2] < 0.1 else (),
        parameters={"object": name},
    )
    return without_object(w, name), cause


def extra_object(rng, w, campaign, lit, used):
    name = _pick(rng, [o for o in lit if o not in used])
    used.add(name)
    return w, Cause(family="extra_object", level="object", name=name, apply=lambda x: without_object(x, name), owners=(name,))


def object_moved(rng, w, campaign, lit, used):
    name = _pick(rng, [o for o in lit if o not in used and not (_is_level(w, o) and campaign.kind in ("street", "yard"))])
    normal = _pick(rng, [n for n in patches({name: w["objects"][name]["tris"]}).normal if abs(n[2]) < 0.5 or _is_level(w, name)])
    size = _signed(rng, 0.02, 0.6)
    used.add(name)
    faces = spaces.faces_of(shifted(w, name, size * normal))
    for node in w["nodes"].values():
        if not all(spaces.is_free(faces, None, np.array(p), 0.05) for p in node["waypoints_m"]):
            raise Unfit
    parameters = {"offset_m": _number((size * normal).tolist(), along=normal.tolist()), "normal": _number(normal.tolist(), False)}
    parameters.pop("normal")
    return w, Cause(
        family="object_moved",
        level="object",
        name=name,
        apply=lambda x: shifted(x, name, size * normal),
        parameters=parameters,
        owners=(name,),
    )


def nearest_material(permittivity, conductivity, carrier_hz):
    eta = permittivity - 1j * conductivity / (EPSILON_0 * 2 * np.pi * carrier_hz)
    usable = [m for m in TABLE if TABLE[m][4] <= carrier_hz / 1e9 <= TABLE[m][5]]

    def distance(m):
        e, s = medium(m, carrier_hz)
        other = e - 1j * s / (EPSILON_0 * 2 * np.pi * carrier_hz)
        a, b = ((1 - np.sqrt(x)) / (1 + np.sqrt(x)) for x in (eta, other))
        return abs(a - b)

    return min(usable, key=distance)


def material(rng, w, campaign, lit, used):
    name = _pick(rng, [o for o in lit if o not in used])
    fc = w["carrier_hz"]
    other = _pick(rng, [m for m in TABLE if TABLE[m][4] <= fc / 1e9 <= TABLE[m][5] and m != w["materials"][name]])
    permittivity, conductivity = medium(other, fc)
    permittivity = float(max(permittivity * np.exp(rng.normal(0, 0.07)), 1.0))
    conductivity = float(conductivity * np.exp(rng.normal(0, 0.1)))
    used.add(name)
    loss_db = 8.686 * 2 * 0.1 * 188.4 * conductivity / np.sqrt(permittivity)  # there and back through the slab
    return w, Cause(
        family="material",
        level="object",
        name=name,
        apply=lambda x: with_media(x, name, permittivity=permittivity, conductivity=conductivity),
        parameters={
            "permittivity": _number(permittivity, bool(15 < loss_db < 500)),
            "conductivity": _number(conductivity, False),
        },
        values={"nearest": nearest_material(permittivity, conductivity, fc)},
        owners=_owners(w, name),
    )


def roughness(rng, w, campaign, lit, used):
    name = _pick(rng, [o for o in lit if o not in used])
    height = float(299792458 / w["carrier_hz"] / np.pi * np.sqrt(np.exp(rng.uniform(np.log(0.1), np.log(3))) / 8))
    used.add(name)
    return w, Cause(
        family="roughness",
        level="object",
        name=name,
        apply=lambda x: with_media(x, name, height_rms_m=height),
        parameters={"height_rms_m": _number(height)},
        owners=_owners(w, name),
    )


def missing_scattering(rng, w, campaign, lit, used):
    share = round(float(rng.uniform(0.2, 0.7)), 3)
    every = rng.random() < 0.5
    names = list(w["objects"]) if every else [_pick(rng, [o for o in lit if o not in used])]
    used.add("scattering")

    def apply(x):
        for name in names:
            if name in x["objects"]:
                x = with_media(x, name, scattering_coefficient=share)
        return x

    level, owner = ("place", "place") if every else ("object", names[0])
    owners = ("place",) if every else _owners(w, owner)
    return w, Cause(
        family="missing_scattering",
        level=level,
        name=owner,
        apply=apply,
        parameters={"scattering_coefficient": _number(share, False)},
        owners=owners,
    )


# ---------------------------------------------------------------- mechanisms
def _switch(family, **changes):
    def draw(rng, w, campaign, lit, used):
        if any(w[k] == v for k, v in changes.items()):
            raise Unfit
        used.add(family)
        return w, Cause(
            family=family,
            level="place",
            name="place",
            apply=lambda x: one_of(x, **changes),
            owners=("place", *w["objects"]),
        )

    return draw


missing_transmission = _switch("missing_transmission", refraction=True)
missing_diffraction = _switch("missing_diffraction", diffraction=True)


def missing_reflections(rng, w, campaign, lit, used):
    order = w["max_depth"] + 1
    if order > 3:
        raise Unfit
    return w, Cause(
        family="missing_reflections",
        level="place",
        name="place",
        apply=lambda x: one_of(x, max_depth=order),
        parameters={"order": _number(order, False)},
        owners=("place",),
    )


def moving_scatterer(rng, w, campaign, lit, used):
    vehicle = campaign.kind in ("street", "yard") and rng.random() < 0.5
    faces = spaces.faces_of(w)
    speed, angle = rng.uniform(2, 8) if vehicle else rng.uniform(0.4, 1.6), rng.uniform(0, 2 * np.pi)
    begin = spaces.point(rng, faces, campaign.free, 0.4)
    begin[2] = 0.0
    velocity = np.array([speed * np.cos(angle), speed * np.sin(angle), 0.0])
    body = {
        "position_m": begin.tolist(),
        "velocity_m_per_s": velocity.tolist(),
        "radius_m": 0.9 if vehicle else round(float(rng.uniform(0.2, 0.35)), 3),
        "height_m": 1.8,
        "rcs_m2": float(rng.uniform(5, 30) if vehicle else rng.uniform(0.3, 1.5)),
    }
    end = begin + velocity * campaign.time_s[-1]
    if np.any(end[:2] < campaign.free[0, :2] - 0.5) or np.any(end[:2] > campaign.free[1, :2] + 0.5):
        raise Unfit
    used.add("person")
    return w, Cause(
        family="moving_scatterer",
        level="place",
        name="place",
        apply=lambda x: one_of(x, person=body),
        parameters={
            "position_m": _number(begin.tolist(), axes=[0, 1]),
            "velocity_m_per_s": _number(velocity.tolist(), axes=[0, 1]),
        },
        owners=("place",),
    )


def carrier(rng, w, campaign, lit, used):
    if rng.random() < 0.7:
        hz = w["carrier_hz"] * (1 + _signed(rng, 0.001, 0.06))
    else:
        hz = _pick(rng, [f for f in spaces.CARRIERS_HZ if 0.35 < f / w["carrier_hz"] < 3 and f != w["carrier_hz"]])
    names = {w["materials"][o] for o in w["objects"]}
    if any(not TABLE[m][4] <= hz / 1e9 <= TABLE[m][5] for m in names) or hz < 1e9 or hz > 29e9:
        raise Unfit
    used.add("carrier")
    return w, Cause(
        family="carrier",
        level="place",
        name="place",
        apply=lambda x: one_of(x, carrier_hz=float(hz)),
        parameters={"carrier_hz": _number(float(hz))},
        owners=("place",),
    )


def ground(rng, w, campaign, lit, used):
    if any(_is_level(w, o) for o in w["objects"]) or campaign.kind in ("room", "corridor"):
        raise Unfit
    height = round(float(rng.uniform(-0.5, 0.3)), 3)
    permittivity = float(rng.uniform(3, 25))
    used.add("ground")
    g = {"height_m": height, "permittivity": permittivity, "conductivity": 0.01}
    return w, Cause(
        family="ground",
        level="place",
        name="place",
        apply=lambda x: one_of(x, ground=g),
        parameters={"height_m": _number(height), "permittivity": _number(permittivity)},
        same_as=("missing_object",),
        owners=("place",),
    )


def excess_loss(rng, w, campaign, lit, used):
    if rng.random() < 0.4:
        exponent = float(rng.uniform(2.15, 3.2))
        used.add("exponent")
        return w, Cause(
            family="excess_loss",
            level="place",
            name="place",
            apply=lambda x: one_of(x, exponent=exponent),
            parameters={"exponent": _number(exponent)},
            owners=("place",),
        )
    ends = [n for link in campaign.links for n in link]
    link = _pick(rng, [k for k in campaign.links if min(ends.count(k[0]), ends.count(k[1])) > 1])
    loss = float(abs(_signed(rng, 0.5, 12)))
    name = ">".join(link)
    return w, Cause(
        family="excess_loss",
        level="link",
        name=name,
        apply=lambda x: one_of(x, link_loss_db={**x["link_loss_db"], link: loss}),
        parameters={"loss_db": _number(loss)},
        same_as=("node_gain:link",),
        owners=(name,),
    )


# ---------------------------------------------------------------- nodes
def _node_cause(family, name, apply, parameters=None, values=None):
    return Cause(
        family=family, level="node", name=name, apply=apply, parameters=parameters or {}, values=values or {}, owners=(name,)
    )


def node_position(rng, w, campaign, lit, used):
    name = _pick(rng, _linked(w, campaign, used))
    offset = rng.normal(size=3) * [1, 1, 0.4]
    offset = (offset / np.linalg.norm(offset) * abs(_signed(rng, 0.01, 0.6))).tolist()
    used.add(name)
    faces = spaces.faces_of(w)
    if not all(spaces.is_free(faces, None, np.array(p) + offset, 0.05) for p in w["nodes"][name]["waypoints_m"]):
        raise Unfit
    return w, _node_cause("node_position", name, lambda x: with_node(x, name, offset_m=offset), {"offset_m": _number(offset)})


def track_timing(rng, w, campaign, lit, used):
    name = _pick(rng, [n for n in _linked(w, campaign, used) if is_moving(w["nodes"][n])])
    factor, late = 1.0, 0.0
    if rng.random() < 0.5:
        factor = 1 + _signed(rng, 0.005, 0.15)
    else:
        late = abs(_signed(rng, 0.02, 0.6))
    used.add(name)
    parameters = {"speed_factor": _number(factor), "time_offset_s": _number(late)}
    return w, _node_cause("track_timing", name, lambda x: with_node(x, name, speed_factor=factor, time_offset_s=late), parameters)


def antenna_orientation(rng, w, campaign, lit, used):
    name = _pick(rng, [n for n in _linked(w, campaign, used) if w["nodes"][n]["antenna"] == "tr38901"])
    yaw, pitch = _signed(rng, 0.05, 1.2), float(rng.choice([0.0, rng.normal(0, 0.2)]))
    used.add(name)
    turn = (np.array(w["nodes"][name]["orientation_rad"]) + [yaw, pitch, 0]).tolist()
    parameters = {"yaw_rad": _number(yaw), "pitch_rad": _number(pitch)}
    return w, _node_cause("antenna_orientation", name, lambda x: with_node(x, name, orientation_rad=turn), parameters)


def antenna_pattern(rng, w, campaign, lit, used):
    name = _pick(rng, _linked(w, campaign, used))
    antenna = _pick(rng, [a for a in ANTENNAS if a != w["nodes"][name]["antenna"]])
    used.add(name)
    return w, _node_cause("antenna_pattern", name, lambda x: with_node(x, name, antenna=antenna), values={"pattern": antenna})


def node_gain(rng, w, campaign, lit, used):
    name = _pick(rng, _linked(w, campaign, used, 2))
    db = _signed(rng, 0.3, 8)
    used.add(name)
    return w, _node_cause(
        "node_gain", name, lambda x: one_of(x, node_gain_db={**x["node_gain_db"], name: db}), {"error_db": _number(db)}
    )


def node_delay(rng, w, campaign, lit, used):
    name = _pick(rng, _linked(w, campaign, used, 2))
    late = _signed(rng, 0.05e-9, 8e-9)
    used.add(name)
    return w, _node_cause(
        "node_delay", name, lambda x: one_of(x, node_delay_s={**x["node_delay_s"], name: late}), {"error_s": _number(late)}
    )


RESPONSE = {
    f.__name__: f
    for f in (
        missing_object,
        extra_object,
        object_moved,
        material,
        roughness,
        missing_reflections,
        missing_scattering,
        moving_scatterer,
        node_position,
        track_timing,
        antenna_orientation,
        antenna_pattern,
        node_gain,
        node_delay,
        carrier,
        ground,
        excess_loss,
    )
} | {"missing_transmission": missing_transmission, "missing_diffraction": missing_diffraction}
