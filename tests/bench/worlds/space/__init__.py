# SPDX-License-Identifier: GPL-3.0-or-later
"""World `space`: satellite, short-wave, aviation and marine radio.

Spreading codes of navigation satellites, telemetry in BPSK and QPSK, GMSK of ships, pulse-position squitters of aircraft,
eight-tone FSK, ionosondes. Fading of two layers, tubes in saturation, crystals that drift, eight-bit receivers, mains hum.
"""

from .._craft import draw as _draw
from .world import WORLD


def draw(rng, kind, folder):
    """Writes one case of this world into the folder; its truth."""
    return _draw.case(WORLD, rng, kind, folder)
