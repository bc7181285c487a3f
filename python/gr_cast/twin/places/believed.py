# SPDX-License-Identifier: GPL-3.0-or-later
"""The world that a twin believes in, with the `effects` that its SPEC tells of: what was found once is not found again."""

from dataclasses import replace

import numpy as np

from .carrying import Body
from .document import Place
from .families.base import Effect
from .families.mechanisms import Ground
from .meters import Fading, Meter
from .world import World, of_place


def believed(place: Place) -> World:
    """A SPEC's keys, then its effects. Levels of meters and persons stay out: an entry does not say which end, or how wide."""
    world = of_place(place)
    for entry in place.spec.effects:
        world = _with(world, entry["family"], entry["owner"], entry["parameters"])
    return world


def _with(world: World, family: str, owner: dict, told: dict) -> World:
    level, name = owner["level"], owner["name"]
    if family == "node_gain" and "error_db" in told:
        return _louder(world, level, name, told["error_db"])
    if family == "node_delay" and "error_s" in told and level == "node":
        return world.with_radio(name, delay_s=world.radios[name].delay_s + told["error_s"])
    if family == "track_timing":
        return world.with_radio(name, speed_factor=told.get("speed_factor", 1.0), time_offset_s=told.get("time_offset_s", 0.0))
    if family == "excess_loss" and level == "place":
        law = replace(world, exponent=told.get("exponent", world.exponent), exponent_of=told.get("distance", world.exponent_of))
        return replace(law, loss_db_per_m=told.get("db_per_m", world.loss_db_per_m))
    if family == "excess_loss" and {"loss_db", "azimuth_rad", "width_rad"} <= {*told}:
        return world.with_radio(name, body=Body(**{key: told[key] for key in ("loss_db", "azimuth_rad", "width_rad")}))
    if family == "excess_loss" and "loss_db" in told:
        return _louder(world, level, name, -told["loss_db"])
    if family == "ground" and "height_m" in told:
        values = np.array([told["height_m"], np.log(told.get("permittivity", 5.0))])
        return Ground().apply(world, Effect(family=Ground(), owner=name, values=values))
    if family == "small_scale" and {"k_factor_db", "coherence_m"} <= {*told}:
        fading = Fading(k_factor_db=told["k_factor_db"], coherence_m=max(told["coherence_m"], 1e-3))
        return replace(world, fading={**world.fading, tuple(name.split(">")): fading})
    if family == "meter_limits" and told.get("step_db"):
        return replace(world, meters={**world.meters, name: Meter(step_db=told["step_db"])})
    return world


def _louder(world: World, level: str, name: str, gain_db: float) -> World:
    if level == "node":
        return world.with_radio(name, gain_db=world.radios[name].gain_db + gain_db)
    link = tuple(name.split(">"))
    return replace(world, link_loss_db={**world.link_loss_db, link: world.link_loss_db.get(link, 0.0) - gain_db})
