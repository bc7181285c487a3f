# SPDX-License-Identifier: GPL-3.0-or-later
"""The cellular experiment: a sounded downlink with modelled link adaptation, or a real stack's own figures."""
