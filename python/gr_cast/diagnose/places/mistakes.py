# SPDX-License-Identifier: GPL-3.0-or-later
"""What in a case looks like a slip of units or signs. It may be meant so: it is said, and refused by nobody."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...twin.places.document import Place
from ...twin.places.world import World
from . import policy
from .fit import evaluated


def of_units(place: Place) -> list[str]:
    """A sentence for each slip that the files alone show."""
    return [*_bands(place), *_mesh(place)]


def of_units_and_signs(place: Place, ears: Sequence, base: World) -> list[str]:
    """A sentence for each slip."""
    return [*of_units(place), *_signs(ears, base)]


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
    mesh_m = _wide_m([solid.vertices_m for solid in place.solids])
    nodes_m = _wide_m(
        [node.waypoints_m for node in place.spec.nodes] + [at_m for one in place.soundings for at_m in one.position_m.values()]
    )
    if mesh_m < policy.WIDE_MESH_M or mesh_m < policy.WIDE_MESH * nodes_m:
        return []
    return [f"The mesh is {mesh_m:g} m wide and all nodes stand within {nodes_m:g} m: is it in mm?"]


def _wide_m(points_m: list[np.ndarray]) -> float:
    return float(np.ptp(np.vstack(points_m), axis=0).max())


def _signs(ears: Sequence, base: World) -> list[str]:
    """Of enough responses that no displaced node looks like it."""
    told = [one for one in ears if one.has_responses]
    shapes = [one.heard.y.shape for one in told]
    if sum(links for links, *_ in shapes) < policy.TURNED_LINKS or max(shape[2] for shape in shapes) < policy.TURNED_TONES:
        return []
    count, as_told = sum(one.count for one in told), evaluated(told, base, ())
    if as_told.deviations(count) < policy.CLEAN_DEVIATIONS:
        return []
    otherwise = evaluated([replace(one, heard=replace(one.heard, y=np.conj(one.heard.y))) for one in told], base, ())
    if otherwise.left_nats(count) > policy.TURNED_SHARE * as_told.left_nats(count):
        return []
    return ["The conjugates of the responses fit the twin better: a delay τ turns a response by e^(−j2πfτ), not e^(+j2πfτ)."]
