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


def cellular_rho(cells, nodes: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """{terminal: {quantity: ρ}} of the paper's one cell, whose nodes are numbers among all `nodes` of the place; empty for any
    other cells: of two stations the paper gives no ρ."""
    own = figures()["cellular"]
    number = {name: str(index + 1) for index, name in enumerate(nodes)}
    numbered = [(number[cell.station], [number[name] for name in cell.terminals]) for cell in cells]
    if numbered != [(own["station"], own["terminals"])]:
        return {}
    return {name: own["rho"][number[name]] for name in cells[0].terminals}
