# SPDX-License-Identifier: GPL-3.0-or-later
"""Someone or something that passes: an upright cylinder that shades paths and sends an echo from its axis."""

import numpy as np

from ...scenario.create import fields, images

CENTRE = 0.6  # of the height: where the echo of a body comes from


def with_person(world, predictor, index: int, instant, gain, way, many: int):
    """Paths of a link with the person's shadow and echo: (instant, gain, length_m, number of instants)."""
    person, time_s = world.person, predictor.time_s
    if many == 1 and len(time_s) > 1:
        copies = len(time_s)
        points_m = np.tile(way.points_m, (copies, 1, 1))
        instant, gain, length_m = np.repeat(np.arange(copies), len(gain)), np.tile(gain, copies), np.tile(way.length_m, copies)
        many = copies
    else:
        points_m, length_m = way.points_m, way.length_m
    axis_m = axis(person, time_s if many > 1 else time_s[:1])
    gain = np.where(shaded(person, axis_m[instant], points_m), 0.0, gain)
    ends = [world.radios[name].end_key for name in predictor.links[index]]
    key = "echo", index, person, *ends, world.mesh.key, world.surface.standing, world.carrier_hz
    echo, echo_m = predictor.remembered(key, lambda: echoes(world, predictor, index, axis_m))
    return np.concatenate([instant, np.arange(many)]), np.concatenate([gain, echo]), np.concatenate([length_m, echo_m]), many


def axis(person, time_s: np.ndarray) -> np.ndarray:
    """Foot of the axis (T, 3)."""
    return np.array(person.position_m) + np.multiply.outer(time_s, person.velocity_m_per_s)


def shaded(person, foot_m: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Whether any leg of a path (n, D + 2, 3) goes through the cylinder over `foot_m` (n, 3)."""
    hit = np.zeros(len(points_m), bool)
    for leg in range(points_m.shape[1] - 1):
        begin, step = points_m[:, leg] - foot_m, points_m[:, leg + 1] - points_m[:, leg]
        flat = (step[:, :2] ** 2).sum(axis=1)
        middle = np.clip(-(begin[:, :2] * step[:, :2]).sum(axis=1) / np.maximum(flat, 1e-12), 0, 1)
        nearest = begin + middle[:, None] * step
        depth = person.radius_m**2 - (nearest[:, :2] ** 2).sum(axis=1)
        half = np.sqrt(np.maximum(depth, 0) / np.maximum(flat, 1e-12))
        low, high = np.clip(middle - half, 0, 1), np.clip(middle + half, 0, 1)
        heights = np.sort(np.stack([begin[:, 2] + low * step[:, 2], begin[:, 2] + high * step[:, 2]]), axis=0)
        hit |= (depth > 0) & (flat > 0) & (heights[0] < person.height_m) & (heights[1] > 0)
    return hit


def echoes(world, predictor, index: int, axis_m: np.ndarray):
    """Gain and length (T,) of the echo from the middle of the body: the bistatic radar equation, legs blocked by objects."""
    person = world.person
    tx, rx = (world.radios[name] for name in predictor.links[index])
    centre_m = axis_m + np.array([0.0, 0.0, CENTRE * person.height_m])
    tx_m, rx_m = (np.broadcast_to(end, centre_m.shape) for end in predictor.ends_m(world, index))
    legs = [centre_m - tx_m, rx_m - centre_m]
    far_m = [np.linalg.norm(leg, axis=1) for leg in legs]
    sent = fields.far_field(tx.antenna, legs[0] / far_m[0][:, None])
    taken = fields.far_field(rx.antenna, -legs[1] / far_m[1][:, None])
    kept = (
        (sent * taken).sum(axis=1) if person.keeps_polarisation else np.linalg.norm(sent, axis=1) * np.linalg.norm(taken, axis=1)
    )
    gain = world.wavelength_m * np.sqrt(person.cross_section_m2) / (4 * np.pi) ** 1.5 * kept / (far_m[0] * far_m[1])
    points_m = np.stack([tx_m, centre_m, rx_m], axis=1)
    met = np.zeros((len(points_m), 1), np.int64)  # a bounce, so that both legs are looked at
    path, _, face, _ = images.crossings(world.faces, points_m, met)
    solid = world.surface.present & ~world.surface.clear
    gain[path[solid[world.faces.owner[face]]]] = 0
    return gain, far_m[0] + far_m[1]
