# SPDX-License-Identifier: GPL-3.0-or-later
"""Concealed cases whose physics is GNU Radio's, with sealed truths: what `bench_diagnose.py` is judged on.

flow (arrays through blocks) → waveforms → channel → impairments / outside → world → compose → truth → score
"""
