# SPDX-License-Identifier: GPL-3.0-or-later
"""What the worlds `lab` and `urban` share: interpolation, the order of a radio's parts, measured strengths, files."""
