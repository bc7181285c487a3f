# SPDX-License-Identifier: GPL-3.0-or-later
"""Someone or something that passes: an upright cylinder that shades paths and sends an echo from its axis."""

import numpy as np

from ...scenario.create import images
from ...scenario.create.images import tracing

CENTRE = 0.6  # of the height: where the echo of a body comes from
HEIGHT_M = 1.8  # of a body of whom nothing is known
_AT_ONCE = 400_000  # paths, where nothing is compiled


def with_person(world, predictor, which, tables) -> list[tuple]:
    """Paths of links `which` with the person's shadow and echo: (instant, gain, length_m, number of instants) of each."""
    person, time_s = world.person, predictor.time_s
    foot_m = axis(person, time_s)
    law = person, world.mesh.key, world.surface.standing, world.carrier_hz
    keys = [("echo", index, *(world.radios[name].end_key for name in predictor.links[index]), law) for index in which]
    heard = predictor.remembered_all(keys, lambda missing: echoes(world, predictor, [which[one] for one in missing], foot_m))
    return [_with_echo(person, foot_m, table, *one) for table, one in zip(tables, heard, strict=True)]


def _with_echo(person, foot_m: np.ndarray, table, echo: np.ndarray, echo_m: np.ndarray) -> tuple:
    """Paths of a link, those in the shadow of someone over feet (T, 3) without strength, and his echo (T,) of each instant."""
    points_m, instant, gain, length_m, many = table.way.points_m, table.instant, table.gain, table.way.length_m, len(foot_m)
    if table.many == many:
        dark = shaded(person.radius_m, person.height_m, foot_m[instant][None], points_m[:, None])[0, :, 0]
    else:  # nothing moves but him
        dark = shaded(person.radius_m, person.height_m, foot_m[:, None], points_m[None])[:, 0].ravel()
        instant = np.repeat(np.arange(many), len(gain))
        gain, length_m = (np.broadcast_to(one, (many, len(one))).ravel() for one in (gain, length_m))
    return (
        np.concatenate([instant, np.arange(many)]),
        np.concatenate([np.where(dark, 0.0, gain), echo]),
        np.concatenate([length_m, echo_m]),
        many,
    )


def at_all_instants(table, instants: int) -> tuple:
    """(points_m, instant, gain, length_m, number of instants) of a link's paths, where nothing moves at each instant anew."""
    points_m, gain, length_m = table.way.points_m, table.gain, table.way.length_m
    if table.many > 1 or instants == 1:
        return points_m, table.instant, gain, length_m, table.many
    instant = np.repeat(np.arange(instants), len(gain))
    return np.tile(points_m, (instants, 1, 1)), instant, np.tile(gain, instants), np.tile(length_m, instants), instants


def axis(person, time_s: np.ndarray) -> np.ndarray:
    """Foot of the axis (T, 3)."""
    return np.array(person.position_m) + np.multiply.outer(time_s, person.velocity_m_per_s)


def shaded(radius_m: float, height_m: float, foot_m: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Whether any leg of paths (R, P, D + 2, 3) goes through an upright cylinder over feet (C, R, 3): (C, R, P)."""
    if tracing:
        return tracing.shaded(radius_m, height_m, foot_m, points_m)
    size = max(1, _AT_ONCE // max(points_m.shape[0] * points_m.shape[1], 1))
    if len(foot_m) > size:
        parts = np.array_split(foot_m, -(-len(foot_m) // size))
        return np.concatenate([shaded(radius_m, height_m, part, points_m) for part in parts])
    hit = np.zeros((*foot_m.shape[:2], points_m.shape[1]), bool)
    for leg in range(points_m.shape[2] - 1):
        begin, step = points_m[:, :, leg] - foot_m[:, :, None], points_m[:, :, leg + 1] - points_m[:, :, leg]
        flat = (step[..., :2] ** 2).sum(axis=-1)
        middle = np.clip(-(begin[..., :2] * step[..., :2]).sum(axis=-1) / np.maximum(flat, 1e-12), 0, 1)
        nearest = begin + middle[..., None] * step
        depth = radius_m**2 - (nearest[..., :2] ** 2).sum(axis=-1)
        half = np.sqrt(np.maximum(depth, 0) / np.maximum(flat, 1e-12))
        low, high = np.clip(middle - half, 0, 1), np.clip(middle + half, 0, 1)
        heights = np.sort(np.stack([begin[..., 2] + low * step[..., 2], begin[..., 2] + high * step[..., 2]]), axis=0)
        hit |= (depth > 0) & (flat > 0) & (heights[0] < height_m) & (heights[1] > 0)
    return hit


def echoes(world, predictor, which, axis_m: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Gain and length (T,) of the echo from the middle of the body on links `which`, over an axis (T, 3): the bistatic radar
    equation, legs blocked by objects."""
    person, counts = world.person, [len(axis_m)] * len(which)
    centre_m = np.tile(axis_m + np.array([0.0, 0.0, CENTRE * person.height_m]), (len(which), 1))
    tx_m, rx_m = predictor.all_ends_m(world, which)
    legs = [centre_m - tx_m, rx_m - centre_m]
    far_m = [np.linalg.norm(leg, axis=1) for leg in legs]
    at = np.arange(len(centre_m))
    sent = predictor.fields(world, which, 0, tx_m, counts, at, legs[0] / far_m[0][:, None])
    taken = predictor.fields(world, which, 1, rx_m, counts, at, -legs[1] / far_m[1][:, None])
    kept = (
        (sent * taken).sum(axis=1) if person.keeps_polarisation else np.linalg.norm(sent, axis=1) * np.linalg.norm(taken, axis=1)
    )
    gain = world.wavelength_m * np.sqrt(person.cross_section_m2) / (4 * np.pi) ** 1.5 * kept / (far_m[0] * far_m[1])
    gain[blocked(world, np.stack([tx_m, centre_m, rx_m], axis=1))] = 0
    return list(zip(gain.reshape(len(which), -1), (far_m[0] + far_m[1]).reshape(len(which), -1), strict=True))


def blocked(world, points_m: np.ndarray) -> np.ndarray:
    """Whether something solid stands in the way of (n,) paths over points (n, 2 or 3, 3)."""
    met = np.zeros((len(points_m), points_m.shape[1] - 2), np.int64)  # a bounce, so that both its legs are looked at
    solid = (world.surface.present & ~world.surface.clear)[world.faces.owner]
    path, *_ = images.crossings(world.faces, points_m, met, solid)
    out = np.zeros(len(points_m), bool)
    out[path] = True
    return out
