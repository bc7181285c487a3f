# SPDX-License-Identifier: GPL-3.0-or-later
"""A twin: its document, the forward model with its effects, and playback."""
