# SPDX-License-Identifier: GPL-3.0-or-later
"""gr-cast: create, emulate, sound and diagnose wireless digital twins.

The package reads as the data flows: `signals`, `scenario`, `emulation`, `sounding`, `comparing`, `twin`, `diagnose`,
`experiments`, `report`; no room imports a later one.
Only `gr_cast.blocks` needs GNU Radio; everything else needs NumPy and SciPy alone.
"""

__version__ = "0.1.0"
