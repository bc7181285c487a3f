# SPDX-License-Identifier: GPL-3.0-or-later
"""Labels of points on stems that cover neither each other nor a point or stem: what finds no place is listed beside the axes.

A label stands beside its point, in two lines where one does not fit, or away from it with a line to it.
"""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

# Points from the marker, nearest first; 0 is right above it.
_BESIDE = [(9, 6), (-9, 6), (9, -6), (-9, -6), (0, 12)]
_AWAY = [(side * 9, rise) for rise in (20, 34, -20, -34, 48, 62, 76) for side in (1, -1, 0) if side or rise > 0]
_LINE = {"arrowstyle": "-", "color": "0.6", "linewidth": 0.6, "shrinkA": 0, "shrinkB": 5}
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


def _tries(text: str):
    """(dx, dy, what is shown, the line to its point) of a label, best first."""
    for places, line in ((_BESIDE, None), (_AWAY, _LINE)):
        for shown in (text, text.replace(", ", "\n", 1)):
            yield from ((dx, dy, shown, line) for dx, dy in places)


def _placed(axes, renderer, x, y, texts, size: float):
    """Annotations in the first free place of each, and the texts that have none."""
    frame = axes.get_window_extent(renderer)
    scale = axes.figure.dpi / 72
    points = axes.transData.transform(np.column_stack([x, y]))
    taken = [Bbox.from_extents(*(point - _MARKER * scale), *(point + _MARKER * scale)) for point in points]
    taken += [Bbox.from_extents(px - scale, frame.y0, px + scale, py) for px, py in points]
    notes, rest = [], []
    for (px, py), text in zip(zip(x, y, strict=True), texts, strict=True):
        for dx, dy, shown, line in _tries(text):
            about = dict(
                ha="left" if dx > 0 else "right" if dx < 0 else "center", va="bottom" if dy > 0 else "top", fontsize=size
            )
            note = axes.annotate(shown, (px, py), (dx, dy), textcoords="offset points", arrowprops=line, **about)
            note.update_positions(renderer)
            box = Text.get_window_extent(note, renderer)  # without its line
            inside = frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1
            if inside and not any(box.overlaps(other) for other in taken):
                notes.append(note)
                taken.append(box)
                break
            note.remove()
        else:
            rest.append(text)
    return notes, rest
