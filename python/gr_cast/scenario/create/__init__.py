# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenarios from places: environment, 3D model, materials, nodes, sampling, parsing, approximation, installation."""
