# SPDX-License-Identifier: GPL-3.0-or-later
"""Labels of points on stems that cover neither each other nor a point or stem: what finds no place is listed beside the axes."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

# Points from the marker, nearest first; 0 is right above it.
_PLACES = [(side * 9, rise) for rise in (6, 12, -6, 20, 34, -20, -34, 48, 62, 76) for side in (1, -1, 0) if side or rise > 9]
_MARKER = 8.0  # half its side, points
_LINES = 24  # of the list: as many as stand beside the axes
_PASSES = 4  # the list takes room from the axes, and fewer labels may fit then


def label(figure: Figure, axes, x, y, texts, size: float = 8) -> list[str]:
    """Label points, first ones first; returns what is listed beside the axes instead. Call it when all else is drawn."""
    canvas = FigureCanvasAgg(figure)
    beside = axes.text(1.01, 1.0, "", transform=axes.transAxes, fontsize=size - 0.5, va="top")
    notes, listed = [], None
    for _ in range(_PASSES):
        for note in notes:
            note.remove()
        figure.draw_without_rendering()
        notes, rest = _placed(axes, canvas.get_renderer(), x, y, texts, size)
        if rest == listed:
            break
        listed = rest
        more = [f"… and {len(rest) - _LINES} more"] if len(rest) > _LINES else []
        beside.set_text("\n".join(["not labelled:", *rest[:_LINES], *more] if rest else []))
    return rest


def _placed(axes, renderer, x, y, texts, size: float):
    """Annotations in the first free place of each, and the texts that have none."""
    frame = axes.get_window_extent(renderer)
    scale = axes.figure.dpi / 72
    points = axes.transData.transform(np.column_stack([x, y]))
    taken = [Bbox.from_extents(*(point - _MARKER * scale), *(point + _MARKER * scale)) for point in points]
    taken += [Bbox.from_extents(px - scale, frame.y0, px + scale, py) for px, py in points]
    notes, rest = [], []
    for (px, py), text in zip(zip(x, y, strict=True), texts, strict=True):
        for dx, dy in _PLACES:
            about = dict(
                ha="left" if dx > 0 else "right" if dx < 0 else "center", va="bottom" if dy > 0 else "top", fontsize=size
            )
            note = axes.annotate(text, (px, py), (dx, dy), textcoords="offset points", **about)
            box = note.get_window_extent(renderer)
            inside = frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1
            if inside and not any(box.overlaps(other) for other in taken):
                notes.append(note)
                taken.append(box)
                break
            note.remove()
        else:
            rest.append(text)
    return notes, rest
