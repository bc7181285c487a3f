# SPDX-License-Identifier: GPL-3.0-or-later
"""The laboratory: generators, software radios and a channel emulator on cables."""

from ..rig import drawing
from .world import Lab


def draw(rng, kind, folder):
    """One case of this kind in `folder`; returns its truth."""
    return drawing.draw(Lab(), rng, kind, folder)
