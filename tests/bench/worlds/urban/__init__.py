# SPDX-License-Identifier: GPL-3.0-or-later
"""The city: cellular, vehicular and wireless-LAN signals over the air."""

from ..rig import drawing
from .world import Urban


def draw(rng, kind, folder):
    """One case of this kind in `folder`; returns its truth."""
    return drawing.draw(Urban(), rng, kind, folder)
