# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases that two families explain alike: the equivalences of the contract, each checked to the nat, and a place that tells."""

from dataclasses import replace

import campaign as campaigns
import cases
import numpy as np
import spaces
import truths
from causes import Unfit, one_of, shifted, with_media, with_node, with_object
from mirror import patches
from scipy.optimize import minimize
from sightings import lit_objects, single_bounces
from slabs import C_M_PER_S
from world import excess, material_of, response

GAP = 0.5  # nats by which the two may differ
WORTH = 20.0  # nats by which some position tells them apart


def gain_or_loss(rng):
    """A node with one link: its cable, or the way."""
    twin, first, vault = cases.stage(rng, moving=0)
    alone = first.links[-1][1]
    links = tuple(k for k in first.links if alone not in k) + ((first.links[-1][0], alone),)
    if len(links) < 3 or any(alone in k for k in links[:-1]):
        raise Unfit
    first = replace(first, links=links, unknown={**first.unknown, "gain": "none"})
    vault = replace(vault, links=tuple(k for k in vault.links if alone not in k))
    db = float(rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(0.7), np.log(8))))
    loss = one_of(twin, link_loss_db={links[-1]: -db})
    gain = one_of(twin, node_gain_db={alone: db})
    return twin, gain, loss, first, vault, ["node_gain", "excess_loss"], alone, ["calibrate_gain"]


def material_or_roughness(rng):
    """A surface that one link sees at one angle."""
    twin, first, vault = cases.stage(rng, moving=0)
    twin = one_of(twin, max_depth=1, refraction=False)
    single = []
    for name in lit_objects(twin, first):
        seen = single_bounces(twin, name, first, 1)
        if len(seen) == 1 and material_of(twin, name)["conductivity"] < 100:
            single.append(name)
    if not single:
        raise Unfit
    name = single[int(rng.integers(len(single)))]
    height = float(C_M_PER_S / twin["carrier_hz"] / np.pi * np.sqrt(np.exp(rng.uniform(np.log(0.2), np.log(3))) / 8))
    rough = with_media(twin, name, height_rms_m=height)
    own = material_of(twin, name)
    one = campaigns.noises(rng, first, cases.mean_power(twin, first) / 1e3)
    h = response(rough, first.links, first.time_s[:1], first.frequency_hz[::8])

    def world(x):
        return with_media(twin, name, permittivity=1 + float(np.exp(x[0])), conductivity=float(np.exp(x[1])))

    def gap(x):
        g = response(world(x), first.links, first.time_s[:1], first.frequency_hz[::8])
        return float((np.abs(g - h) ** 2 / one[:, None, None]).sum())

    best = min(
        (
            minimize(
                gap, [np.log(max(own["permittivity"] * k - 1, 1e-3)), np.log(s)], method="Nelder-Mead", options={"maxiter": 150}
            )
            for k in (0.6, 1.3)
            for s in (0.01, 0.2)
        ),
        key=lambda r: r.fun,
    )
    if best.x[0] > np.log(60) or best.x[1] > np.log(1e4):
        raise Unfit
    return twin, rough, world(best.x), first, vault, ["material", "roughness"], name, ["second_carrier"]


def wall_or_node(rng):
    """A node seen round a corner, by one wall alone: the wall moved, or the node."""
    w, first, vault = cases.stage(rng, "yard", floor=False, moving=0)
    w = one_of(w, max_depth=1, refraction=False)
    scale = rng.uniform(0.8, 1.6)
    wall = spaces.sheet(np.array([-5.0, 0, -0.05]) * scale, np.array([10.0, 0, 0]) * scale, np.array([0, 0, rng.uniform(4, 8)]))
    block = spaces.box(0, rng.uniform(5.6, 6.4) * scale, rng.uniform(0.8, 2.5), 6.5 * scale, -0.05, rng.uniform(6, 9), 0.0)
    far = spaces.box(24 * scale, -4, 6, 3, -0.05, 5, rng.uniform(0, 1))
    names = spaces._names(rng, 3)
    w = one_of(w, objects={}, materials={}, media={}, nodes={})
    for name, tris, material in zip(names, (wall, block, far), ("metal", "concrete", "brick"), strict=True):
        w = with_object(w, name, {"tris": tris, "surface": None}, material)
    nodes = list(spaces.radios(rng, w, np.array([[30.0, 20, 1], [40, 30, 2]]), 8, 0, 5, "yard"))

    def put(name, x, y, z):
        turn = [float(np.round(rng.uniform(-0.3, 0.3), 3)), 0.0, 0.0]
        antenna = str(rng.choice(["iso", "dipole", "hw_dipole"]))
        where = np.round([x * scale, y * scale, z], 3).tolist()
        return {name: {"waypoints_m": [where], "speed_m_per_s": 0.0, "antenna": antenna, "orientation_rad": turn}}

    corner, seen, rest, guests = nodes[0], nodes[1:4], nodes[4:6], nodes[6:]
    placed = put(corner, -rng.uniform(4, 6), rng.uniform(4, 6), rng.uniform(1.2, 3))
    for name in seen:
        placed |= put(name, rng.uniform(3.5, 7), rng.uniform(3.5, 6.5), rng.uniform(1.2, 3.5))
    for name in (*rest, *guests):
        placed |= put(name, rng.uniform(18, 26), rng.uniform(3, 9), rng.uniform(1.2, 3.5))
    w = one_of(w, nodes={n: placed[n] for n in (nodes[k] for k in rng.permutation(8))})
    links = (*((corner, n) for n in seen), (rest[0], rest[1]))
    unknown = {"phase": str(rng.choice(["none", "link"])), "delay": "none", "gain": first.unknown["gain"]}
    first = replace(first, links=links, unknown=unknown)
    vault = replace(vault, links=tuple((a, b) for a in rest for b in guests), unknown=unknown)
    d = float(rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(0.01), np.log(0.3))))
    moved = shifted(w, names[0], [0, d, 0])
    node = with_node(w, corner, offset_m=[0.0, -2 * d, 0.0])
    return w, moved, node, first, vault, ["object_moved", "node_position"], corner, []


def new_or_moved(rng):
    """An echo where nothing is drawn, and an object that no link sees at its place."""
    twin, first, vault = cases.stage(rng)
    hidden = sorted(set(twin["objects"]) - set(lit_objects(twin, first, 1e-9)))
    if not hidden:
        raise Unfit
    name = hidden[int(rng.integers(len(hidden)))]
    normals = [n for n in patches({name: twin["objects"][name]["tris"]}).normal if abs(n[2]) < 0.5]
    if not normals:
        raise Unfit
    offset = normals[int(rng.integers(len(normals)))] * float(rng.choice([-1, 1]) * rng.uniform(0.4, 4))
    moved = shifted(twin, name, offset)
    faces = spaces.faces_of(moved)
    for node in twin["nodes"].values():
        if not all(spaces.is_free(faces, None, np.array(p), 0.05) for p in node["waypoints_m"]):
            raise Unfit
    added = with_object(twin, "added", moved["objects"][name], twin["materials"][name])
    return twin, moved, added, first, vault, ["missing_object", "object_moved"], name, []


PUZZLES = (gain_or_loss, material_or_roughness, wall_or_node, new_or_moved)
NAMES = tuple(f.__name__ for f in PUZZLES)


def draw(rng, family=None):
    chosen = NAMES.index(family) if family in NAMES else int(rng.integers(len(NAMES)))
    maker = PUZZLES[chosen]
    twin, a, b, first, vault, families, owner, words = maker(rng)
    power = cases.mean_power(twin, first)
    one = campaigns.noises(rng, first, power, 0.0)
    raw = truths.strengths(a, twin, first, one)[0]
    ratio = float(np.clip(np.exp(rng.uniform(np.log(150), np.log(2e4))) / max(raw, 1e-12), 3, 10**4))
    if raw * ratio < 120 or raw * ratio > 1e5:
        raise Unfit
    noise = one / ratio
    gap = truths.strengths(a, b, first, noise)[0]
    late = np.full(len(vault.links), noise[0])
    if gap > GAP or truths.strengths(a, b, vault, late)[0] > GAP:
        raise Unfit
    best = max(_told(a, b, first, noise[0], spaces.point(rng, spaces.faces_of(twin), _around(twin, first))) for _ in range(12))
    if best < WORTH:
        raise Unfit
    truth = (a, b)[int(rng.integers(2))]
    effect = {
        "family": families[0] if truth is a else families[1],
        "owner": {"level": "place", "name": owner},
        "lambda": raw * ratio,
    }
    case = {"twin": twin, "world": truth, "effects": [effect], "first": first, "vault": vault, "noise": noise}
    case["hypotheses"] = [a, b]
    case["ambiguous"] = {
        "best_nats": best,
        "family_sets": [sorted(families)],
        "record_words": words,
        "node": owner,
        "gap_nats": gap,
    }
    return case


def _around(w, first):
    """Box of the nodes that sound."""
    at = np.array([w["nodes"][n]["waypoints_m"][0] for k in first.links for n in k])
    return np.array([at.min(0) - 0.5, at.max(0) + 0.5])


def _told(a, b, first, noise, place):
    """Nats by which sounding from a new node tells two worlds apart."""
    names = sorted({n for k in first.links for n in k})
    links = [("new", n) for n in names] + list(first.links)
    node = {"waypoints_m": [place.tolist()], "speed_m_per_s": 0.0, "antenna": "iso", "orientation_rad": [0.0, 0.0, 0.0]}
    h, g = (response(one_of(w, nodes={**w["nodes"], "new": node}), links, np.zeros(1), first.frequency_hz) for w in (a, b))
    return excess(h, g, np.full(len(links), noise), links, first.frequency_hz, first.unknown)[0]
