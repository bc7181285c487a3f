# SPDX-License-Identifier: GPL-3.0-or-later
"""World `factory`: indoor industrial radio with cheap receivers.

OFDM preambles, Barker and CCK spreading, Gaussian FSK, chirps, ultra-wideband pulses and offset QPSK. Halls with long
diffuse tails, ovens and motors, inverters, hoppers, transmitters side by side, lost samples, coarse converters, heat.
"""

from .._craft import draw as _draw
from .world import WORLD


def draw(rng, kind, folder):
    """Writes one case of this world into the folder; its truth."""
    return _draw.case(WORLD, rng, kind, folder)
