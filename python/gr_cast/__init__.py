# SPDX-License-Identifier: GPL-3.0-or-later
"""gr-cast: create, emulate, sound and diagnose wireless digital twins.

The package reads as the data flows: `codes` -> `transmit` -> `emulate` -> `receive` -> `cir` -> `compare` -> `diagnose`.
Only `gr_cast.blocks` needs GNU Radio; everything else needs NumPy and SciPy alone.
"""

__version__ = "0.1.0"
