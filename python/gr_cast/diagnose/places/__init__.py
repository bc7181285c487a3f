# SPDX-License-Identifier: GPL-3.0-or-later
"""Which wall, material, mechanism or node the twin of a place leaves out: evidence, proposals, search, verdict."""
