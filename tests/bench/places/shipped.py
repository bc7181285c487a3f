# SPDX-License-Identifier: GPL-3.0-or-later
"""The places that ship with the project, Arena and the street, with something concealed in them: drawn, sounded, sealed.

Their shapes are read by the project's readers of meshes and maps; what is heard there is this folder's physics alone.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path

import campaign as campaigns
import cases
import causes
import numpy as np
import truths
from sightings import lit_objects
from world import new_world

import build

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "build" / "python"))
from gr_cast.scenario.create import materials, model
from gr_cast.scenario.create.spec import read as read_spec

EXAMPLES = ROOT / "python" / "gr_cast" / "scenario" / "examples"
FURNITURE = ("cabinet", "rack", "desk", "partition")
UNKNOWN = {"phase": "snapshot", "delay": "link", "gain": "common"}
SNR_DB, TONES, OFF_M, STRONG = 25.0, 32, 0.4, 100.0
WHAT = {  # what is concealed in a case, in the order of concealing
    "arena_object": ("missing_object",),
    "arena_material": ("material",),
    "arena_node": ("node_position",),
    "arena_three": ("missing_object", "material", "node_position"),
    "arena_nothing": (),
    "street_building": ("missing_object",),
    "street_nothing": (),
}


def world_of(spec):
    """A SPEC as a world of this folder."""
    w = new_world() | {"carrier_hz": spec.carrier_hz, "bandwidth_hz": spec.bandwidth_hz, "max_depth": spec.max_depth}
    for solid in materials.assign(model.read(spec)[0], spec.materials, spec.carrier_hz):
        w["objects"][solid.name] = {"tris": solid.vertices_m[solid.faces], "surface": None}
        w["materials"][solid.name] = solid.medium.material
        w["media"][solid.name] = {"thickness_m": solid.medium.thickness_m}
    for node in spec.nodes:
        w["nodes"][node.name] = {
            "waypoints_m": node.waypoints_m.tolist(),
            "speed_m_per_s": node.speed_m_per_s if node.is_moving else 0.0,
            "antenna": node.antenna,
            "orientation_rad": list(node.orientation_rad),
        }
    return w | {"duration_s": spec.duration_s}


def arena(depth):
    """(world, campaign of 20 links, vault): four pairs under the ceiling hear five nodes below, one of which walks."""
    w = world_of(read_spec(EXAMPLES / "arena.yaml")) | {"max_depth": depth}
    first = [(a, b) for a in ("c6", "c11", "c18", "c27") for b in ("s2", "s3", "s5", "s8", "m1")]
    later = [(a, b) for a in ("c1", "c14", "c30") for b in ("s1", "s4", "s7", "m1")]
    return w, *_campaigns(w, "office", first, later, np.array([0.5, 3.5, 6.5]), np.array([8.0, 9.5]))


def street(depth):
    """(world, campaign, vault): the car hears mast and pedestrian on its drive; the vault is its way back on the other lane."""
    w = world_of(read_spec(EXAMPLES / "street.yaml")) | {"max_depth": depth}
    back = [[60.0, 2.0, 1.5], [-60.0, 2.0, 1.5]]
    w["nodes"]["back"] = {**w["nodes"]["car"], "waypoints_m": back}
    first, later = [("base", "car"), ("walker", "car"), ("base", "walker")], [("base", "back"), ("walker", "back")]
    return w, *_campaigns(w, "street", first, later, np.arange(24) * 0.5, 0.3 + np.arange(8) * 1.5)


def _campaigns(w, kind, first, later, times, times_later):
    f = ((np.arange(TONES) + 0.5) / TONES - 0.5) * w["bandwidth_hz"]
    free = np.array([t["tris"].reshape(-1, 3).min(0) for t in w["objects"].values()]).min(0)
    one = campaigns.Campaign(
        links=tuple(first), time_s=times, frequency_hz=f, unknown=UNKNOWN, kind=kind, free=np.array([free, -free])
    )
    return one, replace(one, links=tuple(later), time_s=times_later)


def _off(rng, w, campaign, lit, used):
    """A node that stands still, 0.4 m beside where the SPEC has it."""
    ends = {n for link in campaign.links for n in link}
    name = causes._pick(rng, [n for n in w["nodes"] if n in ends and n not in used and not causes.is_moving(w["nodes"][n])])
    angle = rng.uniform(0, 2 * np.pi)
    offset = (OFF_M * np.array([np.cos(angle), np.sin(angle), 0.0])).tolist()
    used.add(name)
    change = {"offset_m": causes._number(offset)}
    return w, causes._node_cause("node_position", name, lambda x: causes.with_node(x, name, offset_m=offset), change)


def _is_lit(effect):
    """Whether a missing object shows by its reflections, and not only by what it shades: then its plane can be judged."""
    if effect["family"] != "missing_object":
        return True
    return effect["reflected_nats"] >= max(STRONG, 0.2 * effect["lambda"]) and effect["plane_nats"] >= 20


def concealed(rng, what, depth=2):
    """A case of `WHAT`, drawn until every cause has a strength of 100, and what is left out reflects something."""
    twin, first, vault = (street if what.startswith("street") else arena)(depth)
    power = cases.mean_power(twin, first)
    noise = campaigns.noises(rng, first, power / 10 ** (SNR_DB / 10))
    lit = lit_objects(twin, first)
    moved = [o for o in lit if o.startswith(FURNITURE) or (first.kind == "street" and o != "ground")]
    for _ in range(40):
        found, used, plain = [], set(), twin
        for family in WHAT[what]:
            draw, among = (_off, lit) if family == "node_position" else (causes.RESPONSE[family], lit)
            among = moved if family == "missing_object" else [o for o in among if not o.startswith(FURNITURE)]
            plain, cause = draw(rng, plain, first, among, used)
            found.append(cause)
        world, effects = cases.compose(plain, found), []
        for cause in found:
            without = cases.compose(plain, found, cause)
            strength, links = truths.strengths(world, without, first, noise)
            effects.append(truths.effect(cause, world, without, first, noise, strength, links, []))
        if all(effect["lambda"] >= STRONG and _is_lit(effect) for effect in effects):
            break
    else:
        raise SystemExit(f"error: {what}: nothing strong enough in 40 draws")
    return {"twin": plain, "world": world, "effects": effects, "first": first, "vault": vault, "noise": noise, "lit": lit}


def make(what, seed, output, depth=2):
    """Draw, write and seal OUTPUT/places/NAME and OUTPUT/truth/NAME.json; what is there stays."""
    name = f"{what}_{seed}"
    sealed = output / "truth" / f"{name}.json"
    if sealed.exists():
        return
    rng = np.random.default_rng([seed, *what.encode()])
    case = concealed(rng, what, depth)
    soundings, kept = build.response_soundings(rng, case)
    kind = ("null", "single", "double", "triple")[len(case["effects"])]
    truth = {"kind": kind, "ambiguous": None, "tolerated": [], "record": None, "case": name, "case_dir": f"../places/{name}"}
    truth |= {"effects": case["effects"], "conditions": cases.conditions(case), "vault": kept, "world": case["world"]}
    build.write_case(output / "places" / name, case, soundings)
    sealed.parent.mkdir(exist_ok=True)
    sealed.write_text(json.dumps(truths.plain(truth)))
    said = ", ".join(f"{e['family']} of {e['owner']['name']} {e['lambda']:.0f}" for e in case["effects"]) or "nothing"
    print(f"{name}: {said}", flush=True)
