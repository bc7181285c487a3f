# SPDX-License-Identifier: GPL-3.0-or-later
"""The model that a SPEC names, a mesh or an OpenStreetMap extract, as named objects."""

from . import mesh_files, osm
from .geometry import Solid
from .spec import Spec


def read(spec: Spec) -> tuple[list[Solid], dict[str, int]]:
    """Objects, and of an extract how many have heights given, assumed, and so on. Raises CastError as its reader does."""
    if spec.model_path.suffix.lower() != ".osm":
        return mesh_files.read(spec.model_path), {}
    heights = dict(default_height_m=spec.default_height_m, level_height_m=spec.level_height_m)
    solids, count = osm.read(spec.model_path, area_m=spec.area_m, **heights)
    return solids, dict(sorted(count.items()))
