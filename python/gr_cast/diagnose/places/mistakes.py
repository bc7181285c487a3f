# SPDX-License-Identifier: GPL-3.0-or-later
"""What in a case looks like a slip of units or signs. It may be meant so: it is said, and refused by nobody."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...twin.places.document import Place
from ...twin.places.world import World
from . import policy
from .fit import evaluated


def of_units_and_signs(place: Place, ears: Sequence, base: World) -> list[str]:
    """A sentence for each slip."""
    return [*_bands(place), *_mesh(place), *_signs(ears, base)]


def _bands(place: Place) -> list[str]:
    return [
        f"{one.file}: frequency_hz spans {np.ptp(one.frequency_hz):g} Hz and the SPEC's band {place.spec.bandwidth_hz:g} Hz: "
        "is it in kHz or MHz?"
        for one in place.soundings
        if one.kind == "response"
        and one.frequency_hz.size > 1
        and np.ptp(one.frequency_hz) < policy.NARROW_BAND * place.spec.bandwidth_hz
    ]


def _mesh(place: Place) -> list[str]:
    mesh_m = float(np.ptp(np.vstack([solid.vertices_m for solid in place.solids]), axis=0).max())
    nodes_m = float(np.ptp(np.vstack([node.waypoints_m for node in place.spec.nodes]), axis=0).max())
    if mesh_m < policy.WIDE_MESH_M or mesh_m < policy.WIDE_MESH * nodes_m:
        return []
    return [f"The mesh is {mesh_m:g} m wide and all nodes stand within {nodes_m:g} m: is it in mm?"]


def _signs(ears: Sequence, base: World) -> list[str]:
    responses = [one for one in ears if one.has_responses]
    if not responses:
        return []
    turned = [replace(one, heard=replace(one.heard, y=np.conj(one.heard.y))) for one in responses]
    as_told = evaluated(responses, base, ())
    if as_told.deviations(sum(one.count for one in responses)) < policy.CLEAN_DEVIATIONS:
        return []
    if evaluated(turned, base, ()).energy > policy.TURNED_SHARE * as_told.energy:
        return []
    return ["The conjugates of the responses fit the twin better: a delay τ turns a response by e^(−j2πfτ), not e^(+j2πfτ)."]
