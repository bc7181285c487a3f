# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenarios: one model, its file formats, and the catalogue.

`load` takes a catalogue name or a file; `save` writes by suffix. The model needs NumPy alone, Colosseum files SciPy.
"""

from .band import band_hz, band_power_db, path_gain_matrix_db, path_gain_over_time_db, tap_power_matrix_db, taps_over_band_db
from .catalogue import catalogue_entries, data_folder, examples_folder, is_scenario, load, read, save
from .model import (
    GRID_STEP_S,
    GRID_TAPS,
    MAX_DELAY_S,
    LinkTaps,
    Scenario,
    base_loss_db,
    begun_at,
    impulse_response,
    link_name,
    played_gain,
    resampled,
    tap_power_db,
    taps_at,
    with_base_loss,
    with_more_loss,
)
from .radios import radios_of, with_radios

__all__ = [
    "GRID_STEP_S",
    "GRID_TAPS",
    "MAX_DELAY_S",
    "LinkTaps",
    "Scenario",
    "band_hz",
    "band_power_db",
    "base_loss_db",
    "begun_at",
    "catalogue_entries",
    "data_folder",
    "examples_folder",
    "impulse_response",
    "is_scenario",
    "link_name",
    "load",
    "path_gain_matrix_db",
    "path_gain_over_time_db",
    "played_gain",
    "radios_of",
    "read",
    "resampled",
    "save",
    "tap_power_db",
    "tap_power_matrix_db",
    "taps_at",
    "taps_over_band_db",
    "with_base_loss",
    "with_more_loss",
    "with_radios",
]
