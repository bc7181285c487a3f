# SPDX-License-Identifier: GPL-3.0-or-later
"""Twins of places: a SPEC and its mesh, and what was sounded there."""
