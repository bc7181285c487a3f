# SPDX-License-Identifier: GPL-3.0-or-later
"""Where to sound next: the position whose soundings tell two hypotheses apart by most nats."""

from dataclasses import replace

import numpy as np

from ...scenario.create.nodes import Node
from ...twin.places.predict import Predictor
from ...twin.places.standing import standing
from ...twin.places.world import Radio, World
from . import policy
from .ears import PowerEar
from .likelihood import Heard, profiled

NEW = "new"
_SECOND = 1.5  # of the carrier, that a second one may be


def where_to_sound(ears, hypotheses, unknown: dict):
    """`record_next` of the contract: a new isotropic node where it separates two worlds, else a word."""
    responses = [one for one in ears if not isinstance(one, PowerEar)]
    if not responses:
        return "calibrate_gain"
    heard = responses[0].heard
    best, place = -1.0, None
    for position_m in positions(hypotheses[0]):
        nats = separation_nats(heard, hypotheses, unknown, position_m)
        if nats > best:
            best, place = nats, position_m
    if place is None or best < policy.SEPARATED_NATS:
        if separation_nats(heard, [replace(one, carrier_hz=_SECOND * one.carrier_hz) for one in hypotheses], unknown) > best:
            return "second_carrier"
        return "calibrate_gain" if unknown["gain"] != "none" else "wider_band"
    why = f"sounding from here with all nodes tells both apart by {best:.0f} nats"
    return {"node": NEW, "position_m": [round(float(x), 3) for x in place], "why": why}


def positions(world: World) -> list[np.ndarray]:
    """Positions inside the place, outside objects, away from nodes: the same for the same place."""
    nodes_m = np.concatenate([radio.node.waypoints_m for radio in world.radios.values()])
    low, high = nodes_m.min(axis=0), nodes_m.max(axis=0)
    random = np.random.default_rng(len(nodes_m))
    tries = low + (high - low) * random.random((4 * policy.POSITIONS, 3))
    return [*tries[standing(world, tries)]][: policy.POSITIONS]


def separation_nats(heard: Heard, hypotheses, unknown: dict, position_m: np.ndarray | None = None) -> float:
    """Nats between both worlds in one response per link, of the links that were sounded, and of a new node with all others."""
    worlds, links = hypotheses, list(dict.fromkeys(heard.links))
    if position_m is not None:
        node = Radio(node=Node(name=NEW, waypoints_m=position_m))
        worlds = [replace(world, radios={**world.radios, NEW: node}) for world in hypotheses]
        links = [(NEW, name) for name in sorted({name for link in links for name in link})] + links
    predictor = Predictor(*zip(*links, strict=True), np.zeros(1), heard.frequency_hz)
    first, second = (predictor.response(world) for world in worlds)
    noise = float(np.exp(-np.mean(np.log(heard.weight[heard.weight > 0]))))
    told = Heard(
        links=tuple(links), y=first, weight=np.full(first.shape, 1 / noise), frequency_hz=heard.frequency_hz, **unknown
    )  # fmt: skip
    fit = profiled(told, second)
    return fit.energy - fit.offset
