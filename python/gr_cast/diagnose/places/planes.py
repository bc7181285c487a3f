# SPDX-License-Identifier: GPL-3.0-or-later
"""From residual echoes to rectangles: an image of all planes, coherent refinement of the best, extent by who sees them."""

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S, db_from_amplitude
from ...scenario.create import fields
from ...scenario.create.geometry import MAX_COORDINATE_M
from ...twin.places.families.additions import Sheet, across
from . import imaging
from .coherent import Phased

_AZIMUTHS = 90  # of upright planes
_IMAGED, _ALIGNED, _KEPT = 4, 4, 5  # planes that are refined: of the image, of those that stand as something does; and returned
_NORMALS = 8  # of what stands there that are looked along: those of the largest faces
_ALIKE_COS = np.cos(np.radians(1))  # of normals that are one
_NARROW_M = 0.3  # less is no wall
_LEANING = np.sin(np.radians(1))  # more, and a wall is not upright
_ROWS, _SUMS = 200, 5_000_000  # of a coherent sum along a normal, and rows times levels
_WELLS = 8  # levels to a wavelength
_WIDE = 2  # of them that are tried as wide as the place as well
_APART_M, _LEAST_M = 0.5, 0.01  # of planes along a normal that are not one; of those that are
_BEYOND_M = 10.0  # of the place, where planes are looked for
_LEVELS, _PHASED_LEVELS = 800, 80_000  # along a normal, at most: of the image, and where phases count
_SHIFTS, _TURNS = 240, 41  # of the coherent grid, at most
_GRID_SUMS = 600_000  # rows times planes of it
_SEEN_NATS = 4.0  # of a row that a plane is fitted to
_TURNED_RAD = np.radians(4)  # by which a plane may be from where an image has it
_LONE_SHARE = 0.25  # of what is left above noise, that one row's echo must hold to be looked for alone
_MARGIN_M = 1.5  # beyond the outermost point that is lit, where nothing says that it ends
_FARTHEST_M = MAX_COORDINATE_M / 2  # of a corner: a fit may still move it


def sheets(view) -> list[Sheet]:
    """Rectangles that would explain echoes in the residual, the best first."""
    if not view.echoes:
        return []
    found = [_refined(view, *plane, _TURNED_RAD) for plane in _imaged(view)] + [
        _refined(view, *plane, 0.0) for plane in _aligned(view)
    ]
    refined = sorted((one for one in found if one is not None), key=lambda pair: -pair[0])
    out: list[Sheet] = []
    for _, sheet in refined:
        if not any(_is_same(sheet, other) for other in out):
            out.append(sheet)
    return [*(sheet.through(*view.bounds_m) for sheet in out[:_WIDE]), *out[:_KEPT]]


def lone(view) -> tuple[int, list[Sheet]]:
    """The link whose echo alone is a good part of what is left, and rectangles that stand as something does and would send it: no
    other link says more of them than that it sees none."""
    if not view.wideband:
        return 0, []
    rows, count = view.phased, view.count
    nats, length_m = rows.every_nats(), rows.length_m
    direct_m = np.linalg.norm(rows.tx_m - rows.rx_m, axis=1)
    nats[length_m < direct_m[:, None] + view.resolution_m / 4] = 0.0  # there the direct path's own errors are
    row, at = np.unravel_index(np.argmax(nats), nats.shape)
    if nats[row, at] < max(_SEEN_NATS, _LONE_SHARE * view.model.left_nats(count)):
        return 0, []
    out = []
    for normal in normals(view.world.faces):
        before, after = rows.tx_m[row] @ normal, rows.rx_m[row] @ normal
        beyond_m = np.sqrt((before - after) ** 2 + length_m[at] ** 2 - direct_m[row] ** 2) / 2
        for level_m in ((before + after) / 2 + beyond_m, (before + after) / 2 - beyond_m):
            refined = _refined(view, normal, float(level_m), 0.0, least=1)
            out += [refined[1]] if refined else []
    return int(rows.link[row]), out


def gaps(view) -> list[Sheet]:
    """Rectangles between corners of what the twin has, and the same as wide as the place: rooms are closed, and houses stand in a
    row. Planes that stand as something in the twin does, or lie level."""
    corners_m = np.concatenate([solid.vertices_m for solid in view.world.mesh.solids])
    out = []
    for normal in normals(view.world.faces):
        level_m = corners_m @ normal
        order = np.argsort(level_m)
        for own in np.split(order, 1 + np.flatnonzero(np.diff(level_m[order]) > _LEAST_M)):
            on_plane_m = corners_m[own] - (level_m[own] - level_m[own].mean())[:, None] * normal
            sheet = Sheet.about(on_plane_m, normal)
            if min(np.subtract(sheet.high_m, sheet.low_m)) > _NARROW_M:
                out += dict.fromkeys([sheet, sheet.through(*view.bounds_m)])
    return out


def _is_same(one: Sheet, other: Sheet) -> bool:
    normal = np.array(one.normal)
    apart_m = (np.array(other.origin_m) - one.origin_m) @ normal
    return bool(abs(normal @ other.normal) > _ALIKE_COS and abs(apart_m) < _LEAST_M)


def _levels_m(view, normal: np.ndarray, step_m: float, most: int) -> np.ndarray:
    """Of planes with a normal, through the place and somewhat beyond."""
    low, high = view.bounds_m
    reach_m = float(np.linalg.norm(high - low)) / 2 + _BEYOND_M
    return np.arange(-reach_m, reach_m, max(step_m, 2 * reach_m / most)) + normal @ (low + high) / 2


def _imaged(view) -> list[tuple[np.ndarray, float]]:
    """Normals and levels of upright and level planes at whose delays echoes are, the best first."""
    resolution_m = SPEED_OF_LIGHT_M_PER_S / view.echoes[0].bins_per_s
    azimuth = np.arange(_AZIMUTHS) * np.pi / _AZIMUTHS
    upright = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(_AZIMUTHS)])
    normals = [*upright, np.array([0.0, 0.0, 1.0])]
    levels = np.array([_levels_m(view, normal, resolution_m / 2, _LEVELS) for normal in normals])
    if levels.shape[1] < 2:  # the band is too narrow for any delay within the place
        return []
    repeated = np.repeat(normals, levels.shape[1], axis=0)
    image = imaging.plane_scores(view.echoes, repeated, levels.ravel()).reshape(levels.shape)
    near = max(int(np.ceil(1.0 / (levels[0, 1] - levels[0, 0]))), 2)
    found = []
    for _ in range(_IMAGED):
        a, d = np.unravel_index(np.argmax(image), image.shape)
        if image[a, d] < _SEEN_NATS:
            break
        found.append((normals[a], float(levels[a, d])))
        turned = range(max(a - 4, 0), min(a + 5, _AZIMUTHS)) if a < _AZIMUTHS else [a]
        image[turned, max(d - near, 0) : d + near + 1] = -np.inf
    return found


def _aligned(view) -> list[tuple[np.ndarray, float]]:
    """Normals and levels of planes that stand as something in the twin does, or lie level, whose echoes come in phase, the best
    first: where delays tell nothing apart, phases do."""
    world, found = view.world, []
    for normal in normals(world.faces):
        levels_m = _levels_m(view, normal, world.wavelength_m / _WELLS, _PHASED_LEVELS)
        nats = view.phased.thinned(min(_ROWS, _SUMS // len(levels_m))).nats_along(normal, levels_m)
        for _ in range(_ALIGNED):
            best = int(np.argmax(nats))
            found.append((float(nats[best]), normal, float(levels_m[best])))
            nats[np.abs(levels_m - levels_m[best]) < _APART_M] = -np.inf
    found.sort(key=lambda one: -one[0])
    return [(normal, level_m) for _, normal, level_m in found[:_ALIGNED]]


def normals(faces) -> list[np.ndarray]:
    """Of level planes, of the largest upright faces, and square to these, signs aside."""
    out = [np.array([0.0, 0.0, 1.0])]
    area_m2 = np.add.reduceat(faces.triangle_areas_m2, faces.start[:-1])
    for number in np.argsort(-area_m2, kind="stable"):
        x, y, z = faces.normal[number]
        for normal in (np.array([x, y, z]), np.array([-y, x, 0.0])) if abs(z) < _LEANING else ():
            if len(out) < _NORMALS and all(abs(normal @ other) < _ALIKE_COS for other in out):
                out.append(normal)
    return out


def _refined(view, normal: np.ndarray, level_m: float, most_rad: float, least: int = 2):
    """(nats, sheet) of the best rectangle near a plane; None where nothing coherent is there, in so many rows at least, or it is
    farther than objects may be."""
    rows = view.phased
    length_m, met, good = imaging.mirrored((rows.tx_m, rows.rx_m), normal, level_m)
    strong = good & (rows.alone_nats(length_m) > _SEEN_NATS)
    if strong.sum() < least:
        return None
    u, v = across(normal)
    origin = met[strong].mean(axis=0)
    origin = origin - (origin @ normal - level_m) * normal
    span_m = max(float(np.ptp((met[strong] - origin) @ u)), 1.0)
    shift_m, turn_rad = _coherent(view, rows.taken(strong), origin, normal, u, span_m, most_rad)
    tilted, along = np.cos(turn_rad) * normal - np.sin(turn_rad) * u, np.cos(turn_rad) * u + np.sin(turn_rad) * normal
    origin = origin + shift_m * normal
    gain_nats = rows.row_nats(tilted, float(origin @ tilted), strong)
    _, met, good = imaging.mirrored((rows.tx_m, rows.rx_m), tilted, origin @ tilted)
    box = rectangle(np.column_stack([(met - origin) @ along, (met - origin) @ v])[good], gain_nats[good])
    if box is None:
        return None
    nats, low, high = box
    sheet = Sheet(
        origin_m=tuple(origin), normal=tuple(tilted), u=tuple(along), v=tuple(v), low_m=tuple(low), high_m=tuple(high)
    )  # fmt: skip
    return (nats, sheet) if np.abs(sheet.corners_m()).max() < _FARTHEST_M else None


def _coherent(view, rows: Phased, origin, normal, u, span_m: float, most_rad: float) -> tuple[float, float]:
    """Shift along the normal and turn about the other axis with most nats near a plane."""
    wavelength_m = view.world.wavelength_m
    resolution_m = SPEED_OF_LIGHT_M_PER_S / view.echoes[0].bins_per_s * 8
    half_m = min(resolution_m / 3, _SHIFTS / 2 * wavelength_m / 10)
    shifts_m = np.arange(-half_m, half_m + 1e-9, wavelength_m / 10)
    turns_rad = wavelength_m / 6 / span_m * np.arange(-(_TURNS // 2), _TURNS // 2 + 1)
    turns_rad, shifts_m = (one.ravel() for one in np.meshgrid(turns_rad[np.abs(turns_rad) <= most_rad], shifts_m, indexing="ij"))
    normals = np.cos(turns_rad)[:, None] * normal - np.sin(turns_rad)[:, None] * u
    levels_m = normals @ origin + shifts_m * (normals @ normal)
    best = int(np.argmax(rows.thinned(min(_ROWS, _GRID_SUMS // len(levels_m))).nats(normals, levels_m)))
    return float(shifts_m[best]), float(turns_rad[best])


def rectangle(places: np.ndarray, nats: np.ndarray):
    """(nats, low, high) of the rectangle with most nats in it, its edges half-way to the next row that does not see it."""
    lit = nats > _SEEN_NATS
    if not lit.any():
        return None
    low, high = places[lit].min(axis=0), places[lit].max(axis=0)
    inside = lambda lo, hi: ((places >= lo - 1e-9) & (places <= hi + 1e-9)).all(axis=1)  # noqa: E731
    for _ in range(3):
        for axis in (0, 1):
            for side in (0, 1):
                best, at = -np.inf, None
                for edge in np.unique(places[lit, axis]):
                    lo, hi = low.copy(), high.copy()
                    (lo if side == 0 else hi)[axis] = edge
                    if lo[axis] > hi[axis]:
                        continue
                    total = nats[inside(lo, hi)].sum()
                    if total > best:
                        best, at = total, edge
                (low if side == 0 else high)[axis] = at
    total = nats[inside(low, high)].sum()
    if total < 2 * _SEEN_NATS:
        return None
    return float(total), *_grown(places, nats, low, high)


def _grown(places: np.ndarray, nats: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges half-way to the next row that should see the plane if it went on and does not; a margin where there is none."""
    refused = nats < -_SEEN_NATS
    out_low, out_high = low - _MARGIN_M, high + _MARGIN_M
    for axis in (0, 1):
        other = 1 - axis
        level = refused & (places[:, other] > low[other] - 0.1) & (places[:, other] < high[other] + 0.1)
        below, above = places[level & (places[:, axis] < low[axis]), axis], places[level & (places[:, axis] > high[axis]), axis]
        if len(below):
            out_low[axis] = max(out_low[axis], (below.max() + low[axis]) / 2)
        if len(above):
            out_high[axis] = min(out_high[axis], (above.min() + high[axis]) / 2)
    return out_low, out_high


def lit(view, effect):
    """Points (n, 3) where first-order paths meet the added object, and its mean reflection in dB; (None, 0) where none does."""
    world = view.world
    name = [name for name in world.mesh.names if effect.family.adds(name)]
    points, ratio = [], []
    for ear in view.ears:
        for index, link in enumerate(ear.predictor.links):
            table = ear.predictor.path_table(world, index)
            paths, gain, way = table.paths, table.gain, table.way
            if not paths.faces.shape[1] or not name:
                continue
            own = np.array([world.mesh.index(one) for one in name])
            first = (paths.faces[:, 0] >= 0) & np.isin(world.faces.owner[paths.faces[:, 0]], own) & (gain != 0)
            if paths.faces.shape[1] > 1:
                first &= paths.faces[:, 1] < 0
            level = np.array(effect.choice.corners_m(*effect.values[:2]))
            normal = effect.choice.normal_at(effect.values[1])
            first &= np.abs((way.points_m[:, 1] - level[0]) @ normal) < 1e-3
            free = fields.free_space(way, first, *(world.radios[one].antenna for one in link), world.carrier_hz)
            points.append(way.points_m[first, 1])
            ratio.append(np.abs(gain[first]) / np.maximum(free, 1e-300))
    points = np.concatenate(points) if points else np.zeros((0, 3))
    if not len(points):
        return None, 0.0
    ratio = np.concatenate(ratio)
    return points, float(np.mean(db_from_amplitude(np.maximum(ratio, 1e-6))))
