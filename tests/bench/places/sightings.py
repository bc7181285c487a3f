# SPDX-License-Identifier: GPL-3.0-or-later
"""Which links see an object by a single reflection, where on it and how strongly."""

import numpy as np
from mirror import patches, specular
from patterns import field
from strength import reflected, unit
from world import material_of, media_of, position_m, response


def lit_objects(w, campaign, least=1e-3):
    """Objects whose removal changes the responses by more than this share of their energy, strongest first."""
    times = campaign.time_s[:: max(1, len(campaign.time_s) // 4)]
    f = campaign.frequency_hz[:: max(1, len(campaign.frequency_hz) // 16)]
    full = response(w, campaign.links, times, f)
    weight = 1 / np.maximum((np.abs(full) ** 2).mean((1, 2), keepdims=True), 1e-30)
    change = {}
    for name in w["objects"]:
        rest = {**w, "objects": {n: o for n, o in w["objects"].items() if n != name}}
        change[name] = float((weight * np.abs(full - response(rest, campaign.links, times, f)) ** 2).mean())
    return [n for n in sorted(change, key=change.get, reverse=True) if change[n] > least]


def single_bounces(w, name, campaign, count=6):
    """(link, patch normal, point, reflection in dB of the material given) of every first-order path over an object."""
    things = {n: o["tris"] for n, o in w["objects"].items()}
    if w["ground"]:
        things = dict(things)
    faces = patches(things)
    mine = list(things).index(name)
    times = campaign.time_s[np.unique(np.linspace(0, len(campaign.time_s) - 1, count).round().astype(int))]
    at = {n: position_m(w["nodes"][n], times) for link in campaign.links for n in link}
    rows = [(k, t) for k in range(len(campaign.links)) for t in range(len(times))]
    start = np.array([at[campaign.links[k][0]][t] for k, t in rows])
    end = np.array([at[campaign.links[k][1]][t] for k, t in rows])
    paths = specular(faces, start, end, 1, w["refraction"])
    if len(paths) < 2:
        return []
    paths, media = paths[1], media_of(faces, [material_of(w, n) for n in things])
    out = []
    for pair, (face,), points in zip(paths.pair, paths.faces, paths.points, strict=True):
        if faces.owner[face] != mine:
            continue
        link = campaign.links[rows[pair][0]]
        k = unit(np.diff(points, axis=0))
        node = w["nodes"][link[0]]
        e = field(node["antenna"], node["orientation_rad"], k[:1]).astype(complex)
        after = reflected(e, k[:1], k[1:], faces.normal[[face]], media, np.array([face]), w["carrier_hz"])
        db = 20 * np.log10(max(np.linalg.norm(after), 1e-12) / max(np.linalg.norm(e), 1e-12))
        out.append((link, int(face), points[1], float(db)))
    return out
