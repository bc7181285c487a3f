# SPDX-License-Identifier: GPL-3.0-or-later
"""Mutations of valid files, for tests/bench/fuzz_readers.py."""
