# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines of a mesh: the edges that one sees, and where a plane cuts it."""

import numpy as np

_ALIKE_M = 1e-4  # corners nearer than this are one
_FOLDED = 1e-3  # of the angle between faces that share an edge: less is one face
_CUT_M = 1e-9


def edges(corners_m: np.ndarray) -> np.ndarray:
    """(n, 2, 3): edges of triangles (m, 3, 3) at a border or a fold; what only splits a plane face is none."""
    normal = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    keys = np.round(corners_m / _ALIKE_M).astype(np.int64)
    met: dict = {}
    for number, triangle in enumerate(keys.tolist()):
        for i in range(3):
            a, b = tuple(triangle[i]), tuple(triangle[(i + 1) % 3])
            met.setdefault((min(a, b), max(a, b)), []).append(number)
    seen = [key for key, own in met.items() if len(own) == 1 or abs(normal[own[0]] @ normal[own[1]]) < 1 - _FOLDED]
    return np.array(seen, float).reshape(-1, 2, 3) * _ALIKE_M


def section(corners_m: np.ndarray, normal: int, cut_m: float) -> np.ndarray:
    """(n, 2, 3): where triangles (m, 3, 3) go through the plane in which one coordinate is `cut_m`."""
    found = []
    for triangle in corners_m:
        height = triangle[:, normal] - cut_m
        height = np.where(np.abs(height) < _CUT_M, _CUT_M, height)
        over = [(i, (i + 1) % 3) for i in range(3) if height[i] * height[(i + 1) % 3] < 0]
        if len(over) == 2:
            found.append([triangle[i] + (triangle[j] - triangle[i]) * height[i] / (height[i] - height[j]) for i, j in over])
    return np.array(found).reshape(-1, 2, 3)
