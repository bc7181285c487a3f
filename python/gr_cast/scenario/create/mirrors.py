# SPDX-License-Identifier: GPL-3.0-or-later
"""Sampling where no ray tracer is installed: specular paths by mirror images, with what `trace` says of them.

Reflection and refraction alone, in double precision and without chance: also paths near corners, which rays miss.
"""

from collections.abc import Sequence

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S
from . import fields, images
from .geometry import Solid
from .trace import Settings, Task, Traced

PROCESSES = None  # as many as there are cores
NAME = "mirror images (no ray tracer is installed)"


def is_installed() -> bool:
    return True


def left_out(settings: Settings) -> str:
    """Mechanisms that are asked for and need the ray tracer; "" for none."""
    return ", ".join(name for name in ("diffraction", "scattering") if getattr(settings, name))


def run(solids: Sequence[Solid], settings: Settings, task: Task) -> Traced:
    """Trace one task's pairs. The same task gives the same table, wherever it runs."""
    tx, rx = np.array(task.pairs, np.int32).reshape(-1, 2).T
    faces = images.faces_of(solids, task.position_m, thick=settings.refraction)
    media = [solid.medium for solid in solids]
    surface = fields.surface_of(media, settings.carrier_hz, clear=settings.refraction, scatters=settings.scattering)
    tx_m, rx_m = task.position_m[tx], task.position_m[rx]
    paths = fields.unblocked(faces, images.search(faces, tx_m, rx_m, settings.max_depth), surface)
    way = fields.optics(faces, paths.faces, tx_m[paths.pair], rx_m[paths.pair])
    tx, rx = tx[paths.pair], rx[paths.pair]
    start, end = _sent(task, tx, way.direction[:, 0]), _sent(task, rx, -way.direction[:, -1])
    gain = fields.gains(faces, paths, way, surface, start, end, settings.carrier_hz)
    names = np.full((len(tx), max(settings.max_depth, 1)), -1, np.int32)
    names[:, : paths.faces.shape[1]] = paths.faces
    # A point of reflection makes the way stationary (Fermat): only the ends' own motion counts.
    rates = [
        ((speed[rx] * way.direction[:, -1]).sum(axis=1) - (speed[tx] * way.direction[:, 0]).sum(axis=1)) / SPEED_OF_LIGHT_M_PER_S
        for speed in (task.velocity_before, task.velocity_after)
    ]
    heard = gain != 0
    order = np.flatnonzero(heard)[np.lexsort((*names[heard].T[::-1], rx[heard], tx[heard]))]
    delay_s = way.length_m / SPEED_OF_LIGHT_M_PER_S
    columns = dict(tx=tx, rx=rx, surfaces=names, delay_s=delay_s, rate_before=rates[0], rate_after=rates[1], gain=gain)
    return Traced(**{name: values[order] for name, values in columns.items()})


def _sent(task: Task, nodes: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Field (n, 3) of each node's antenna along its direction."""
    turns = zip(task.antennas, task.orientation_rad, strict=True)
    antennas = [fields.Antenna(pattern=pattern, orientation_rad=tuple(turn)) for pattern, turn in turns]
    return fields.far_fields(antennas, nodes, direction)
