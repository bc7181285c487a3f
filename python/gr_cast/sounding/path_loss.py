# SPDX-License-Identifier: GPL-3.0-or-later
"""Path loss of many links as one matrix."""

import csv
import io
import re

import numpy as np

from ..core.errors import CastError
from ..core.figures import fixed
from ..core.units import db_from_power, power_from_db
from ..signals.recording import Recording

LEAST_ERROR_DB = 0.01  # that is claimed of a mean path loss


def natural_order(name: str):
    """Sorts node 10 after node 9."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", name)]


def link_of(recording: Recording, file_name: str) -> tuple[str, str]:
    """(transmitter, receiver) of a recording, from its metadata, or from a name such as tx3_rx7."""
    transmitter, receiver = (recording.metadata.get(f"cast:{end}") for end in ("transmitter", "receiver"))
    if transmitter and receiver:
        return str(transmitter), str(receiver)
    named = re.search(r"tx([A-Za-z0-9]+)[_-]rx([A-Za-z0-9]+)", file_name)
    if named is None:
        raise CastError(f"{file_name}: link: no cast:transmitter and cast:receiver in the metadata, no txA_rxB in the name")
    return named.group(1), named.group(2)


def loss_matrix(losses_db: dict[tuple[str, str], list[float]]) -> tuple[list[str], np.ndarray]:
    """Nodes in order and their (N, N) losses in dB, rows transmit; several of one link are averaged in linear power."""
    nodes = sorted({node for link in losses_db for node in link}, key=natural_order)
    matrix = np.full((len(nodes), len(nodes)), np.nan)
    for (tx, rx), values in losses_db.items():
        heard = [value for value in values if value is not None]
        if heard:
            matrix[nodes.index(tx), nodes.index(rx)] = -db_from_power(np.mean(power_from_db(-np.array(heard))))
    return nodes, matrix


def matrix_csv(nodes: list[str], matrix: np.ndarray) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["transmitter\\receiver", *nodes])
    for node, row in zip(nodes, matrix, strict=True):
        writer.writerow([node, *(f"{value:.4f}" if np.isfinite(value) else "" for value in row)])
    return text.getvalue()


def matrix_text(nodes: list[str], matrix: np.ndarray) -> str:
    """The matrix for the screen, one decimal; – was not measured or not heard."""
    width = max(7, *(len(node) + 1 for node in nodes))
    rows = ["".join(f"{node:>{width}}" for node in ["tx\\rx", *nodes])]
    for node, row in zip(nodes, np.round(matrix, 1) + 0.0, strict=True):
        rows.append(
            f"{node:>{width}}" + "".join(f"{value:>{width}.1f}" if np.isfinite(value) else f"{'–':>{width}}" for value in row)
        )
    return "\n".join(rows)


def average_text(loss_db: np.ndarray, error_db: float) -> str:
    """Mean and SD over links; no SD where there is one link, or where they differ by no more than each is uncertain."""
    std_db = np.std(loss_db)
    over = "1 link" if len(loss_db) == 1 else f"{len(loss_db)} links"
    spread = f", SD {fixed(std_db, 2)} dB" if std_db > max(error_db, LEAST_ERROR_DB) else ""
    return f"mean {fixed(np.mean(loss_db), 2)} dB{spread} over {over}"
