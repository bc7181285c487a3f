# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenarios: one model, its file formats, and the catalogue.

`load` takes a catalogue name or a file; `save` writes by suffix. The model needs NumPy alone, Colosseum files SciPy.
"""

from .catalogue import catalogue_entries, data_folder, examples_folder, load, read, save
from .model import (
    GRID_STEP_S,
    GRID_TAPS,
    MAX_DELAY_S,
    LinkTaps,
    Scenario,
    base_loss_db,
    impulse_response,
    link_name,
    path_gain_matrix_db,
    played_gain,
    power_db,
    resampled,
    taps_at,
    with_base_loss,
    with_more_loss,
)

__all__ = [
    "GRID_STEP_S",
    "GRID_TAPS",
    "MAX_DELAY_S",
    "LinkTaps",
    "Scenario",
    "base_loss_db",
    "catalogue_entries",
    "data_folder",
    "examples_folder",
    "impulse_response",
    "link_name",
    "load",
    "path_gain_matrix_db",
    "played_gain",
    "power_db",
    "read",
    "resampled",
    "save",
    "taps_at",
    "with_base_loss",
    "with_more_loss",
]
