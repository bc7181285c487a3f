# SPDX-License-Identifier: GPL-3.0-or-later
"""From a world back to a SPEC: what its keys can say is said there, the rest stands in its `effects`."""

import re
from dataclasses import replace

import numpy as np

from ...scenario.create.geometry import Solid
from ...scenario.create.nodes import Node
from ...scenario.create.spec import LONGEST_ID, Spec
from .world import World


def corrected_spec(spec: Spec, world: World) -> Spec:
    """The SPEC with the nodes, carrier and switches of a world; its id is its own, for both may stand in a catalogue."""
    return replace(
        spec,
        id=_next_id(spec.id),
        nodes=tuple(_node(node, world) for node in spec.nodes),
        carrier_hz=world.carrier_hz,
        max_depth=world.max_depth,
        refraction=world.is_clear,
        diffraction=world.diffraction,
        scattering=spec.scattering or bool((world.surface.scattering > 0).any()),
    )


def _next_id(name: str) -> str:
    """room-corrected of room, and room-corrected-2 of that."""
    found = re.fullmatch(r"(.*)-corrected(?:-(\d+))?", name)
    twin, mark = (found[1], f"-corrected-{int(found[2] or 1) + 1}") if found else (name, "-corrected")
    return twin[: LONGEST_ID - len(mark)] + mark


def _node(node: Node, world: World) -> Node:
    radio = world.radios[node.name]
    return replace(radio.node, waypoints_m=node.waypoints_m + np.array(radio.offset_m))


def corrected_solids(world: World) -> list[Solid]:
    """The objects that are there, each of a medium with the world's numbers; ground without a far side is no object of a SPEC."""
    surface, out = world.surface, []
    for index, solid in enumerate(world.mesh.solids):
        if not surface.present[index] or np.isinf(surface.thickness_m[index]):
            continue
        medium = world.media[solid.name]
        changes = {
            "height_rms_m": float(surface.height_rms_m[index]),
            "scattering_coefficient": float(surface.scattering[index]),
        }
        numbers = float(surface.permittivity[index]), float(surface.conductivity[index])
        if not np.allclose(numbers, (medium.permittivity(world.carrier_hz), medium.conductivity(world.carrier_hz)), rtol=1e-9):
            changes |= {"own_permittivity": numbers[0], "own_conductivity_s_per_m": numbers[1]}
        out.append(replace(solid, medium=replace(medium, **changes)))
    return out
