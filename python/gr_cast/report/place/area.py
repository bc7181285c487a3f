# SPDX-License-Identifier: GPL-3.0-or-later
"""Path loss from a node as an area, over the place from above."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ...scenario.create.area import Area
from ...scenario.create.geometry import Solid
from ..plot import colour_scale, new_figure
from .outline import edges

_OBJECT, _NODE = "#30343a", "#c2402e"


def figure(area: Area, solids: Sequence[Solid], title: str) -> Figure:
    """White is not heard; lines are the edges of all objects, whatever their height."""
    low, high = (np.array([bound(area.x_m), bound(area.y_m)]) for bound in (np.min, np.max))
    width, depth = high - low
    picture = new_figure(9.5, float(np.clip(8.0 * depth / width + 1, 3.5, 11)))
    axes = picture.subplots()
    image = axes.pcolormesh(
        area.x_m, area.y_m, area.loss_db, cmap="viridis_r", shading="nearest", **colour_scale(area.loss_db, 0.0)
    )
    picture.colorbar(image, ax=axes, label=f"path loss in {area.bandwidth_hz / 1e6:g} MHz (dB)", shrink=0.8)
    for solid in solids:
        for a, b in edges(solid.vertices_m[solid.faces]):
            axes.plot([a[0], b[0]], [a[1], b[1]], color=_OBJECT, linewidth=0.9)
    axes.plot(*area.sender_m[:2], marker="o", markersize=9, color=_NODE, markeredgecolor="white")
    axes.annotate(area.sender, area.sender_m[:2], xytext=(6, 6), textcoords="offset points", fontsize=9, weight="bold",
                  bbox=dict(facecolor="white", edgecolor="none", alpha=0.7, pad=1))  # fmt: skip
    margin = 0.02 * max(width, depth)
    axes.set(
        xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), xlabel="x, m", ylabel="y, m",
        aspect="equal",
    )  # fmt: skip
    axes.set_title(title, loc="left", fontsize=11)
    return picture
