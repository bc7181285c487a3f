# SPDX-License-Identifier: GPL-3.0-or-later
"""Colosseum in a box: batch jobs and their images checked, played on this machine, and the interactive command line's socket."""
