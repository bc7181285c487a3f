# SPDX-License-Identifier: GPL-3.0-or-later
"""A room's scenario in closed form, where there is no ray tracer: the mirror images of a box (Allen & Berkley 1979).

The box is the bounding box of the SPEC's mesh, each side of the material that covers most of it. What stands in the room
is left out, antennas are isotropic and vertically polarised, and a reflection is that of a half-space: TM on floor and
ceiling, TE on the walls. It is a stand-in for `cast_scenario.py create`, and says so in its name.
"""

import itertools

import numpy as np

from ...core.errors import CastError
from ...core.units import SPEED_OF_LIGHT_M_PER_S, db_from_amplitude
from ..model import LinkTaps, Scenario, reciprocal
from . import materials, mesh_files
from .geometry import Solid, areas_m2, bounds_m
from .media import Medium
from .nodes import Node, position_m, velocity_m_per_s
from .paths import LinkPaths, at
from .reduce import Job, reduce
from .spec import Spec

TRACE_STEP_S = 0.03
PLACE_STEP_S = 4e-3  # of the unreduced paths: linear in between, −38 dB from the truth at 10 Hz of Doppler
_FLAT_M = 1e-6


def fresnel(eta: complex, cosine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """TE and TM reflection of a half-space at incidence `cosine` (ITU-R P.2040-3, eqs. 31a and 31b)."""
    root = np.sqrt(eta - (1 - cosine**2))
    return (cosine - root) / (cosine + root), (eta * cosine - root) / (eta * cosine + root)


def box(solids: list[Solid], carrier_hz: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lowest and highest corner (3,) of a place in m, and the permittivity (3, 2) of its sides, low and high per axis."""
    low, high = bounds_m(solids)
    eta = np.empty((3, 2), complex)
    for axis, side in itertools.product(range(3), range(2)):
        limit = (low, high)[side][axis]
        cover: dict[Medium, float] = {}
        for solid in solids:
            on = np.abs(solid.vertices_m[solid.faces][:, :, axis] - limit).max(axis=1) < _FLAT_M
            area = float(areas_m2(solid.vertices_m, solid.faces[on]).sum())
            cover[solid.medium] = cover.get(solid.medium, 0.0) + area
        medium, area = max(cover.items(), key=lambda item: item[1])
        if area == 0:
            raise CastError(f"room: nothing lies in its {'low' if side == 0 else 'high'} side across {'xyz'[axis]}: no box")
        eta[axis, side] = medium.complex_permittivity(carrier_hz)
    return low, high, eta


def _images(order: int):
    """Per path: which mirror (n, p) along each axis, (P, 3) each: image at 2·n·L + (−1)^p·s, hits |n − p| low, |n| high."""
    axis = [(n, p) for n in range(-order, order + 1) for p in (0, 1) if abs(n) + abs(n - p) <= order]
    chosen = [
        combination
        for combination in itertools.product(axis, repeat=3)
        if sum(abs(n) + abs(n - p) for n, p in combination) <= order
    ]
    return np.moveaxis(np.array(chosen), 2, 0)


def link_paths(spec: Spec, solids: list[Solid], fixed: Node, other: Node, time_s: np.ndarray, order: int) -> LinkPaths:
    """All paths of up to `order` reflections between a fixed node and another one at the instants `time_s` (S,)."""
    if fixed.is_moving:
        raise CastError(f"room: link {fixed.name}>{other.name}: node {fixed.name} moves, one of the two must stand still")
    low, high, eta = box(solids, spec.carrier_hz)
    n, p = _images(order)
    source = position_m(fixed, np.zeros(1))[0] - low
    image_m = 2 * n * (high - low) + np.where(p == 0, 1, -1) * source + low  # (P, 3)
    times_s = time_s if other.is_moving else np.zeros(1)
    way_m = position_m(other, times_s)[:, None, :] - image_m  # (S, P, 3)
    length_m = np.linalg.norm(way_m, axis=2)
    cosine = np.abs(way_m) / length_m[:, :, None]
    gain = SPEED_OF_LIGHT_M_PER_S / spec.carrier_hz / (4 * np.pi * length_m) + 0j
    for axis in range(3):
        for side, hits in ((0, np.abs(n - p)), (1, np.abs(n))):
            te, tm = fresnel(eta[axis, side], cosine[:, :, axis])
            gain *= (tm if axis == 2 else te) ** hits[:, axis]
    rates = [
        np.einsum("sk,spk->sp", velocity_m_per_s(other, times_s, edge), way_m) / length_m / SPEED_OF_LIGHT_M_PER_S
        for edge in ("left", "right")
    ]
    delay_s = length_m / SPEED_OF_LIGHT_M_PER_S
    return LinkPaths(time_s=times_s, delay_s=delay_s, rate_before=rates[0], rate_after=rates[1], gain=gain)


def walking_on(node: Node, duration_s: float) -> Node:
    """A moving node that turns round at either end of its way until `duration_s` is over."""
    if not node.is_moving:
        return node
    there = node.waypoints_m
    leg_s = np.linalg.norm(np.diff(there, axis=0), axis=1).sum() / node.speed_m_per_s
    legs = [there]
    while len(legs) * leg_s < duration_s:
        legs.append(there[::-1][1:] if len(legs) % 2 else there[1:])
    return Node(**{**node.__dict__, "waypoints_m": np.concatenate(legs)})


def scenario(spec: Spec, pairs: list[tuple[str, str]], duration_s: float, *, order: int = 2, four_taps: bool = True) -> Scenario:
    """The links between `pairs` of (standing, any) nodes, both ways, moving nodes walking on for `duration_s`.

    `four_taps`: reduced as `cast_scenario.py create` does, at 1 ms; otherwise every path at its true delay.
    """
    solids = materials.assign(mesh_files.read(spec.model_path), spec.materials, spec.carrier_hz)
    nodes = {node.name: walking_on(node, duration_s) for node in spec.nodes}
    traced_s = np.append(np.arange(0, duration_s, TRACE_STEP_S), duration_s)
    step_s = spec.update_s if four_taps else PLACE_STEP_S
    clock_s = np.arange(round(duration_s / step_s) + 1) * step_s
    traced_s[-1] = max(traced_s[-1], clock_s[-1])
    links = {}
    for a, b in pairs:
        paths = link_paths(spec, solids, nodes[a], nodes[b], traced_s, order)
        if four_taps:
            about = dict(carrier_hz=spec.carrier_hz, bandwidth_hz=spec.bandwidth_hz, method=spec.method, hold_s=spec.hold_s)
            reduced = reduce(Job(link=paths, clock_s=clock_s, **about))
            delay_s, gain = reduced.delay_s, reduced.gain
        else:
            delay_s, gain = at(paths, clock_s if len(paths.time_s) > 1 else np.zeros(1), spec.carrier_hz)
        links[a, b] = LinkTaps(delay_s=delay_s, gain=gain)
    strongest = max(np.abs(taps.gain).max() for taps in links.values())
    links = {key: LinkTaps(delay_s=taps.delay_s, gain=taps.gain / strongest) for key, taps in links.items()}
    kind = "four taps" if four_taps else "all paths"
    return Scenario(
        name=f"{spec.id}, closed form, {kind}",
        description=f"{spec.name}: an empty box by mirror images of up to {order} reflections, not ray-traced; {kind}.",
        nodes=tuple(dict.fromkeys(node for pair in pairs for node in pair)),
        links=reciprocal(links),
        time_s=clock_s,
        interpolation="hold" if four_taps else "linear",
        center_frequency_hz=spec.carrier_hz,
        base_loss_db=-float(db_from_amplitude(strongest)),
    )
