# SPDX-License-Identifier: GPL-3.0-or-later
"""Truths as JSON, one per case, and the seal over all of them."""

import hashlib
import json
from pathlib import Path

import numpy as np

SEAL = "SEAL.sha256"


def write(folder, name, truth):
    Path(folder).mkdir(parents=True, exist_ok=True)
    (Path(folder) / f"{name}.json").write_text(json.dumps(truth, indent=1) + "\n")


def digest(folder):
    """SHA-256 over names and contents of all truths, in order of name."""
    total = hashlib.sha256()
    for path in sorted(Path(folder).glob("*.json")):
        total.update(path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


def seal(folder):
    """Written before any diagnosis runs."""
    value = digest(folder)
    (Path(folder) / SEAL).write_text(value + "\n")
    return value


def sealed(folder):
    """The truths are those that were sealed."""
    path = Path(folder) / SEAL
    return path.exists() and path.read_text().strip() == digest(folder)


def owners_ok(owner, network, transmitter, receiver):
    """A single link cannot tell its transmitter from its receiver; a network can."""
    if network:
        return [owner["name"]]
    link = f"{transmitter}>{receiver}"
    if owner["level"] == "environment":
        return ["environment", link]
    if owner["level"] == "link":
        return [link]
    return [transmitter, receiver, link]


def _raised(parameter, more_db):
    return {**parameter, "value": parameter["value"] + more_db, "also": [a + more_db for a in parameter["also"]]}


def effect(cause, scene, scenes, lam, network, wanted):
    """One entry of truth's `effects`. scene: the one whose context its parameters are given in; wanted: mean wanted power in its
    recording, which causes make another than that of the twin."""
    parameters, values, where = cause.family.truth(cause.strength, cause.draw, scene.context)
    if cause.owner["level"] in ("environment", "rx"):
        more_db = 10 * np.log10(scene.context.power / wanted)
        parameters = {k: _raised(p, more_db) if k in ("power_dbc", "level_dbc") else p for k, p in parameters.items()}
    if lam < 20 or cause.family.stochastic:
        parameters = {k: {**p, "z": p["z"] and not cause.family.stochastic and lam >= 20} for k, p in parameters.items()}
    if network:
        per_recording = {"power_dbc", "level_dbc", "power_db", "slope_db"}
        parameters = {k: {**p, "z": p["z"] and k not in per_recording} for k, p in parameters.items()}
    same = list(cause.family.same_as)
    if cause.name == "carrier_frequency_offset" and not network and len(scene.context.taps) == 1:
        same.append("tap_doppler")
    return {
        "family": cause.name,
        "owner": cause.owner,
        "owners_ok": owners_ok(cause.owner, network, scene.transmitter, scene.receiver),
        "parameters": parameters,
        "values": values,
        "where": where,
        "recordings": [s.name for s in scenes],
        "lambda": lam,
        "same_as": same,
    }
