# SPDX-License-Identifier: GPL-3.0-or-later
"""What surfaces are made of: slabs of ITU-R P.2040-3 materials, or of numbers of their own."""

from dataclasses import dataclass

import numpy as np

from ...core.errors import CastError

# ITU-R P.2040-3, table 3: relative permittivity a·f^b, conductivity c·f^d in S/m, f in GHz; the band in GHz that it is for.
ITU = {
    "concrete": (5.24, 0.0, 0.0462, 0.7822, 1, 100), "brick": (3.91, 0.0, 0.0238, 0.16, 1, 40),
    "plasterboard": (2.73, 0.0, 0.0085, 0.9395, 1, 100), "wood": (1.99, 0.0, 0.0047, 1.0718, 0.001, 100),
    "glass": (6.31, 0.0, 0.0036, 1.3394, 0.1, 100), "ceiling_board": (1.48, 0.0, 0.0011, 1.0750, 1, 100),
    "chipboard": (2.58, 0.0, 0.0217, 0.7800, 1, 100), "plywood": (2.71, 0.0, 0.33, 0.0, 1, 40),
    "marble": (7.074, 0.0, 0.0055, 0.9262, 1, 60), "floorboard": (3.66, 0.0, 0.0044, 1.3515, 50, 100),
    "metal": (1.0, 0.0, 1e7, 0.0, 1, 100), "very_dry_ground": (3.0, 0.0, 0.00015, 2.52, 1, 10),
    "medium_dry_ground": (15.0, -0.1, 0.035, 1.63, 1, 10), "wet_ground": (30.0, -0.4, 0.15, 1.30, 1, 10),
}  # fmt: skip
THICKNESS_M = 0.1  # of every material, unless the SPEC says otherwise
VACUUM_PERMITTIVITY = 8.8541878128e-12


def with_losses(permittivity, conductivity, frequency_hz: float):
    """Relative permittivity with the losses of a conductivity (S/m), for fields that turn as exp(j 2π f t) (P.2040-3, eq. 9b)."""
    return permittivity - 1j * conductivity / (2 * np.pi * frequency_hz * VACUUM_PERMITTIVITY)


@dataclass(frozen=True, kw_only=True)
class Medium:
    """A slab in air: an ITU `material`, with numbers of its own in place of the table's where it has any; rms height of its
    roughness, and the share of the field that it scatters. Raises CastError for what no surface can be."""

    material: str | None = None
    own_permittivity: float | None = None
    own_conductivity_s_per_m: float | None = None
    thickness_m: float = THICKNESS_M
    height_rms_m: float = 0.0
    scattering_coefficient: float = 0.0

    def __post_init__(self):
        if self.material is not None and self.material not in ITU:
            raise CastError(f"got {self.material!r}, needs one of {', '.join(ITU)}")
        if self.material is None and self.own_permittivity is None:
            raise CastError(f"needs a material, or a permittivity of its own; materials: {', '.join(ITU)}")

    def permittivity(self, frequency_hz: float) -> float:
        """Relative permittivity, without losses (ITU-R P.2040-3, eq. 28)."""
        if self.own_permittivity is not None:
            return self.own_permittivity
        a, b, *_ = ITU[self.material]
        return a * (frequency_hz / 1e9) ** b

    def conductivity(self, frequency_hz: float) -> float:
        """Conductivity in S/m (ITU-R P.2040-3, eq. 29)."""
        if self.own_conductivity_s_per_m is not None:
            return self.own_conductivity_s_per_m
        if self.material is None:
            return 0.0
        _, _, c, d, *_ = ITU[self.material]
        return c * (frequency_hz / 1e9) ** d

    def complex_permittivity(self, frequency_hz: float) -> complex:
        """Relative permittivity with losses, for fields that turn as exp(j 2π f t) (ITU-R P.2040-3, eq. 9b)."""
        return complex(with_losses(self.permittivity(frequency_hz), self.conductivity(frequency_hz), frequency_hz))

    def out_of_band(self, frequency_hz: float) -> str:
        """What is wrong with asking the table at a frequency; "" where nothing is, or where all numbers are its own."""
        if self.material is None or None not in (self.own_permittivity, self.own_conductivity_s_per_m):
            return ""
        *_, low, high = ITU[self.material]
        if low <= frequency_hz / 1e9 <= high:
            return ""
        return f"{self.material} is known from {low:g} to {high:g} GHz, the carrier is {frequency_hz / 1e9:g} GHz"
