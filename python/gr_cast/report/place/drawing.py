# SPDX-License-Identifier: GPL-3.0-or-later
"""Plan and section of a place as SVG: what stands there, who sounded what, how well it is explained, every cause where it is."""

from dataclasses import dataclass
from html import escape

import numpy as np

from .marks import Mark
from .outline import edges, section

WIDTH, MARGIN = 860.0, 38.0  # of a drawing, in its own units
_MOST_HEIGHT = 620.0
_RAMP = ((59, 122, 87), (224, 180, 0), (196, 60, 30), (90, 10, 70))  # from noise alone to the worst
_ENLARGED = (1, 2, 5, 10, 20, 50, 100, 200, 500)  # of arrows that would be too short to see
_SEEN_PX, _LONG_PX = 34.0, 90.0
_FLAT_M = 0.01
_LEVEL = 0.7  # of a normal's height: above, a plane lies


@dataclass(frozen=True, kw_only=True)
class Projection:
    """`axes` of the place that are drawn to the right and up; the third is looked along, and a section cuts it at `cut_m`."""

    name: str
    axes: tuple[int, int]
    low_m: np.ndarray  # (2,)
    per_m: float
    height: float
    cut_m: float | None = None

    @property
    def normal(self) -> int:
        return 3 - sum(self.axes)

    def __call__(self, points_m) -> np.ndarray:
        """(n, 2) in units of the drawing."""
        flat = np.atleast_2d(points_m)[:, self.axes] - self.low_m
        return np.round(flat * [self.per_m, -self.per_m] + [MARGIN, self.height - MARGIN], 1)

    def vector(self, vector_m) -> np.ndarray:
        return np.asarray(vector_m, float)[list(self.axes)] * [self.per_m, -self.per_m]


def projections(scene, marks: list[Mark]) -> tuple[Projection, Projection]:
    """The plan, and the section along the longer side, or across what leans the other way; it cuts where the first cause is."""
    span = scene.high_m - scene.low_m
    first = next((mark for mark in marks if mark.has_place), None)
    along = int(span[1] > span[0])
    if first is not None and first.band_m is not None and abs(first.band_m[2]) < _LEVEL * np.linalg.norm(first.band_m):
        along = int(np.argmax(np.abs(first.band_m[:2])))
    nodes_m = np.mean([line.ends_m[0].mean(axis=0) for line in scene.lines], axis=0) if scene.lines else scene.low_m + span / 2
    cut_m = float((nodes_m if first is None else first.at_m)[1 - along])
    return _projection("plan", (0, 1), scene, None), _projection("section", (along, 2), scene, cut_m)


def _projection(name: str, axes, scene, cut_m) -> Projection:
    low, span = scene.low_m[list(axes)], np.maximum((scene.high_m - scene.low_m)[list(axes)], 1.0)
    low, span = low - 0.04 * span.max(), span + 0.08 * span.max()
    per_m = min((WIDTH - 2 * MARGIN) / span[0], (_MOST_HEIGHT - 2 * MARGIN) / span[1])
    low = low - [((WIDTH - 2 * MARGIN) / per_m - span[0]) / 2, 0.0]  # in the middle
    return Projection(name=name, axes=axes, low_m=low, per_m=per_m, height=float(span[1] * per_m + 2 * MARGIN), cut_m=cut_m)


def colour(misfit_db: float, worst_db: float) -> str:
    """Of residual over noise: green is noise alone."""
    x = float(np.clip(misfit_db / worst_db, 0, 1)) * (len(_RAMP) - 1)
    i = min(int(x), len(_RAMP) - 2)
    return "#" + "".join(f"{round(a + (b - a) * (x - i)):02x}" for a, b in zip(_RAMP[i], _RAMP[i + 1], strict=True))


def ramp() -> str:
    return "linear-gradient(90deg," + ",".join(f"rgb{one}" for one in _RAMP) + ")"


def drawing(scene, marks: list[Mark], seen: Projection, corrected: bool, sound_next: list) -> str:
    """One view, of the twin or of the corrected twin."""
    parts = [_objects(scene, marks, seen), _grid(scene, seen), _lines(scene, marks, seen, corrected), _nodes(scene, marks, seen)]
    parts += [_mark(mark, scene, seen) for mark in marks]
    parts += [_target(place, number, seen) for number, place in enumerate(sound_next, 1)]
    state = "after" if corrected else "before"
    said = f"{seen.name} of the place, links coloured by what the {'corrected twin' if corrected else 'twin'} leaves unexplained"
    return (
        f'<svg class="view {state}" data-view="{seen.name}" viewBox="0 0 {WIDTH:g} {seen.height:.1f}" role="img" '
        f'aria-label="{said}">{"".join(parts)}</svg>'
    )


def _way(points, closed: bool = True) -> str:
    return "M" + "L".join(f"{x:g} {y:g}" for x, y in points) + ("Z" if closed else "")


def _objects(scene, marks, seen: Projection) -> str:
    blamed = {name for mark in marks for name in mark.objects}
    mesh, shapes = scene.base.mesh, []
    floors = {solid.name for solid in mesh.solids if _is_floor(solid, scene)}
    for solid in sorted(mesh.solids, key=lambda one: one.name not in floors):
        if (solid.vertices_m.min(axis=0) > scene.high_m).any() or (solid.vertices_m.max(axis=0) < scene.low_m).any():
            continue
        state = "lit" if solid.name in scene.lit else "shading" if solid.name in scene.shading else "dark"
        flat = solid.name in floors and seen.cut_m is None
        medium = scene.base.media.get(solid.name)
        made = medium.material.replace("_", " ") if medium is not None and medium.material else "a material of its own"
        told = {
            "lit": "paths meet it",
            "shading": "only stands in the way of paths",
            "dark": "no path meets it: nothing is known",
        }
        title = f"<title>{escape(solid.name)}: {escape(made)}; {told[state]}</title>"
        kind = f"object {state}{' floor' if flat else ''}{' blamed' if solid.name in blamed else ''}"
        corners = solid.vertices_m[solid.faces]
        outline = "" if flat and solid.name not in blamed else "".join(_way(seen(edge), closed=False) for edge in edges(corners))
        beyond = "" if seen.cut_m is None else " beyond"
        shapes.append(f'<path class="{kind} fill{beyond}" d="{_filled(corners, seen)}">{title}</path>')
        shapes.append(f'<path class="{kind} edge{beyond}" d="{outline}">{title}</path>' if outline else "")
        if seen.cut_m is not None:
            cut = "".join(_way(seen(part), closed=False) for part in section(corners, seen.normal, seen.cut_m))
            shapes.append(f'<path class="{kind} cut" d="{cut}">{title}</path>' if cut else "")
    return "".join(shapes)


def _is_floor(solid, scene) -> bool:
    """Level sheets as wide as half of what is shown would hide all else in the plan."""
    span = np.ptp(solid.vertices_m, axis=0)
    return bool(span[2] < _FLAT_M and np.prod(span[:2]) > 0.5 * np.prod((scene.high_m - scene.low_m)[:2]))


def _filled(corners, seen: Projection) -> str:
    """Triangles all one way round, or front and back would cancel."""
    flat = np.array([seen(one) for one in corners])
    turn = np.diff(flat, axis=1)
    wrong = turn[:, 0, 0] * turn[:, 1, 1] - turn[:, 0, 1] * turn[:, 1, 0] < 0
    flat[wrong] = flat[wrong, ::-1]
    return "".join(_way(one) for one in np.unique(flat, axis=0))


def _grid(scene, seen: Projection) -> str:
    """Ticks in metres along two sides."""
    low, high = scene.low_m[list(seen.axes)], scene.high_m[list(seen.axes)]
    out = []
    for side, span in enumerate(np.maximum(high - low, 1.0)):
        step = 10.0 ** np.floor(np.log10(span / 2))
        step = step if span / step < 8 else 2.5 * step
        for value in np.arange(np.ceil(low[side] / step) * step, high[side] + 1e-9, step):
            x, y = (value - seen.low_m[side]) * seen.per_m * np.array([1, -1]) + [MARGIN, seen.height - MARGIN]
            if side == 0:
                out.append(f'<path class="tick" d="M{x:.1f} {seen.height - 20}v-6"/><text x="{x:.1f}" y="{seen.height - 8}" ')
                out.append(f'text-anchor="middle">{value:g}</text>')
            else:
                out.append(
                    f'<path class="tick" d="M20 {y:.1f}h6"/><text x="17" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>'
                )
    names = ["xyz"[axis] for axis in seen.axes]
    out.append(f'<text x="{WIDTH - 14}" y="{seen.height - 8}" text-anchor="end">{names[0]} / m</text>')
    out.append(f'<text x="4" y="14">{names[1]} / m</text>')
    cut = "" if seen.cut_m is None else f"cut at {'xyz'[seen.normal]} = {seen.cut_m:.1f} m; thick: what is cut"
    out.append(f'<text x="{WIDTH - 14}" y="14" text-anchor="end">{seen.name} {cut}</text>')
    return f'<g class="axes">{"".join(out)}</g>'.replace("-0<", "0<")


def _lines(scene, marks, seen: Projection, corrected: bool) -> str:
    blamed, out = {name for mark in marks for name in mark.links}, []
    for line in scene.lines:
        (x1, y1), (x2, y2) = seen(line.ends_m[corrected])
        before, after = line.misfit_db
        kind = f"link{' vault' if line.is_vault else ''}{' blamed' if line.name in blamed else ''}"
        said = f"{line.name.replace('>', ' → ')}: {before:.1f} dB over noise, {after:.1f} dB when corrected"
        said += " (vault)" if line.is_vault else ""
        out.append(
            f'<line class="{kind}" data-link="{escape(line.name)}" x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}" '
            f'stroke="{colour(line.misfit_db[corrected], scene.worst_db)}"><title>{escape(said)}</title></line>'
        )
    return "".join(out)


def _nodes(scene, marks, seen: Projection) -> str:
    blamed, out = {name for mark in marks for name in mark.nodes}, []
    for name, track_m in scene.tracks_m.items():
        track = seen(track_m)
        if len(track) > 1:
            out.append(f'<path class="track" d="{_way(track, closed=False)}"/>')
        x, y = track[0]
        ring = f'<circle class="ring" cx="{x:g}" cy="{y:g}" r="10"/>' if name in blamed else ""
        title = f"<title>{escape(name)}: {escape(scene.base.radios[name].node.antenna)}</title>"
        out.append(f'<g class="node">{ring}<circle cx="{x:g}" cy="{y:g}" r="5">{title}</circle>')
        out.append(f'<text x="{x + 8:g}" y="{y - 7:g}">{escape(name)}</text></g>')
    return "".join(out)


def _mark(mark: Mark, scene, seen: Projection) -> str:
    out, place = [], None if not mark.has_place else seen(mark.at_m)[0]
    if place is None:
        return ""
    if mark.plane_m is not None:
        if (2 * seen.per_m * np.linalg.norm(mark.band_m[list(seen.axes)])) > 2:
            both = np.concatenate([mark.plane_m + mark.band_m, mark.plane_m - mark.band_m])
            out.append(f'<path class="unsure" d="{_way(_hull(seen(both)))}"/>')
        level = " level" if abs(mark.band_m[2]) > _LEVEL * np.linalg.norm(mark.band_m) else ""
        out.append(f'<path class="plane{level}" d="{_way(seen(mark.plane_m))}"/>')
    if mark.track_m is not None:
        start, end = seen(mark.track_m)
        out += [_ellipse(start, 2 * np.abs(seen.vector(mark.track_std_m))), _arrow(start, end)]
    if mark.arrow_m is not None:
        out.append(_offset(mark, place, seen))
    if mark.turn_rad is not None and seen.cut_m is None:
        for yaw, kind in zip(mark.turn_rad, ("was", "is"), strict=True):
            end = place + 46 * np.array([np.cos(yaw), -np.sin(yaw)])
            out.append(f'<g class="{kind}">{_arrow(place, end)}</g>')
    x, y = place + [0, -20 if mark.plane_m is None else 0]
    out.append(
        f'<circle class="number" cx="{x:g}" cy="{y:g}" r="9"/><text class="number" x="{x:g}" y="{y + 4:g}">{mark.number}</text>'
    )
    return f'<g class="mark" data-mark="{mark.number}"><title>{escape(mark.title)}</title>{"".join(out)}</g>'


def _offset(mark: Mark, place, seen: Projection) -> str:
    """The arrow of an offset and two deviations at its tip, both enlarged alike where they would not be seen, and told so."""
    long = float(np.linalg.norm(seen.vector(mark.arrow_m)))
    whole = seen.per_m * float(np.linalg.norm(mark.arrow_m))
    times = next((n for n in _ENLARGED if whole * n >= _SEEN_PX), _ENLARGED[-1])
    if long * times < 4:
        return ""
    tip = place + times * seen.vector(mark.arrow_m)
    radius = np.minimum(2 * times * np.abs(seen.vector(mark.arrow_std_m)), 4 * _LONG_PX)
    said = f'<text class="times" x="{tip[0] + 6:.1f}" y="{tip[1] + 14:.1f}">× {times}</text>' if times > 1 else ""
    return _ellipse(tip, radius) + _arrow(place, tip) + said


def _arrow(start, end) -> str:
    way = np.asarray(end, float) - start
    unit = way / max(float(np.linalg.norm(way)), 1e-9)
    side = np.array([-unit[1], unit[0]])
    head = [end, end - 9 * unit + 4.5 * side, end - 9 * unit - 4.5 * side]
    return f'<path class="arrow" d="{_way([start, end], closed=False)}"/><path class="head" d="{_way(np.round(head, 1))}"/>'


def _ellipse(centre, radius) -> str:
    rx, ry = np.maximum(radius, 1.0)
    return f'<ellipse class="unsure" cx="{centre[0]:.1f}" cy="{centre[1]:.1f}" rx="{rx:.1f}" ry="{ry:.1f}"/>'


def _target(place_m, number: int, seen: Projection) -> str:
    x, y = seen(np.array(place_m))[0]
    cross = f"M{x - 14:g} {y:g}h28M{x:g} {y - 14:g}v28"
    return (
        f'<g class="target"><title>sound here next</title><circle cx="{x:g}" cy="{y:g}" r="9"/><path d="{cross}"/>'
        f'<text x="{x + 12:g}" y="{y + 18:g}">sound here next</text></g>'
    )


def _hull(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull, in order (Andrew 1979)."""
    points = np.unique(points, axis=0)
    chains = []
    for ordered in (points, points[::-1]):
        chain: list = []
        for point in ordered:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= 0:
                chain.pop()
            chain.append(point)
        chains += chain[:-1]
    return np.array(chains) if chains else points


def _turn(a, b, c) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
