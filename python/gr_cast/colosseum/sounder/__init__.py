# SPDX-License-Identifier: GPL-3.0-or-later
"""The CaST container's program: every node sends a code in a slot of its own, all others record it and find its path loss."""
