# SPDX-License-Identifier: GPL-3.0-or-later
"""The sealed answer to a case, in the form that the scorer of place diagnoses reads."""

import numpy as np
import spaces
from causes import shifted, with_media
from rivals import Judge
from sightings import single_bounces
from slabs import C_M_PER_S
from world import excess, response


def plain(x):
    """Numbers, lists and dictionaries that JSON has."""
    if isinstance(x, dict):
        return {">".join(k) if isinstance(k, tuple) else str(k): plain(v) for k, v in x.items()}
    if isinstance(x, np.ndarray):
        return x.tolist()
    if isinstance(x, list | tuple):
        return [plain(v) for v in x]
    return x.item() if isinstance(x, np.generic) else x


def strengths(world, without, campaign, noise_power):
    """(lambda, names of the links that show it)."""
    a, b = (response(w, campaign.links, campaign.time_s, campaign.frequency_hz) for w in (without, world))
    total, model = excess(a, b, noise_power, campaign.links, campaign.frequency_hz, campaign.unknown)
    each = (np.abs(b - model) ** 2).sum((1, 2)) / noise_power
    least = max(4.0, 0.01 * each.max())
    return total, [">".join(link) for link, e in zip(campaign.links, each, strict=True) if e >= least]


def effect(cause, world, without, campaign, noise_power, strength, links, rivals):
    """One entry of `effects`."""
    parameters = {k: v for k, v in cause.parameters.items() if k != "object"}
    out = {
        "family": cause.family,
        "owner": {"level": cause.level, "name": cause.name},
        "owners_ok": list(cause.owners),
        "lambda": strength,
        "parameters": parameters,
        "values": cause.values,
        "same_as": list(cause.same_as),
        "reflected_nats": None,
        "plane_nats": None,
        "where": {"links": links},
        "targets": None,
        "margin_nats": rivals[0][0] if rivals else None,
        "runner_up": list(rivals[0][1:]) if rivals else None,
    }
    if cause.family == "missing_object":
        _of_missing(out, cause.parameters["object"], world, campaign, noise_power)
    if cause.family == "material":
        seen = zip(single_bounces(world, cause.name, campaign), single_bounces(without, cause.name, campaign), strict=False)
        errors = [a[3] - b[3] for a, b in seen]
        if errors:
            parameters["reflection_error_db"] = {"value": float(np.mean(errors)), "z": False}
    if cause.family == "ground":
        z, (lo, hi) = world["ground"]["height_m"], campaign.free
        a, b = lo - 35, hi + 35
        corners = [[a[0], a[1], z], [b[0], a[1], z], [b[0], b[1], z], [a[0], b[1], z]]
        out["targets"] = [{"point_m": [0, 0, z], "normal": [0, 0, 1], "corners_m": corners, "share": 1.0}]
    return plain(out)


def _of_missing(out, name, world, campaign, noise_power):
    """Planes that its reflections show, where on them, how strong, and how well they fix the plane."""
    judge = Judge(world, campaign, noise_power)
    seen = single_bounces(world, name, campaign)
    out["reflected_nats"] = judge(with_media(world, name, permittivity=1.0, conductivity=0.0))
    faces = spaces.faces_of(world)
    by_face = {}
    for _, face, point, db in seen:
        by_face.setdefault(face, []).append((point, 10 ** (db / 10)))
    total = sum(p for rows in by_face.values() for _, p in rows)
    if not total:
        out["plane_nats"] = 0.0
        return
    out["parameters"]["reflection_db"] = {"value": float(np.mean([s[3] for s in seen])), "z": False}
    points = np.array([s[2] for s in seen])
    out["where"]["extent_m"] = [points.min(0).tolist(), points.max(0).tolist()]
    out["targets"] = []
    for face, rows in sorted(by_face.items(), key=lambda x: -sum(p for _, p in x[1])):
        c, u, v = faces.corner[face], faces.u[face], faces.v[face]
        target = {"point_m": c + (u + v) / 2, "normal": faces.normal[face], "corners_m": [c, c + u, c + u + v, c + v]}
        out["targets"].append({**target, "share": sum(p for _, p in rows) / total})
    reach = max(0.15, 0.15 * C_M_PER_S / world["bandwidth_hz"])
    normal = out["targets"][0]["normal"]
    out["plane_nats"] = min(judge(shifted(world, name, s * reach * normal)) for s in (-1, 1))


def world_of(w):
    """A world as JSON has it."""
    return plain(w)
