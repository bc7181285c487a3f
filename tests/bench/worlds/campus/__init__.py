# SPDX-License-Identifier: GPL-3.0-or-later
"""World `campus`: the radios of a university's roof, workshop and car park.

OFDM, shaped QAM, GMSK, chirps of sensors, DME pulses, spread spectrum, voice on FM, FMCW and Zadoff-Chu sequences, over one to
twelve paths, from the contract of cases alone. A case flows waveforms → scene → causes_* → channel → truth.
"""

from .cases import draw

__all__ = ["draw"]
