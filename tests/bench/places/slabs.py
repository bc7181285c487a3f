# SPDX-License-Identifier: GPL-3.0-or-later
"""Slabs of ITU-R P.2040-3 in air: permittivities of table 3, reflection and transmission of one homogeneous layer."""

import numpy as np

C_M_PER_S = 299792458.0
EPSILON_0 = 8.8541878128e-12
# name: a, b, c, d of eps = a f^b and sigma = c f^d (f in GHz), valid band in GHz
TABLE = {
    "concrete": (5.24, 0.0, 0.0462, 0.7822, 1, 100),
    "brick": (3.91, 0.0, 0.0238, 0.16, 1, 40),
    "plasterboard": (2.73, 0.0, 0.0085, 0.9395, 1, 100),
    "wood": (1.99, 0.0, 0.0047, 1.0718, 0.001, 100),
    "glass": (6.31, 0.0, 0.0036, 1.3394, 0.1, 100),
    "ceiling_board": (1.48, 0.0, 0.0011, 1.0750, 1, 100),
    "chipboard": (2.58, 0.0, 0.0217, 0.78, 1, 100),
    "plywood": (2.71, 0.0, 0.33, 0.0, 1, 40),
    "marble": (7.074, 0.0, 0.0055, 0.9262, 1, 60),
    "floorboard": (3.66, 0.0, 0.0044, 1.3515, 50, 100),
    "metal": (1.0, 0.0, 1e7, 0.0, 1, 100),
    "very_dry_ground": (3.0, 0.0, 0.00015, 2.52, 1, 10),
    "medium_dry_ground": (15.0, -0.1, 0.035, 1.63, 1, 10),
    "wet_ground": (30.0, -0.4, 0.15, 1.30, 1, 10),
}


def medium(name, carrier_hz):
    """(relative permittivity, conductivity in S/m) of a material of the table."""
    a, b, c, d, *_ = TABLE[name]
    ghz = carrier_hz / 1e9
    return a * ghz**b, c * ghz**d


def slab(permittivity, conductivity, thickness_m, carrier_hz, cos_i):
    """(r_te, r_tm, t_te, t_tm) of a slab, angle of incidence by its cosine; all arrays broadcast."""
    eta = permittivity - 1j * np.asarray(conductivity) / (EPSILON_0 * 2 * np.pi * carrier_hz)
    root = np.sqrt(eta - (1 - np.asarray(cos_i) ** 2))
    q = 2 * np.pi * thickness_m * carrier_hz / C_M_PER_S * root
    once = np.exp(-1j * np.where(q.imag < -300, q.real - 300j, q))  # beyond e^-300 a slab is opaque
    out = []
    for r in ((cos_i - root) / (cos_i + root), (eta * cos_i - root) / (eta * cos_i + root)):
        below = 1 - r**2 * once**2
        out.append((r * (1 - once**2) / below, (1 - r**2) * once / below))
    (r_te, t_te), (r_tm, t_tm) = out
    return r_te, r_tm, t_te, t_tm
