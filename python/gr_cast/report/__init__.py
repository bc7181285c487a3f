# SPDX-License-Identifier: GPL-3.0-or-later
"""Pages and pictures of what other rooms found; each module loads what it draws, and no more."""
