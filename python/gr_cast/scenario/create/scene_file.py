# SPDX-License-Identifier: GPL-3.0-or-later
"""A place as a Mitsuba scene, for the ray tracer and for other tools."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from ...core.files import write_text, written_aside
from .geometry import Solid
from .media import Medium


def write(folder: Path, solids: Sequence[Solid], carrier_hz: float) -> Path:
    """The objects as a Mitsuba scene with radio materials, `scene.xml` and a PLY file each."""
    lines = ['<scene version="2.1.0">']
    names = _names({solid.medium: None for solid in solids})
    lines += [_bsdf(medium, name, carrier_hz) for medium, name in names.items()]
    for index, solid in enumerate(solids):
        _write_ply(folder / f"{index}.ply", solid)
        lines.append(
            f'<shape type="ply" id="mesh-{index}"><string name="filename" value="{index}.ply"/>'
            f'<boolean name="face_normals" value="true"/><ref id="mat-{names[solid.medium]}" name="bsdf"/></shape>'
        )
    path = folder / "scene.xml"
    write_text(path, "\n".join([*lines, "</scene>"]))
    return path


def _names(media: Iterable[Medium]) -> dict[Medium, str]:
    """A name for each medium: its material's, with a number from the second one on."""
    names: dict[Medium, str] = {}
    for medium in media:
        name = medium.material or "own"
        taken = sum(other.split(".")[0] == name for other in names.values())
        names[medium] = f"{name}.{taken + 1}" if taken else name
    return names


def _bsdf(medium: Medium, name: str, carrier_hz: float) -> str:
    numbers = {"thickness": medium.thickness_m, "scattering_coefficient": medium.scattering_coefficient}
    if (medium.own_permittivity, medium.own_conductivity_s_per_m) == (None, None):
        kind, what = "itu-radio-material", f'<string name="type" value="{medium.material}"/>'
    else:
        kind, what = "radio-material", ""
        numbers["relative_permittivity"], numbers["conductivity"] = (
            medium.permittivity(carrier_hz),
            medium.conductivity(carrier_hz),
        )
    numbers = "".join(f'<float name="{key}" value="{value}"/>' for key, value in numbers.items())
    return f'<bsdf type="{kind}" id="mat-{name}">{what}{numbers}</bsdf>'


def _write_ply(path: Path, solid: Solid) -> None:
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(solid.vertices_m)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(solid.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(solid.faces), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    faces["n"], faces["v"] = 3, solid.faces
    with written_aside(path) as aside:
        aside.write_bytes(head.encode() + solid.vertices_m.astype("<f8").tobytes() + faces.tobytes())
