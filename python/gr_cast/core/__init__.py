# SPDX-License-Identifier: GPL-3.0-or-later
"""What every room needs: errors, units, files, tasks, processes."""
