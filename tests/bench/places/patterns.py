# SPDX-License-Identifier: GPL-3.0-or-later
"""Antennas with vertical polarisation: the far field as a real vector, of a direction and an orientation."""

import numpy as np


def turned(orientation_rad):
    """Rotation matrix of yaw, pitch, roll: about z, then y, then x (TR 38.901, 7.1-4)."""
    (a, b, c), (s, t, u) = np.cos(orientation_rad), np.sin(orientation_rad)
    about_z = np.array([[a, -s, 0], [s, a, 0], [0, 0, 1]])
    about_y = np.array([[b, 0, t], [0, 1, 0], [-t, 0, b]])
    about_x = np.array([[1, 0, 0], [0, c, -u], [0, u, c]])
    return about_z @ about_y @ about_x


def amplitude(antenna, theta, phi):
    """Square root of the gain over the isotropic antenna."""
    if antenna == "iso":
        return np.ones_like(theta)
    if antenna == "dipole":
        return np.sqrt(1.5) * np.sin(theta)
    if antenna == "hw_dipole":
        sine = np.sin(theta)
        return np.sqrt(1.643) * np.cos(np.pi / 2 * np.cos(theta)) / np.where(sine < 1e-9, np.inf, sine)
    if antenna == "tr38901":
        vertical = np.minimum(12 * ((theta - np.pi / 2) / np.radians(65)) ** 2, 30)
        horizontal = np.minimum(12 * (phi / np.radians(65)) ** 2, 30)
        return 10 ** ((8 - np.minimum(vertical + horizontal, 30)) / 20)
    raise ValueError(f"antenna: got {antenna!r}")


def field(antenna, orientation_rad, direction):
    """Field of unit directions (M, 3) leaving the antenna, (M, 3): amplitude along the antenna's own theta."""
    turn = turned(np.asarray(orientation_rad, float))
    x, y, z = (direction @ turn).T
    theta, phi = np.arccos(np.clip(z, -1, 1)), np.arctan2(y, x)
    along = np.stack([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), -np.sin(theta)], 1) @ turn.T
    return amplitude(antenna, theta, phi)[:, None] * along
