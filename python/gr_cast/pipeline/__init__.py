# SPDX-License-Identifier: GPL-3.0-or-later
"""Twinning of protocol stacks: one commit built once, tried on twin and testbed, and judged."""
