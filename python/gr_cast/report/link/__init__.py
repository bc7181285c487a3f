# SPDX-License-Identifier: GPL-3.0-or-later
"""What a diagnosis of recordings says."""
