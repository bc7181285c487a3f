# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's own figures, as programs print them beside theirs: one file, one row per case, no averages over cases."""

from functools import cache
from pathlib import Path

from ..core.documents import json_file


@cache
def figures() -> dict:
    """The content of paper.json; every group says where in the paper it stands."""
    return json_file(Path(__file__).with_suffix(".json")).document


def jamming(case: str) -> dict | None:
    """Losses and ρ of MOBILITY-JAMMER; None for a case that the paper does not have."""
    return figures()["jamming"]["cases"].get(case)


def cellular_rho(cells) -> dict[str, dict[str, float]]:
    """{terminal: {quantity: ρ}} of the paper's one cell; empty for any other cells: of two stations the paper gives no ρ."""
    own = figures()["cellular"]
    same = [(cell.station, list(cell.terminals)) for cell in cells] == [(own["station"], own["terminals"])]
    return own["rho"] if same else {}
