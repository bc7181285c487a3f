# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a SPEC's `effects` is played: carriers, timing and grounds before paths are traced; gains, delays, losses after."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S, amplitude_from_db
from ..model import link_name
from .geometry import Solid, bounds_m
from .media import Medium
from .nodes import Node
from .paths import LinkPaths
from .spec import Spec

# Family → the step that plays it, and the parameters that are played; what has none of them is left out.
_PLAYED = {
    "carrier": ("environment", {"carrier_hz"}),
    "ground": ("materials", {"height_m"}),
    "track_timing": ("nodes", {"speed_factor", "time_offset_s"}),
    "node_gain": ("parsing", {"error_db"}),
    "node_delay": ("parsing", {"error_s"}),
    "excess_loss": ("parsing", {"loss_db", "db_per_m", "exponent"}),
}
_TURNS = {"azimuth_rad"}  # what is of some directions alone is not played: a link's paths have lost theirs
_GROUND = dict(own_permittivity=5.0, own_conductivity_s_per_m=0.01, thickness_m=10.0)  # so thick that it has one face
_GROUND_MARGIN_M = 1000.0  # around the place


def step_of(entry: dict) -> str | None:
    """The step that plays an effect; None where no scenario can hold it, or a SPEC has keys for it."""
    step, played = _PLAYED.get(entry["family"], (None, set()))
    return step if played & {*entry["parameters"]} and not _TURNS & {*entry["parameters"]} else None


def summary(entries: Sequence[dict]) -> dict[str, str]:
    """What is played and what is left out, for the record of a run."""
    named = {"effects played": [], "effects left out": []}
    for entry in entries:
        named["effects played" if step_of(entry) else "effects left out"].append(f"{entry['family']} ({entry['owner']['name']})")
    return {key: ", ".join(names) for key, names in named.items() if names}


def world(spec: Spec) -> Spec:
    """The SPEC with the carrier that is sounded, and nodes that move as they do."""
    carriers_hz = [entry["parameters"]["carrier_hz"] for entry in spec.effects if step_of(entry) == "environment"]
    moved = tuple(timed(node, spec.effects) for node in spec.nodes)
    return replace(spec, carrier_hz=(carriers_hz or [spec.carrier_hz])[-1], nodes=moved)


def timed(node: Node, entries: Sequence[dict]) -> Node:
    """The node as it moves in the world: where the SPEC has it `time_offset_s` later, at `speed_factor` times its speed."""
    for entry in _of(entries, "track_timing", node.name):
        given = entry["parameters"]
        node = replace(
            node,
            speed_m_per_s=node.speed_m_per_s * given.get("speed_factor", 1.0),
            start_s=node.start_s - given.get("time_offset_s", 0.0),
        )
    return node


def with_ground(entries: Sequence[dict], solids: list[Solid]) -> list[Solid]:
    """The objects, and a level sheet below them where an effect says that there is ground."""
    for entry in entries:
        if step_of(entry) == "materials":
            given = entry["parameters"]
            low, high = bounds_m(solids)
            (west, south), (east, north) = low[:2] - _GROUND_MARGIN_M, high[:2] + _GROUND_MARGIN_M
            corners_m = np.array([[west, south], [east, south], [east, north], [west, north]])
            medium = Medium(**_GROUND | {"own_permittivity": given.get("permittivity", _GROUND["own_permittivity"])})
            vertices_m = np.column_stack([corners_m, np.full(4, given["height_m"])])
            solids = [*solids, Solid(name="ground", vertices_m=vertices_m, faces=[[0, 1, 2], [0, 2, 3]], medium=medium)]
    return solids


def _shortest(length_m: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Of the paths at each instant that are there: as far as the ends are apart where they see each other."""
    return np.where(gain != 0, length_m, length_m.max()).min(axis=-1, keepdims=True)


def _of(entries: Sequence[dict], family: str, *owners: str) -> list[dict]:
    return [entry for entry in entries if entry["family"] == family and entry["owner"]["name"] in owners]


def on_link(entries: Sequence[dict], tx: str, rx: str, link: LinkPaths, carrier_hz: float) -> LinkPaths:
    """One link's paths with the gains, delays and losses of its nodes, of itself, and of the place.

    A delay turns the response by e^(-j2πf·error), f from the carrier: the carrier's phase is not touched.
    """
    nodes, own = (tx, rx), (link_name((tx, rx)), link_name((rx, tx)))
    length_m = np.maximum(link.delay_s * SPEED_OF_LIGHT_M_PER_S, 1.0)
    gain_db = np.zeros(link.gain.shape)
    for entry in _of(entries, "node_gain", *nodes, *own):
        gain_db = gain_db + entry["parameters"].get("error_db", 0.0)
    for entry in filter(step_of, _of(entries, "excess_loss", "place", *nodes, *own)):
        given = entry["parameters"]
        gain_db = gain_db - given.get("loss_db", 0.0) - given.get("db_per_m", 0.0) * length_m
        far_m = length_m if given.get("distance") == "path" else _shortest(length_m, link.gain)
        gain_db = gain_db - 10 * (given.get("exponent", 2.0) - 2.0) * np.log10(far_m)  # of power over distance from 1 m on
    late_s = sum(entry["parameters"].get("error_s", 0.0) for entry in _of(entries, "node_delay", *nodes, *own))
    turned = link.gain * amplitude_from_db(gain_db) * np.exp(2j * np.pi * carrier_hz * late_s)
    return replace(link, delay_s=link.delay_s + late_s, gain=turned)
