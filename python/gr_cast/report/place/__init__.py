# SPDX-License-Identifier: GPL-3.0-or-later
"""Places: what a diagnosis of soundings says, what is planned, and what was drawn from maps."""
