# SPDX-License-Identifier: GPL-3.0-or-later
"""Which ITU-R P.2040 material every object is made of: by its name or its surface; nothing is left over in silence."""

from fnmatch import fnmatchcase

from ...core.errors import CastError
from .geometry import Solid, assigned

# ITU-R P.2040-3, table 3: the bands in GHz over which each material's permittivity is given.
MATERIALS_GHZ = {
    "concrete": (1, 100), "brick": (1, 40), "plasterboard": (1, 100), "wood": (0.001, 100), "glass": (0.1, 100),
    "ceiling_board": (1, 100), "chipboard": (1, 100), "plywood": (1, 40), "marble": (1, 60), "floorboard": (50, 100),
    "metal": (1, 100), "very_dry_ground": (1, 10), "medium_dry_ground": (1, 10), "wet_ground": (1, 10),
}  # fmt: skip
THICKNESS_M = {
    "concrete": 0.2, "brick": 0.2, "plasterboard": 0.026, "wood": 0.03, "glass": 0.006, "ceiling_board": 0.015,
    "chipboard": 0.02, "plywood": 0.02, "marble": 0.03, "floorboard": 0.02, "metal": 0.005, "very_dry_ground": 10.0,
    "medium_dry_ground": 10.0, "wet_ground": 10.0,
}  # fmt: skip


def assign(solids: list[Solid], rules: dict[str, str], carrier_hz: float) -> list[Solid]:
    """Every object with the material of the first rule (pattern of a name or surface, * and ? allowed) that fits it.

    Raises CastError that names every object without a rule, every unknown material, and every material whose data do not
    reach the carrier. The objects that come out are those that came in.
    """
    faults = []
    for pattern, material in rules.items():
        if material not in MATERIALS_GHZ:
            faults.append(f"materials: {pattern}: got {material!r}, needs one of {', '.join(MATERIALS_GHZ)}")
        else:
            low, high = MATERIALS_GHZ[material]
            if not low <= carrier_hz / 1e9 <= high:
                faults.append(
                    f"materials: {pattern}: {material} is known from {low:g} to {high:g} GHz, "
                    f"the carrier is {carrier_hz / 1e9:g} GHz"
                )
    out, missing = [], []
    for solid in solids:
        material = next(
            (rules[p] for p in rules if fnmatchcase(solid.name, p) or (solid.surface and fnmatchcase(solid.surface, p))),
            None,
        )
        if material is None:
            missing.append(solid.name + (f" (surface {solid.surface})" if solid.surface else ""))
        else:
            out.append(assigned(solid, material))
    if missing:
        faults.append(
            f"materials: {len(missing)} objects have none: {', '.join(missing[:20])}{' …' if len(missing) > 20 else ''}"
        )
    if faults:
        raise CastError(*faults)
    return out
