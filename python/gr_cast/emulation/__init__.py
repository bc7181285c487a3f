# SPDX-License-Identifier: GPL-3.0-or-later
"""The channel emulator in NumPy: what the C++ block must equal."""
