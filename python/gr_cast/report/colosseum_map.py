# SPDX-License-Identifier: GPL-3.0-or-later
"""Run in the CaST container: draws the path-loss map that the sounder left in a folder."""

import sys
from pathlib import Path

import numpy as np

from ..core.documents import json_file
from . import plot


def draw(folder: Path) -> None:
    """heatmap.json to heatmap.png."""
    document = json_file(folder / "heatmap.json").document
    matrix = np.array([[np.nan if value is None else value for value in row] for row in document["path_loss_db"]], float)
    heard = int(np.isfinite(matrix).sum())
    title = f"Path loss of {heard} links at {document['sample_rate_hz'] / 1e6:g} MS/s"
    plot.save(plot.heatmap_figure(matrix, document["nodes"], title), folder / "heatmap.png")


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
