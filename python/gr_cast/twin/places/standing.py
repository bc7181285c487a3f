# SPDX-License-Identifier: GPL-3.0-or-later
"""Where one more radio may stand."""

import numpy as np

from ...scenario.create.geometry import inside, is_closed
from .world import World

APART_M = 0.3  # from nodes


def standing(world: World, points_m: np.ndarray) -> np.ndarray:
    """(n,) bool of points (n, 3): in the rooms that hold all nodes, outside other objects, away from nodes."""
    nodes_m = np.concatenate([radio.node.waypoints_m for radio in world.radios.values()])
    apart = np.linalg.norm(points_m[:, None] - nodes_m, axis=2).min(axis=1) > APART_M
    hulls = [solid for solid in world.mesh.solids if is_closed(solid)]
    rooms = [inside(solid, nodes_m).all() for solid in hulls]
    good = np.all([inside(solid, points_m) == room for solid, room in zip(hulls, rooms, strict=True)], axis=0)
    return apart & good
