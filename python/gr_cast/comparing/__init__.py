# SPDX-License-Identifier: GPL-3.0-or-later
"""Two runs or two responses beside one another: similarity, bias, validation."""
