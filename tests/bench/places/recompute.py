# SPDX-License-Identifier: GPL-3.0-or-later
"""What a correction removes on the vault, and what a proposed sounding tells, by the bench's own tracer."""

from pathlib import Path

import numpy as np
import world as worlds
import yaml

LEAST = 20.0  # energy of the twin's excess below which nothing is to be removed
SPEC_HOLDS = ("missing_object", "extra_object", "object_moved", "node_position", "antenna_orientation", "antenna_pattern")


def world_from(document):
    """A world as a truth holds it."""
    w = worlds.new_world() | document
    w["objects"] = {n: {**o, "tris": np.array(o["tris"])} for n, o in document["objects"].items()}
    w["link_loss_db"] = {tuple(k.split(">")): v for k, v in document["link_loss_db"].items()}
    return w


def corrected(folder, diagnosis):
    """World of `spec_corrected.yaml`, with the findings that no SPEC has a key for."""
    w = worlds.read_spec(Path(folder) / "spec_corrected.yaml")
    for e in diagnosis["effects"]:
        family, name, p = (
            e["family"],
            e["owner"]["name"],
            {k: v.get("value") for k, v in e["parameters"].items() if isinstance(v, dict)},
        )
        if family in SPEC_HOLDS:
            continue
        if family == "node_gain" and "error_db" in p:
            if ">" in name:
                w["link_loss_db"][tuple(name.split(">"))] = -float(p["error_db"])
            else:
                w["node_gain_db"][name] = float(p["error_db"])
        elif family == "node_delay" and "error_s" in p:
            w["node_delay_s"][name] = float(p["error_s"])
        elif family == "excess_loss" and "exponent" in p:
            w["exponent"] = float(p["exponent"])
        elif family == "excess_loss" and "loss_db" in p:
            if ">" in name:
                w["link_loss_db"][tuple(name.split(">"))] = float(p["loss_db"])
            else:
                w["node_gain_db"][name] = -float(p["loss_db"])
        elif family == "ground" and "height_m" in p:
            w["ground"] = {
                "height_m": float(p["height_m"]),
                "permittivity": float(p.get("permittivity") or 5.0),
                "conductivity": 0.01,
            }
        elif family == "track_timing" and name in w["nodes"]:
            w["nodes"][name]["speed_factor"] = float(p.get("speed_factor") or 1.0)
            w["nodes"][name]["time_offset_s"] = float(p.get("time_offset_s") or 0.0)
    return w


def excess_removed(truth, case, folder, diagnosis):
    """Share of the twin's excess on the vault that the corrected twin is without; None where there is too little."""
    kept = truth.get("vault")
    if not kept or kept["twin"] - kept["true"] < max(LEAST, 6 * np.sqrt(kept["n"])):
        return None
    try:
        w = corrected(folder, diagnosis)
        place = yaml.safe_load((case / "place.yaml").read_text())
        energy = 0.0
        for s in place["soundings"]:
            if s.get("use") == "vault":
                with np.load(case / s["file"]) as z:
                    links = list(zip(z["tx"].tolist(), z["rx"].tolist(), strict=True))
                    h = worlds.response(w, links, z["time_s"], z["frequency_hz"])
                    y = z["response"].astype(complex)
                    energy += worlds.excess(h, y, z["noise_power"], links, z["frequency_hz"], place["unknown"])[0]
    except (OSError, KeyError, ValueError, TypeError, IndexError):
        return 0.0
    return 1 - (energy - kept["true"]) / (kept["twin"] - kept["true"])


def separation(truth, case, proposed, words):
    """Nats by which a proposed sounding tells the two hypotheses apart; a right word counts as enough."""
    if isinstance(proposed, str) or not isinstance(proposed, dict):
        return 10.0 if proposed in words else 0.0
    place = yaml.safe_load((case / "place.yaml").read_text())
    with np.load(case / place["soundings"][0]["file"]) as z:
        links, f = list(zip(z["tx"].tolist(), z["rx"].tolist(), strict=True)), z["frequency_hz"]
        noise = float(np.exp(np.mean(np.log(z["noise_power"]))))
    name, at = proposed["node"], [float(x) for x in proposed["position_m"]]
    both = []
    for document in truth["hypotheses"]:
        w = world_from(document)
        node = w["nodes"].setdefault(name, {"antenna": "iso", "orientation_rad": [0, 0, 0]})
        node.update(waypoints_m=[at], speed_m_per_s=0.0)
        others = sorted({n for link in links for n in link} - {name})
        rows = [(name, n) for n in others] + [k for k in links if name not in k]
        both.append(worlds.response(w, rows, np.zeros(1), f))
    if not all(np.isfinite(h).all() for h in both):
        return 0.0
    return worlds.excess(*both, np.full(len(rows), noise), rows, f, place["unknown"])[0]
