# SPDX-License-Identifier: GPL-3.0-or-later
"""A corrected place: spec_corrected.yaml and its mesh, which `cast_scenario.py create` takes as they are."""

from collections.abc import Sequence
from glob import escape
from pathlib import Path

from ...core.arrays import plain_values
from ...core.documents import yaml_text
from ...core.errors import CastError
from ...core.files import write_text
from ...scenario.create import materials
from ...scenario.create.geometry import Solid
from ...scenario.create.nodes import Node
from ...scenario.create.spec import SWITCHES, VERSION, Spec

SPEC_FILE, MESH_FILE = "spec_corrected.yaml", "spec_corrected.obj"


def document(spec: Spec) -> dict:
    """What a SPEC's file says of it, but for its model and materials: nodes in metres, grids node by node."""
    environment = {"place": spec.place, "carrier_hz": spec.carrier_hz, "bandwidth_hz": spec.bandwidth_hz}
    sampling = {key: vars(spec)[key] for key in ("duration_s", "step_s", "max_depth", "rays", *SWITCHES, "check_instants")}
    approximation = {key: vars(spec)[key] for key in ("method", "update_s", "hold_s", "dynamic_range_db")}
    return {
        "cast_create": VERSION,
        "id": spec.id,
        "name": spec.name,
        "description": spec.description,
        "environment": environment,
        "nodes": {node.name: _node(node) for node in spec.nodes},
        "sampling": sampling,
        "approximation": approximation,
    }


def _node(node: Node) -> dict:
    points = node.waypoints_m.tolist()
    track = {"waypoints_m": points, "speed_m_per_s": node.speed_m_per_s} if node.is_moving else {"position_m": points[0]}
    fresh = {"power_dbm": 0.0, "noise_figure_db": 0.0, "orientation_rad": (0.0, 0.0, 0.0)}
    return track | {"antenna": node.antenna} | {key: vars(node)[key] for key, none in fresh.items() if vars(node)[key] != none}


def write_spec(folder: Path, spec_document: dict, solids: Sequence[Solid], effects: Sequence[dict]) -> Path:
    """Write a SPEC with these objects, each of its own medium, and with these effects; returns its path.

    Raises CastError for objects that would not be read back as they are.
    """
    mesh = mesh_text(solids)
    written = {key: value for key, value in spec_document.items() if key != "effects"}
    written |= {
        "model": {"mesh": MESH_FILE},
        "materials": {escape(solid.name): materials.entry(solid.medium) for solid in solids},
    }
    written["environment"] = {key: value for key, value in written["environment"].items() if key != "area_m"}  # a mesh is whole
    if effects:
        written["effects"] = list(effects)
    text = yaml_text(plain_values(written), default_flow_style=None, width=120)
    write_text(folder / MESH_FILE, mesh)
    write_text(folder / SPEC_FILE, text)
    return folder / SPEC_FILE


def mesh_text(solids: Sequence[Solid]) -> str:
    """Objects as Wavefront OBJ, to the last bit of their coordinates. CastError names what such a file cannot hold."""
    names = [solid.name for solid in solids]
    faults = [f"object {name!r}: two have this name" for name in sorted({name for name in names if names.count(name) > 1})]
    faults += [
        f"object {name!r}: not a name that a mesh can hold" for name in names if name != " ".join(name.split("#")[0].split())
    ]
    faults += [f"object {solid.name}: has no medium" for solid in solids if solid.medium is None]
    if faults:
        raise CastError(*faults)
    lines, first = ["# metres, z up"], 1
    for solid in solids:
        lines.append(f"o {solid.name}")
        lines += ["v " + " ".join(map(repr, vertex)) for vertex in solid.vertices_m.tolist()]
        lines += ["f " + " ".join(str(first + corner) for corner in face) for face in solid.faces.tolist()]
        first += len(solid.vertices_m)
    return "\n".join(lines) + "\n"
