# SPDX-License-Identifier: GPL-3.0-or-later
"""Radio maps and node maps as requests bring them: every fault by its place."""

import re

from ..core.documents import listed, short
from ..core.errors import CastError

RADIOS = 2  # of an SRN; 0 is not connected
_END = ("SRN", "RadioA", "RadioB")


def default_radio_map(nodes: int, srns: tuple[int, ...]) -> dict:
    """SRNs in ascending order take nodes in ascending order; nodes beyond them are unused."""
    ends = [{"SRN": srn, "RadioA": 1, "RadioB": 2} for srn in sorted(srns)]
    return {f"Node {node}": ends[node - 1] if node <= len(ends) else "None" for node in range(1, nodes + 1)}


def radio_map(given, nodes: int, srns: tuple[int, ...]) -> dict:
    """A map that names every node of the scenario, each SRN of the reservation at most once. Raises CastError."""
    if not isinstance(given, dict):
        raise CastError(f"srn_radio_mapping: got {short(given)}, needs an object")
    needed, faults, taken = [f"Node {node}" for node in range(1, nodes + 1)], [], {}
    faults += [
        f"{short(name)}: no node of the scenario, which has Node 1 to Node {nodes}" for name in given if name not in needed
    ]
    faults += [f'{name}: missing: every node is named, an unused one is "None"' for name in needed if name not in given]
    for name in needed:
        end = given.get(name, "None")
        if end == "None":
            continue
        if not isinstance(end, dict) or set(end) != set(_END):
            faults.append(f'{name}: got {short(end)}, needs SRN, RadioA and RadioB, or "None"')
            continue
        if not _is_of(end["SRN"], srns):
            faults.append(f"{name}: SRN: got {short(end['SRN'])}, needs one of the reservation's: {listed(sorted(srns))}")
        elif taken.setdefault(end["SRN"], name) != name:
            faults.append(f"{name}: SRN: got {end['SRN']}, which serves {taken[end['SRN']]}")
        faults += [
            f"{name}: {key}: got {short(end[key])}, needs 0 to {RADIOS}"
            for key in _END[1:]
            if not _is_of(end[key], range(RADIOS + 1))
        ]
    _raise(faults)
    return {name: given[name] for name in needed}


def default_node_map(nodes: int, srns: tuple[int, ...]) -> dict:
    return {str(node): srn for node, srn in zip(range(1, nodes + 1), sorted(srns), strict=False)}


def node_map(given, nodes: int, srns: tuple[int, ...]) -> dict:
    """Traffic node to SRN, {"1": 1, "2": 45}, each SRN of the reservation at most once. Raises CastError."""
    if not isinstance(given, dict):
        raise CastError(f"srn_radio_mapping: got {short(given)}, needs an object")
    faults, taken = [], {}
    for node, srn in given.items():
        if not re.fullmatch(r"[1-9][0-9]{0,2}", node) or int(node) > nodes:
            faults.append(f"{short(node)}: no node of the traffic scenario, which has 1 to {nodes}")
        if not _is_of(srn, srns):
            faults.append(f"{short(node)}: got {short(srn)}, needs one of the reservation's SRNs: {listed(sorted(srns))}")
        elif taken.setdefault(srn, node) != node:
            faults.append(f"{short(node)}: SRN {srn} serves node {taken[srn]}")
    _raise(faults)
    return dict(given)


def _is_of(value, known) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value in known


def _raise(faults: list[str]) -> None:
    if faults:
        raise CastError(*(f"srn_radio_mapping: {fault}" for fault in faults[:20]))


def node_of_srn(mapping: dict) -> dict[int, int]:
    """SRN to the node that it is, of those whose first radio is connected."""
    return {end["SRN"]: int(name.removeprefix("Node ")) for name, end in mapping.items() if end != "None" and end["RadioA"] != 0}
