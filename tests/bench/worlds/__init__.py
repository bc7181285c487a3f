# SPDX-License-Identifier: GPL-3.0-or-later
"""Worlds of concealed radio faults; each is a package here that exposes `draw(rng, kind, folder)`."""
