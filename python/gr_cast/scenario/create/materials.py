# SPDX-License-Identifier: GPL-3.0-or-later
"""Which medium every object is made of: by its name or its surface; nothing is left over in silence."""

from fnmatch import fnmatchcase

from ...core.documents import Reader
from ...core.errors import CastError
from .geometry import Solid, assigned
from .media import Medium

# Key of a SPEC's material: the medium's own name of it, unit, least and most.
_NUMBERS = {
    "permittivity": ("own_permittivity", "", 1.0, 1e3),
    "conductivity": ("own_conductivity_s_per_m", "S/m", 0.0, 1e9),
    "thickness_m": ("thickness_m", "m", 1e-5, 100.0),
    "height_rms_m": ("height_rms_m", "m", 0.0, 1.0),
    "scattering_coefficient": ("scattering_coefficient", "", 0.0, 1.0),
}


def read_rules(get: Reader, rules) -> dict[str, Medium]:
    """The media of a SPEC's `materials`: pattern → NAME, or a mapping of a name and numbers."""
    found = {}
    for pattern, entry in get.mapping(rules, "materials").items():
        place = f"materials.{pattern}"
        before = len(get.faults)
        given = _given(get, entry, place) if isinstance(entry, dict) else {"material": get.text(entry, place)}
        if len(get.faults) > before:
            continue
        try:
            found[pattern] = Medium(**given)
        except CastError as error:
            get.faults.add(place, error.faults[0])
    return found


def _given(get: Reader, entry: dict, place: str) -> dict:
    entry = get.keys(entry, place, {"material", *_NUMBERS})
    given = {"material": get.text(entry["material"], f"{place}.material")} if entry.get("material") is not None else {}
    for key, (name, unit, low, high) in _NUMBERS.items():
        if key in entry:
            given[name] = get.number(entry[key], f"{place}.{key}", unit, low, high)
    return given


def entry(medium: Medium) -> str | dict:
    """What `read_rules` reads as this medium."""
    numbers = {key: value for key, (name, *_) in _NUMBERS.items() if (value := getattr(medium, name)) != getattr(Medium, name)}
    if medium.material is None:
        return numbers
    return {"material": medium.material} | numbers if numbers else medium.material


def assign(solids: list[Solid], rules: dict[str, Medium], carrier_hz: float) -> list[Solid]:
    """Every object with the medium of the first rule (pattern of a name or surface, * and ? allowed) that fits it.

    Raises CastError that names every object without a rule, and every material whose data do not reach the carrier. The
    objects that come out are those that came in.
    """
    faults = [f"materials: {pattern}: {wrong}" for pattern, medium in rules.items() if (wrong := medium.out_of_band(carrier_hz))]
    out, missing = [], []
    for solid in solids:
        medium = next(
            (rules[p] for p in rules if fnmatchcase(solid.name, p) or (solid.surface and fnmatchcase(solid.surface, p))),
            None,
        )
        if medium is None:
            missing.append(solid.name + (f" (surface {solid.surface})" if solid.surface else ""))
        else:
            out.append(assigned(solid, medium))
    if missing:
        faults.append(
            f"materials: {len(missing)} objects have none: {', '.join(missing[:20])}{' …' if len(missing) > 20 else ''}"
        )
    if faults:
        raise CastError(*faults)
    return out
