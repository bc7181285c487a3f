# SPDX-License-Identifier: GPL-3.0-or-later
"""From residual echoes to rectangles: an image of all planes, coherent refinement of the best, extent by who sees them."""

from dataclasses import replace

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S, db_from_amplitude
from ...scenario.create import fields
from ...twin.places.families.additions import Sheet
from . import imaging
from .ears import evenly

_AZIMUTHS = 90  # of upright planes
_KEPT = 5  # planes that are refined
_SHIFTS, _TURNS = 240, 41  # of the coherent grid, at most
_TONES = 10  # of a row that it looks at
_SEEN_NATS = 4.0  # of a row that a plane is fitted to
_SIDE_RAD = np.radians(15)  # by which a box's side may be turned from where its shadow has it
_MARGIN_M = 1.5  # beyond the outermost point that is lit, where nothing says that it ends


def sheets(view) -> list[Sheet]:
    """Rectangles that would explain echoes in the residual, the best first."""
    seen = view.echoes
    if not seen:
        return []
    low, high = view.bounds_m
    centre = (low + high) / 2
    reach_m = float(np.linalg.norm(high - low)) / 2 + 10.0
    resolution_m = SPEED_OF_LIGHT_M_PER_S / seen[0].bins_per_s
    levels = np.arange(-reach_m, reach_m, max(resolution_m / 2, reach_m / 400))
    azimuth = np.arange(_AZIMUTHS) * np.pi / _AZIMUTHS
    upright = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(_AZIMUTHS)])
    normals = np.concatenate([np.repeat(upright, len(levels), axis=0), np.repeat([[0.0, 0.0, 1.0]], len(levels), axis=0)])
    level_m = np.tile(levels, _AZIMUTHS + 1) + normals @ centre
    scores = imaging.plane_scores(seen, normals, level_m)
    image = scores.reshape(_AZIMUTHS + 1, len(levels)).copy()
    found = []
    near = max(int(np.ceil(1.0 / (levels[1] - levels[0]))), 2)
    for _ in range(_KEPT):
        a, d = np.unravel_index(np.argmax(image), image.shape)
        if image[a, d] < _SEEN_NATS:
            break
        found.append((normals[a * len(levels) + d], level_m[a * len(levels) + d]))
        for turn in range(-4, 5):
            other = a + turn if a < _AZIMUTHS else a
            if a < _AZIMUTHS and not 0 <= other < _AZIMUTHS:
                continue
            image[other, max(d - near, 0) : d + near + 1] = -np.inf
    refined = [one for one in (_refined(view, normal, level) for normal, level in found) if one is not None]
    return [sheet for _, sheet in sorted(refined, key=lambda pair: -pair[0])[:4]]


def mirrors(view, box: Sheet) -> list[Sheet]:
    """The box with one of its upright sides where echoes in the residual have it, the best side first."""
    found = []
    for number in range(4):
        side = box.side(number)
        normal = np.array(side.normal)
        refined = _refined(view, normal, float(np.array(side.origin_m) @ normal), _SIDE_RAD)
        if refined is None:
            continue
        nats, plane = refined
        toward = 1.0 if np.array(plane.normal) @ normal > 0 else -1.0
        normal, u = toward * np.array(plane.normal), toward * np.array(plane.u)
        middle = np.mean(side.corners_m(), axis=0)
        middle = middle + ((np.array(plane.origin_m) - middle) @ normal) * normal
        half, low_m = (side.high_m[0] - side.low_m[0]) / 2, middle[2] - side.high_m[1] / 2
        found.append(
            (
                nats,
                replace(
                    side,
                    origin_m=(middle[0], middle[1], low_m),
                    normal=tuple(normal),
                    u=tuple(u),
                    low_m=(-half, 0.0),
                    high_m=(half, side.high_m[1]),
                ),
            )
        )
    return [one for _, one in sorted(found, key=lambda pair: -pair[0])]


def _refined(view, normal: np.ndarray, level_m: float, most_rad: float = np.radians(4)):
    """(nats, sheet) of the best rectangle near a plane; None where nothing coherent is there."""
    rows = _rows(view, normal, level_m)
    if len(rows["y"]) < 2:
        return None
    v = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.5 else np.array([0.0, 1.0, 0.0])
    u = np.cross(v, normal)
    _, met, _ = imaging.mirrored((rows["tx"], rows["rx"]), normal, level_m)
    strong = rows["nats"] > _SEEN_NATS
    if strong.sum() < 2:
        return None
    origin = met[strong].mean(axis=0)
    origin = origin - (origin @ normal - level_m) * normal
    span_m = max(float(np.ptp((met[strong] - origin) @ u)), 1.0)
    wavelength_m = view.world.wavelength_m
    resolution_m = SPEED_OF_LIGHT_M_PER_S / view.echoes[0].bins_per_s * 8
    half = min(resolution_m / 3, _SHIFTS / 2 * wavelength_m / 10)
    shifts = np.arange(-half, half + 1e-9, wavelength_m / 10)
    step_rad = wavelength_m / 6 / span_m
    turns = step_rad * np.arange(-(_TURNS // 2), _TURNS // 2 + 1)
    turns = turns[np.abs(turns) <= most_rad]
    shift, turn, amplitude = _coherent(view, rows, origin, normal, u, shifts, turns, strong)
    gain_nats = _evidence(view, rows, origin, normal, u, shift, turn, amplitude)
    tilted = np.cos(turn) * normal - np.sin(turn) * u
    along = np.cos(turn) * u + np.sin(turn) * normal
    origin = origin + shift * normal
    _, met, _ = imaging.mirrored((rows["tx"], rows["rx"]), tilted, origin @ tilted)
    places = np.column_stack([(met - origin) @ along, (met - origin) @ v])
    box = rectangle(places, gain_nats)
    if box is None:
        return None
    nats, low, high = box
    sheet = Sheet(
        origin_m=tuple(origin), normal=tuple(tilted), u=tuple(along), v=tuple(v), low_m=tuple(low), high_m=tuple(high)
    )  # fmt: skip
    return nats, sheet


def _rows(view, normal, level_m) -> dict:
    """Residual rows of the first wideband campaign whose ends are on one side of a plane: one campaign points, all are fitted."""
    (ear, fit), seen = view.wideband[0], view.echoes[0]
    length_m, _, good = imaging.mirrored((seen.tx_m, seen.rx_m), normal, level_m)
    _, instants, count = fit.residual.shape
    sent = np.repeat([view.world.link_amplitude(link) for link in ear.heard.links], instants)
    sent = sent * _seen_by_antennas(view, ear.heard.links, seen, normal, level_m)
    rows = {
        "tx": seen.tx_m,
        "rx": seen.rx_m,
        "y": fit.residual.reshape(-1, count),
        "weight": ear.heard.weight.reshape(-1, count),
        "scale": fit.factor.reshape(-1, count) * sent[:, None],
        "nats": imaging.looked_up(seen, length_m),
    }
    return {key: values[good] for key, values in rows.items()} | {"f_hz": ear.heard.frequency_hz}


def _seen_by_antennas(view, links, seen, normal, level_m) -> np.ndarray:
    """Product of both antennas' amplitudes (n,) towards a plane's mirror images."""
    out = np.ones(len(seen.link))
    for one, other, side in ((seen.tx_m, seen.rx_m, 0), (seen.rx_m, seen.tx_m, 1)):
        image = other - 2 * (other @ normal - level_m)[:, None] * normal
        direction = image - one
        direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
        for index, link in enumerate(links):
            own = seen.link == index
            out[own] *= np.linalg.norm(fields.far_field(view.world.radios[link[side]].antenna, direction[own]), axis=1)
    return np.maximum(out, 1e-3)


def _echo(view, rows, which, columns, length_m) -> np.ndarray:
    """Echo of unit reflection (n, K) on rows `which`."""
    f_hz = rows["f_hz"][columns]
    tau_s = length_m / SPEED_OF_LIGHT_M_PER_S
    phase = np.exp(-2j * np.pi * (view.world.carrier_hz + f_hz) * tau_s[..., None])
    return rows["scale"][which][:, columns] * (view.world.wavelength_m / (4 * np.pi * length_m))[..., None] * phase


def _lengths(rows, which, origin, normal, u, shift, turn) -> np.ndarray:
    tilted = np.cos(turn) * normal - np.sin(turn) * u
    ends = rows["tx"][which], rows["rx"][which]
    return imaging.mirrored(ends, tilted, (origin + shift * normal) @ tilted)[0]


def _coherent(view, rows, origin, normal, u, shifts, turns, strong):
    which = np.flatnonzero(strong)
    which = which[np.argsort(-rows["nats"][which])[:60]]
    columns = evenly(len(rows["f_hz"]), _TONES)
    y, weight = rows["y"][which][:, columns], rows["weight"][which][:, columns]
    best, top = (0.0, 0.0, 0.0j), -1.0
    for turn in turns:
        for shift in shifts:
            echo = _echo(view, rows, which, columns, _lengths(rows, which, origin, normal, u, shift, turn))
            cross, power = (echo.conj() * y * weight).sum(), (np.abs(echo) ** 2 * weight).sum()
            nats = np.abs(cross) ** 2 / max(power, 1e-300)
            if nats > top:
                best, top = (float(shift), float(turn), complex(cross / max(power, 1e-300))), nats
    return best


def _evidence(view, rows, origin, normal, u, shift, turn, amplitude):
    """Nats (n,) by which the echo explains each row."""
    which, columns = np.arange(len(rows["y"])), np.arange(len(rows["f_hz"]))
    echo = amplitude * _echo(view, rows, which, columns, _lengths(rows, which, origin, normal, u, shift, turn))
    gain = (2 * (echo.conj() * rows["y"]).real - np.abs(echo) ** 2) * rows["weight"]
    return gain.sum(axis=1)


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
    name = [name for name in world.mesh.names if name.startswith("missing_")]
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
